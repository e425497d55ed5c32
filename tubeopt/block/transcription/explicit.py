"""Equilibria without equations to solve: from the tubes' rotations at their tips to the joint rotations that they need.

Torsion vanishes at every tube's own end. Given the rotations there and the translations, the equations of torsion are
therefore an initial-value problem from the tip to the plate, whose solution always exists and is unique: every
equilibrium, stable or not, is one point (tip rotations, translations), and every such point is one equilibrium. Where
several equilibria have the same joint values, these points tell them apart; a continuous path of points is a branch.

The integrator takes `STEPS` steps of order 4 per section, of which there are 2 n with lengths that may be 0, and more
of tubes made of pieces, which are taken as chains of arcs and helices (`robots.steps`): breakpoints are sorted by
comparisons, so that one function serves every translation. One step is a function of its own, called for all of them:
it is written out once, however many tubes and steps there are. The margin enters as in
`inverse_program`, by the determinants of the Jacobi fields of softened tubes, for tubes off the centreline those of
their own equations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from typing import Any

import casadi as ca
import numpy as np

from ...physics.shape import exponential
from ...physics.torsion import section_functions
from ...robots.lengthwise import steps_of, varies
from ...robots.robot import Robot
from ...typing import Array
from .collocated import Piece, Torsion
from .functions import determinant_function

# --- From the tip to the plate over a piece, on arrays ----------------------------------------------------------------

# From the tip to the plate over a piece of the mesh, in one call: torsion, and Jacobi fields of softened tubes where a
# program must stay small.

Columns = list[Any]


@lru_cache(maxsize=64)
def march_function(n: int, eccentric: bool, slopes: bool, steps: int, varying: bool = False) -> ca.Function:
    """Steps of the classical method on a piece of the mesh.

    From (theta, torque, travel (n,)[, derivatives (n, n) of theta and of the torque by the tip angles], h (steps,) m,
    1 / kt, kb, m (n,)[, offset, angle (n,)]) at its far end to the same state at its near end, and theta and theta'
    (n, steps + 1) where the steps begin and end. `travel` is the length of every tube so far, m; h is counted towards
    the base. The last two inputs are those of eccentric tubes.

    Where cross-sections are `varying` along the piece, theta is the elastic rotation, and 1 / kt, kb, m and phase
    (n (2 steps + 1),), from the near end on where the steps end, are half-way and begin, stand for 1 / kt, kb and m.
    """
    step = _step_function(n, eccentric, slopes, varying)
    state, places = _state(ca.MX, n, slopes), 2 * steps + 1 if varying else 1
    h = ca.MX.sym("h", steps)
    constants = [ca.MX.sym("constant", n * places) for _ in range(_given(eccentric, varying))]
    tables = [ca.reshape(part, n, places) for part in constants]
    here, passed, rates = state, [state[0]], []
    for k in range(steps):
        far = 2 * (steps - k)
        inputs = [part[:, at] for at in (far, far - 1, far - 2) for part in tables] if varying else constants
        # `far`, `far - 1`, `far - 2` are far end, middle and near end: where the classical method looks.
        *here, rate = step(*here, h[k], *inputs)
        passed.append(here[0])
        rates.append(rate)
    # The slope at the near end, which no further step computes: cubics through the steps need it.
    stretch = section_functions(n, True)["moment"](here[0], *constants[1:])[1] if eccentric else 1
    rates.append(stretch * tables[0][:, 0] * here[1])
    return ca.Function("march", [*state, h, *constants], [*here, ca.horzcat(*passed), ca.horzcat(*rates)])


def _state(kind: Any, n: int, slopes: bool) -> Columns:
    return [kind.sym("state", *shape) for shape in [(n, 1)] * 3 + [(n, n)] * (2 if slopes else 0)]


def _given(eccentric: bool, varying: bool) -> int:
    """How many vectors tell of a cross-section."""
    return 4 if varying else 5 if eccentric else 3


@lru_cache(maxsize=32)
def _step_function(n: int, eccentric: bool, slopes: bool, varying: bool) -> ca.Function:
    """One of these steps: the state after it, and theta' where it began."""
    state, h = _state(ca.SX, n, slopes), ca.SX.sym("h")
    sections = [
        [ca.SX.sym("constant", n) for _ in range(_given(eccentric, varying))] for _ in range(3 if varying else 1)
    ]
    section_function = section_functions(n, eccentric)["balance" if slopes else "moment"]

    def rates(at: Columns, half: int) -> Columns:
        """By arc length; the travel grows towards the base."""
        theta, torque = at[:2]
        rate, *section = sections[half if varying else 0]
        if varying:
            theta = theta + section.pop()
        out = section_function.call([theta, *section])
        stretch = (out[3] if slopes else out[1]) if eccentric else ca.SX.ones(n)
        # theta' = g T / kt, T' = M, and the length of a tube grows by g against the direction of s.
        own = [stretch * rate * torque, out[0], -stretch]
        if not slopes:
            return own
        theta_by_tip, torque_by_tip = at[3:]
        turned = ca.diag(stretch * rate) @ torque_by_tip
        if eccentric:
            turned += ca.diag(rate * torque) @ (out[4] @ theta_by_tip)
        return [*own, turned, out[1] @ theta_by_tip]

    after = [ca.densify(part) for part in classical_step(state, rates, -h)]
    inputs = [part for section in sections for part in section]
    return ca.Function("step", [*state, h, *inputs], [*after, rates(state, 0)[0]], {"cse": True})


def classical_step(state: Columns, rates: Callable[[Columns, int], Columns], h: Any) -> Columns:
    """The state after a step h of Runge and Kutta's classical method; `rates` of a state some halves of it on."""
    slopes = [rates(state, 0)]
    for half in (1, 1, 2):
        slopes.append(rates([a + half / 2 * h * b for a, b in zip(state, slopes[-1], strict=True)], half))
    mean = [(a + 2 * (b + c) + d) / 6 for a, b, c, d in zip(*slopes, strict=True)]
    return [a + h * b for a, b in zip(state, mean, strict=True)]


# --- Jacobi fields ----------------------------------------------------------------------------------------------------

SOFT_NODES = np.array([0.0, 1 / 3, 1 / 2, 2 / 3, 1.0])
"""Where a step of Butcher's method of order 6 needs its right-hand side."""

_STAGES = (0, 1, 3, 1, 2, 2, 4)
_BUTCHER = (
    (),
    (1 / 3,),
    (0, 2 / 3),
    (1 / 12, 1 / 3, -1 / 12),
    (-1 / 16, 9 / 8, -3 / 16, -3 / 8),
    (0, 9 / 8, -3 / 8, -3 / 4, 1 / 2),
    (9 / 44, -9 / 11, 63 / 44, 18 / 11, 0, -16 / 11),
)
_WEIGHTS = (11 / 120, 0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120)

SOFT_STEPS = 2
"""Steps of that method per piece: margins below 0.9 to about 1e-6."""


def marched_fields(torsion: Torsion, fields: Any, margin: Any) -> Any:
    """Jacobi fields (2n, n) at the beginning of a piece from those at its end, tubes softened by the fraction `margin`.

    The fields are those of `softened_fields`.

    Method: J. C. Butcher, J. Austral. Math. Soc. 4 (1964), order 6 in 7 stages.
    """
    piece, n = torsion.piece, torsion.piece.grid.n_tubes
    # The state between collocation points is a polynomial: any one-step method may use it.
    h = piece.length / SOFT_STEPS
    for step in reversed(range(SOFT_STEPS)):
        x = (step + SOFT_NODES) / SOFT_STEPS
        theta, w = torsion.rotation(x), torsion.torsion(x)
        rates = [_field_rate(piece, x[k], (theta[:, k], w[:, k]), margin) for k in range(len(x))]
        slopes: list[Any] = []
        for stage, row in zip(_STAGES, _BUTCHER, strict=True):
            at = fields - h * sum((a * k for a, k in zip(row, slopes, strict=True)), ca.SX.zeros(2 * n, n))
            # Towards the plate: the node at fraction c of the step lies at 1 - c of the stretch.
            slopes.append(rates[len(x) - 1 - stage](at))
        fields = fields - h * sum(b * k for b, k in zip(_WEIGHTS, slopes, strict=True))
    return fields


def _field_rate(piece: Piece, x: float, at: tuple[Any, Any], margin: Any) -> Any:
    """The right-hand side of the Jacobi fields at the fraction x of a piece, theta and w there, as a function of the
    fields."""
    n, (theta, w) = piece.grid.n_tubes, at
    _, stiff, *stretching = piece.balance(theta, x)
    # Softening multiplies kt where w changes, with the state kept: the definition of the margin.
    gain = ca.diag(1 / ((1 - margin) * piece.torsional_stiffness)) @ stiff

    def rate(fields: Any) -> Any:
        y, v = fields[:n, :], fields[n:, :]
        turned = ca.diag(stretching[0]) @ v if stretching else v
        if len(stretching) > 1:
            turned += ca.diag(w) @ (stretching[1] @ y)
        return ca.vertcat(turned, gain @ y)

    return rate


STEPS = 4
"""Steps per section: joint rotations of the thesis' robot to about 1e-5 rad."""

TURNED = 1.5
"""Natural turn (rad) of a helix for which STEPS are as good as for an arc."""

EXPANDED = 200_000
"""Operations up to which all steps are written out, which is a tenth faster than calls; beyond, that takes seconds."""


@dataclass(frozen=True)
class Kind:
    """What makes the arms of two robots one function: tubes, whether they lie beside the centreline, of tubes made of
    pieces how many `stretches` they have at most (0: all have one curvature), and steps per section."""

    n: int
    eccentric: bool = False
    stretches: int = 0
    steps: int = STEPS

    @property
    def size(self) -> int:
        """Length of `explicit_parameters`."""
        return self.n * (6 * self.stretches + 1 if self.stretches else 7)

    @property
    def sections(self) -> int:
        """Sections of an arm, some without length."""
        return self.n * max(self.stretches, 2)

    def reach(self, robot: Any) -> Any:
        """(n,) lengths of the tubes behind their straight parts, m, of an expression of `explicit_parameters`."""
        if not self.stretches:
            _, _, _, straight, whole, *_ = ca.vertsplit(robot, self.n)
            return whole - straight
        cuts = ca.reshape(robot[: self.n * self.stretches], self.n, self.stretches)
        return cuts[:, -1] - cuts[:, 0]


def explicit_kind(robot: Robot, *, steps: int = STEPS) -> Kind:
    """Which function a robot's arm is; that of tubes that vary along a piece, which is cut into steps, in half as many
    per section."""
    if not robot.even:
        known = steps_of(robot.tubes)
        steps = (steps + 1) // 2 if varies(robot.tubes) else steps
        lengths = np.diff(known.cuts, axis=1, prepend=0.0)
        # Helices turn the pull by twist * h in a step: the error of order 4 grows with its fourth power.
        most = float(np.abs(known.twist * lengths * (known.curvature > 0)).max())
        return Kind(robot.n_tubes, False, known.cuts.shape[1], steps * max(1, int(np.ceil(most / TURNED))))
    return Kind(robot.n_tubes, robot.assembly(robot.home_translations).eccentric, steps=steps)


def explicit_parameters(robot: Robot) -> Array:
    """What `explicit_arm` needs to know of a robot: kb, kt, m = kb kappa, straight and whole lengths, place; (7n,).

    Of tubes made of pieces, by stretches (n, C) each: where they end, kb, kt, m, the direction of the bend that they
    would have at the held end, natural twist; then the natural turn (n,) up to the ends.
    """
    home = robot.assembly(robot.home_translations)
    tubes = robot.tubes
    if not home.even:
        known = steps_of(tubes)
        begin = np.pad(known.cuts, ((0, 0), (1, 0)))[:, :-1]
        lead = known.phase + known.wound - known.twist * begin
        end = known.wound[:, -1] + known.twist[:, -1] * (known.cuts - begin)[:, -1]
        tables = known.cuts, known.bending, known.torsional, known.bending * known.curvature, lead, known.twist
        return np.concatenate([*(table.ravel(order="F") for table in tables), end])
    return np.concatenate(
        [
            home.bending_stiffness,
            home.torsional_stiffness,
            home.bending_stiffness * home.curvature,
            home.transmission + robot.home_translations,
            [tube.length for tube in tubes],
            home.offset,
            home.offset_angle,
        ]
    )


@lru_cache(maxsize=16)
def explicit_arm(kind: Kind) -> ca.Function:
    """(tip rotations (n,), translations (n,), margin, robot) -> the equilibrium.

    Outputs: `rotations` (n,) of the joints; `fields` (sections,) determinants of the Jacobi fields of tubes softened by
    the margin, all positive if and only if the equilibrium's own margin is larger; `points` (3, p) and `tangents`
    (3, p) of the centreline, plate to tip, and their `arc_length` (p,).
    """
    n = kind.n
    tip, shift, margin, robot = (ca.MX.sym(k, m) for k, m in (("tip", n), ("d", n), ("mu", 1), ("robot", kind.size)))
    place: tuple[Any, ...] = ()
    if kind.stretches:
        length, *inputs, transmission, end = _stretches(n, kind.stretches)(shift, robot)
        theta = tip - end
    else:
        kb, kt, moment, straight, whole, *beside = ca.vertsplit(robot, n)
        place = tuple(beside)
        length, *inputs, transmission = _sections(n)(shift, kb, moment, straight, whole)
        inputs, theta = [*inputs, ca.repmat(kt, 1, kind.sections)], tip
    columns = [ca.horzsplit(each) for each in (length, *inputs)]
    step, determinant, fields = _step(n, kind.eccentric, kind.stretches > 0), determinant_function(n), []
    # At the tip w = 0; Jacobi fields of tip angles begin with y = 1, v = 0.
    w, y, v = ca.MX(ca.DM.zeros(n)), ca.MX(ca.densify(ca.DM.eye(n))), ca.MX(ca.DM.zeros(n, n))
    bends: list[tuple[Any, Any]] = []
    for whole_length, stiffness, pull, kt, *turned in reversed(list(zip(*columns, strict=True))):
        h = whole_length / kind.steps
        if turned:
            lead, twist, softer = turned
            # The torque kt w is continuous where a tube changes its stiffness, not w: ratio of both kt.
            w, v = softer * w, ca.repmat(softer, 1, n) * v
        for k in range(kind.steps):
            ahead = (lead - k * h * twist, twist) if turned else place
            theta, w, y, v, bend = step(theta, w, y, v, h, stiffness, pull, kt, 1 - margin, *ahead)
            bends.append((h, bend))
        fields.append(determinant(y))
    # At the plate the straight part adds its turn: joint rotations vary by y - transmission v.
    fields[-1] = determinant(y - ca.repmat(transmission, 1, n) * v)
    shape = _shape(bends)
    arm = ca.Function(
        "explicit_arm",
        [tip, shift, margin, robot],
        [theta - transmission * w, ca.vertcat(*fields), *shape],
        ["tip", "translations", "margin", "robot"],
        ["rotations", "fields", "points", "tangents", "arc_length"],
    )
    return arm.expand() if explicit_size(kind) < EXPANDED else arm


@lru_cache(maxsize=16)
def explicit_joints(kind: Kind) -> ca.Function:
    """The outputs `rotations` and `fields` of `explicit_arm` alone, which cost less without the shape."""
    inputs = explicit_arm(kind).mx_in()
    joints = ca.Function("explicit_joints", inputs, explicit_arm(kind).call(inputs)[:2])
    return joints.expand() if explicit_size(kind) < EXPANDED else joints


@lru_cache(maxsize=16)
def explicit_rotations(kind: Kind) -> ca.Function:
    """(tip rotations (n,), translations (n,), robot) -> the output `rotations` of `explicit_arm` alone, without Jacobi
    fields and shape: a sixth of its cost."""
    tip, shift, _, robot = explicit_arm(kind).mx_in()
    rotations = ca.Function("explicit_rotations", [tip, shift, robot], [explicit_arm(kind)(tip, shift, 0, robot)[0]])
    return rotations.expand() if explicit_size(kind) < EXPANDED else rotations


def explicit_size(kind: Kind) -> int:
    """Operations of `explicit_arm`, without building it."""
    return kind.sections * kind.steps * int(_step(kind.n, kind.eccentric, kind.stretches > 0).n_instructions())


@lru_cache(maxsize=16)
def _sections(n: int) -> ca.Function:
    """(translations, kb, moment, straight and whole lengths (n,) each) -> by columns of the 2n sections their length,
    stiffness and moment (n,); and the transmissions (n,)."""
    shift, kb, moment, straight, whole = (ca.SX.sym(k, n) for k in ("d", "kb", "m", "straight", "whole"))
    columns = []
    for a, b, here, there in _along(ca.horzcat(shift, shift - straight + whole)):
        columns.append((b - a, _stiff(kb, there), moment * there * here[:, 1]))
    tables = [ca.densify(ca.horzcat(*table)) for table in zip(*columns, strict=True)]
    return ca.Function("sections", [shift, kb, moment, straight, whole], [*tables, ca.fmax(straight - shift, 0)])


@lru_cache(maxsize=16)
def _stretches(n: int, count: int) -> ca.Function:
    """(translations, robot) of tubes with `count` stretches -> by columns of the sections their length, stiffness,
    moment, kt, the direction of the bends without elastic torsion where they end, its rate, and kt of the next section
    over their own; the transmissions (n,) times kt over its mean; the natural turn up to the ends (n,)."""
    kind = Kind(n, stretches=count)
    shift, robot = ca.SX.sym("d", n), ca.SX.sym("robot", kind.size)
    *tables, end = ca.vertsplit(robot, [0, *(n * count * np.arange(1, 7)).tolist(), kind.size])
    own, kb, kt, moment, lead, twist = (ca.reshape(table, n, count) for table in tables)
    held = ca.fmax(own[:, 0] - shift, 0)
    columns = []
    before = ca.horzcat(ca.SX.zeros(n), own[:, :-1])
    for a, b, here, there in _along(own - ca.repmat(held, 1, count)):
        stiffness, pull, torsional, ahead, rate = (ca.sum2(here * part) for part in (kb, moment, kt, lead, twist))
        columns.append([b - a, _stiff(stiffness, there), pull * there, torsional, ahead + rate * (b + held), rate])
    after = [each[3] for each in columns[1:]] + [columns[-1][3]]
    tables = [ca.densify(ca.horzcat(*table)) for table in zip(*columns, strict=True)]
    tables.append(ca.horzcat(*(b / a[3] for a, b in zip(columns, after, strict=True))))
    inside = ca.fmin(ca.fmax(ca.repmat(held, 1, count) - before, 0), own - before)
    return ca.Function("stretches", [shift, robot], [*tables, ca.sum2(inside / kt) * columns[0][3], end])


def _along(places: Any) -> Iterator[tuple[Any, Any, Any, Any]]:
    """The sections of tubes whose stretches end at arc lengths (n, C): where each begins and ends, which stretch of
    every tube is there (n, C), the last one also behind its end, and which tubes are there (n,)."""
    n, count = places.shape
    cuts = [ca.SX(0), *_sorted([ca.fmax(v, 0) for v in ca.vertsplit(ca.vec(places))])]
    for a, b in pairwise(cuts):
        # The middle of a section is on one side of every breakpoint; its ends may be on one.
        middle = ca.repmat((a + b) / 2, n, 1)
        later = ca.horzcat(*(middle >= places[:, c] for c in range(count - 1)), ca.SX.zeros(n))
        yield a, b, ca.horzcat(ca.SX.ones(n), later[:, :-1]) - later, middle < places[:, -1]


def _stiff(stiffness: Any, there: Any) -> Any:
    """(n,) of the tubes that are there. The middle of a section without length, or with one of a rounding error, may
    lie at the end of all tubes: whichever it has, they must not divide by 0."""
    return ca.if_else(ca.sum1(there) > 0, stiffness * there, stiffness)


def _sorted(values: list[Any]) -> list[Any]:
    """Values in increasing order, by a network of comparisons."""
    out = list(values)
    for last in range(len(out) - 1, 0, -1):
        # Comparisons, not a permutation: CasADi can differentiate minima and maxima, whatever their order.
        for k in range(last):
            out[k], out[k + 1] = ca.fmin(out[k], out[k + 1]), ca.fmax(out[k], out[k + 1])
    return out


@lru_cache(maxsize=16)
def _step(n: int, eccentric: bool, twisted: bool = False) -> ca.Function:
    """A step towards the plate: (theta, w, Jacobi fields y, v, its length, stiffness, moment, kt, softening, place) ->
    (theta, w, y, v) after it, and the curvatures (2, 3) at its near end, in its middle and at its far end.

    In the place of `place` are, of `twisted` tubes, the natural direction of their bends at the far end and its rate.
    """
    theta, w, h, kb, m, kt, softening, *place = (
        ca.SX.sym(k, 1 if k in ("h", "softening") else n)
        for k in ("theta", "w", "h", "kb", "m", "kt", "softening", "d", "phi")
    )
    y, v = ca.SX.sym("y", n, n), ca.SX.sym("v", n, n)
    params = (kb, m, *(place if eccentric else ()))
    lead = [place[0] - x * h * place[1] for x in (0, 0.5, 1)] if twisted else [0.0, 0.0, 0.0]
    functions = section_functions(n, eccentric)
    balance, bend = functions["balance"], functions["curvature"]

    def turning(theta: Any, w: Any) -> Any:
        return balance(theta, *params)[3] * w if eccentric else w

    state, stiffness = (theta, w, y, v), (kt, softening * kt)
    march = partial(_runge_kutta, balance) if eccentric else partial(_nystrom, balance, lead)
    near, near_w, *fields = march(state, params, stiffness, h)
    # Cubic Hermite interpolation at the middle, of order 4 as the step.
    middle = (theta + near) / 2 + h / 8 * (turning(near, near_w) - turning(theta, w))
    bends = ca.horzcat(*(bend(at + lead[k], *params) for k, at in ((2, near), (1, middle), (0, theta))))
    inputs = [theta, w, y, v, h, kb, m, kt, softening, *place]
    return ca.Function("step", inputs, [near, near_w, *fields, ca.densify(bends)], {"cse": True})


def _nystrom(
    balance: Any, lead: list[Any], state: tuple[Any, ...], inputs: tuple[Any, ...], kt: tuple[Any, Any], h: Any
) -> list[Any]:
    """A step of theta'' = M / kt and of its Jacobi fields, of softened tubes, of order 4; M is that of theta + `lead`
    at its far end, in its middle and at its near end."""
    theta, w, y, v = state

    def gains(theta: Any, place: int = 0) -> tuple[Any, Any]:
        moment, slope, *_ = balance(theta + lead[place], *inputs)
        return moment / kt[0], ca.diag(1 / kt[1]) @ slope

    # theta'' does not depend on theta': Nystrom's method of order 4 has three stages, not four.
    k1, slope = gains(theta)
    # Fields of the linearised equation, by the same method and stages: dM/dtheta is computed once.
    f1 = slope @ y
    k2, slope = gains(theta - h / 2 * w + h**2 / 8 * k1, 1)
    f2 = slope @ (y - h / 2 * v + h**2 / 8 * f1)
    k3, slope = gains(theta - h * w + h**2 / 2 * k2, 2)
    f3 = slope @ (y - h * v + h**2 / 2 * f2)
    return [
        theta - h * w + h**2 / 6 * (k1 + 2 * k2),
        w - h / 6 * (k1 + 4 * k2 + k3),
        y - h * v + h**2 / 6 * (f1 + 2 * f2),
        v - h / 6 * (f1 + 4 * f2 + f3),
    ]


def _runge_kutta(
    balance: Any, state: tuple[Any, ...], inputs: tuple[Any, ...], kt: tuple[Any, Any], h: Any
) -> list[Any]:
    """A step of theta' = g w, w' = M / kt and of its Jacobi fields, of softened tubes, of order 4."""

    def rates(at: list[Any], _: int) -> list[Any]:
        theta, w, y, v = at
        moment, slope, _, stretch, stretching = balance(theta, *inputs)
        turned = ca.diag(stretch) @ v + ca.diag(w) @ (stretching @ y)
        return [stretch * w, moment / kt[0], turned, ca.diag(1 / kt[1]) @ slope @ y]

    return classical_step(list(state), rates, -h)


def _shape(bends: list[tuple[Any, Any]]) -> tuple[Any, Any, Any]:
    """Positions and tangents (3, p), arc lengths (p,), plate to tip, from lengths and bends of steps to the plate."""
    frame, position, s = ca.MX(ca.densify(ca.DM.eye(3))), ca.MX(ca.DM.zeros(3)), ca.MX(0)
    out = [(position, frame[:, 2], s)]
    for h, bend in reversed(bends):
        frame, position = _carry()(frame, position, h, bend)
        s = s + h
        out.append((position, frame[:, 2], s))
    positions, tangents, marks = zip(*out, strict=True)
    return ca.horzcat(*positions), ca.horzcat(*tangents), ca.vertcat(*marks)


@lru_cache(maxsize=1)
def _carry() -> ca.Function:
    """(frame, position, length, curvatures (2, 3)) -> frame and position after a Magnus step of order 4 on SE(3)."""
    frame, position, h, bend = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3), ca.SX.sym("h"), ca.SX.sym("u", 2, 3)
    near, middle, far = bend[:, 0], bend[:, 1], bend[:, 2]
    # Magnus series: Simpson's rule for int u ds, and the bracket of the twists at both ends.
    mean = h / 6 * (near + 4 * middle + far)
    bracket = h**2 / 12
    turn = ca.vertcat(mean, bracket * (near[0] * far[1] - near[1] * far[0]))
    # The commutator of the twists (u, e3) at both ends: (u0 - u1) x e3.
    change = near - far
    rotation, step = exponential(turn, ca.vertcat(bracket * change[1], -bracket * change[0], h))
    out = [ca.densify(frame @ rotation), ca.densify(position + frame @ step)]
    return ca.Function("carry", [frame, position, h, bend], out, {"cse": True})

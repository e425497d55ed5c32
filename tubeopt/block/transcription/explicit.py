"""Explicit map from tip rotations and translations to the equilibrium: joint rotations, margin and shape.

Torsion vanishes at the end of every tube. For given rotations there, the equations of torsion are an initial-value
problem from tip to plate, which has exactly one solution. So equilibria, stable or not, and points (tip rotations,
translations) correspond one to one. Such points distinguish equilibria at the same joint values, and a continuous path
of points is a branch.

The integrator takes `STEPS_PER_SECTION` steps of order 4. Two-piece tubes have 2 n sections, some of length 0; general
tubes have more, as chains of arcs and helices (`robots.lengthwise.steps_of`). Breakpoints are sorted by minima and
maxima, so that one function serves every translation. One step is a CasADi function, called for all steps: the
expression stays small. Determinants of the Jacobi fields of softened tubes give the margin, as in `inverse.program`;
those of eccentric tubes satisfy the eccentric equations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from ...physics.shape import exponential
from ...physics.torsion import jacobi_rates, section_functions
from ...robots.lengthwise import steps_of, varies
from ...robots.robot import Robot
from ...typing import Array
from .collocated import Element, Torsion, softened
from .functions import determinant_function

State = list[Any]
"""State: theta, torque or torsion, ... as columns, and their derivatives by the tip rotations as matrices."""

# --- March over a piece of the mesh, on arrays ------------------------------------------------------------------------


@lru_cache(maxsize=64)
def march_function(n: int, eccentric: bool, slopes: bool, steps: int, varying: bool = False) -> ca.Function:
    """March over a piece of the mesh, from its far to its near end, by the classical Runge-Kutta method.

    Inputs (theta, torque, travel (n,)[, derivatives (n, n) of theta and of the torque by the tip rotations], h (steps,)
    m, 1 / kt, kb, m (n,)[, offset, angle (n,)]) at the far end; the last two for eccentric tubes. Outputs are the same
    state at the near end, and theta and theta' (n, steps + 1) at the ends of the steps. `travel` is the length of each
    tube so far, m; h is counted towards the base.

    For cross-sections `varying` along the piece, theta is the elastic rotation. In place of 1 / kt, kb and m the inputs
    are 1 / kt, kb, m and phase (n (2 steps + 1),) at the ends and middles of the steps, from the near end on.
    """
    step = _step_function(n, eccentric, slopes, varying)
    initial, nodes = _state(ca.MX, n, slopes), 2 * steps + 1 if varying else 1
    h = ca.MX.sym("h", steps)
    constants = [ca.MX.sym("constant", n * nodes) for _ in range(_section_size(eccentric, varying))]
    tables = [ca.reshape(part, n, nodes) for part in constants]
    state, thetas, rates = initial, [initial[0]], []
    for k in range(steps):
        far = 2 * (steps - k)
        # The classical method evaluates far end, middle and near end of a step.
        inputs = [part[:, node] for node in (far, far - 1, far - 2) for part in tables] if varying else constants
        *state, rate = step(*state, h[k], *inputs)
        thetas.append(state[0])
        rates.append(rate)
    # The slope at the near end, which no further step computes: cubics through the steps need it.
    g = section_functions(n, True)["moment"](state[0], *constants[1:])[1] if eccentric else 1
    rates.append(g * tables[0][:, 0] * state[1])
    return ca.Function("march", [*initial, h, *constants], [*state, ca.horzcat(*thetas), ca.horzcat(*rates)])


def _state(kind: Any, n: int, slopes: bool) -> State:
    return [kind.sym("state", *shape) for shape in [(n, 1)] * 3 + [(n, n)] * (2 if slopes else 0)]


def _section_size(eccentric: bool, varying: bool) -> int:
    """Number of vectors (n,) that describe a cross-section."""
    return 4 if varying else 5 if eccentric else 3


@lru_cache(maxsize=32)
def _step_function(n: int, eccentric: bool, slopes: bool, varying: bool) -> ca.Function:
    """Step of `march_function`: the state after it, and theta' before it."""
    state, h = _state(ca.SX, n, slopes), ca.SX.sym("h")
    sections = [
        [ca.SX.sym("constant", n) for _ in range(_section_size(eccentric, varying))] for _ in range(3 if varying else 1)
    ]
    section_function = section_functions(n, eccentric)["balance" if slopes else "moment"]

    def rates(state: State, half: int) -> State:
        """Derivative of the state by arc length, `half` half-steps from the far end."""
        theta, torque = state[:2]
        rate, *section = sections[half if varying else 0]
        if varying:
            theta = theta + section.pop()
        out = section_function.call([theta, *section])
        g = (out[3] if slopes else out[1]) if eccentric else ca.SX.ones(n)
        # The length of a tube grows by g against the direction of s.
        return [g * rate * torque, out[0], -g, *(_field_rates(out, torque, state[3:], rate) if slopes else ())]

    after = [ca.densify(part) for part in classical_step(state, rates, -h)]
    inputs = [part for section in sections for part in section]
    return ca.Function("step", [*state, h, *inputs], [*after, rates(state, 0)[0]], {"cse": True})


def _field_rates(out: Sequence[Any], torque: Any, fields: Sequence[Any], rate: Any, softness: Any = 1) -> Any:
    """Derivatives by arc length of Jacobi fields of theta and of the torque T, theta' = g T / kt, T' = M.

    Args:
        out: outputs of `balance`.   rate: 1 / kt (n,).   softness: factor on the compliance that the fields feel.
    """
    y, torque_change = fields
    stretch = (out[3], ca.diag(rate * torque) @ out[4]) if len(out) > 3 else ()
    return jacobi_rates(y, ca.diag(softness * rate) @ torque_change, out[1], *stretch)


def classical_step(state: State, rates: Callable[[State, int], State], h: Any) -> State:
    """State after a step h of the classical Runge-Kutta method; `rates(state, k)` is its derivative at k half-steps."""
    slopes = [rates(state, 0)]
    for half in (1, 1, 2):
        slopes.append(rates([a + half / 2 * h * b for a, b in zip(state, slopes[-1], strict=True)], half))
    mean = [(a + 2 * (b + c) + d) / 6 for a, b, c, d in zip(*slopes, strict=True)]
    return [a + h * b for a, b in zip(state, mean, strict=True)]


# --- Jacobi fields ----------------------------------------------------------------------------------------------------

SOFT_NODES = np.array([0.0, 1 / 3, 1 / 2, 2 / 3, 1.0])
"""Nodes of Butcher's method of order 6."""

# Node of SOFT_NODES, row of the Runge-Kutta matrix, and weight of each of the seven stages.
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
"""Steps of Butcher's method per element: margins below 0.9 to about 1e-6."""


def marched_fields(torsion: Torsion, fields: Any, margin: Any) -> Any:
    """Jacobi fields (2n, n) at the start of an element from `fields` at its end; `margin` softens the tubes.

    Method: J. C. Butcher, J. Austral. Math. Soc. 4 (1964), order 6 in 7 stages.
    """
    element, n = torsion.element, torsion.element.grid.n_tubes
    # The state between collocation points is a polynomial: any one-step method may use it.
    h = element.length / SOFT_STEPS
    for step in reversed(range(SOFT_STEPS)):
        x = (step + SOFT_NODES) / SOFT_STEPS
        theta, w = torsion.rotation(x), torsion.torsion(x)
        rates = [_field_rate(element, x[k], theta[:, k], w[:, k], margin) for k in range(len(x))]
        slopes: list[Any] = []
        for stage, row in zip(_STAGES, _BUTCHER, strict=True):
            state = fields - h * sum((a * k for a, k in zip(row, slopes, strict=True)), ca.SX.zeros(2 * n, n))
            # Towards the plate: the node at fraction c of the step lies at 1 - c of the stretch.
            slopes.append(rates[len(x) - 1 - stage](state))
        fields = fields - h * sum(b * k for b, k in zip(_WEIGHTS, slopes, strict=True))
    return fields


def _field_rate(element: Element, x: float, theta: Any, w: Any, margin: Any) -> Callable[[Any], Any]:
    """Right-hand side of the Jacobi fields, a function of the fields, at the fraction x of an element with theta, w."""
    n = element.grid.n_tubes
    softness = softened(element, theta, w, x, margin)
    return lambda fields: ca.vertcat(*jacobi_rates(fields[:n, :], fields[n:, :], *softness))


# --- Explicit map from tip rotations to the equilibrium ---------------------------------------------------------------

STEPS_PER_SECTION = 4
"""Steps per section: joint rotations of the robot of the thesis to about 1e-5 rad."""

MAX_HELIX_TURN = 1.5
"""Largest natural turn (rad) of a helix in a section for which these steps are as accurate as for an arc."""

MAX_EXPANDED_SIZE = 200_000
"""Largest number of operations for which all steps are expanded. It is a tenth faster than calls, but slow to build."""


@dataclass(frozen=True)
class Kind:
    """Structure of a robot: robots of one kind share one `explicit_arm`."""

    n: int
    """Number of tubes."""
    eccentric: bool = False
    """True if tubes run off the centreline."""
    stretches: int = 0
    """Largest number of arcs and helices of a tube made of pieces; 0 for tubes of one curvature."""
    steps: int = STEPS_PER_SECTION
    """Number of steps per section."""

    @property
    def size(self) -> int:
        """Number of `explicit_parameters`."""
        return self.n * (6 * self.stretches + 1 if self.stretches else 7)

    @property
    def sections(self) -> int:
        """Number of sections of an arm, some without length."""
        return self.n * max(self.stretches, 2)

    def reach(self, robot: Any) -> Any:
        """Curved lengths (n,) of the tubes, m, as an expression of `explicit_parameters`."""
        if not self.stretches:
            _, _, _, straight, length, *_ = ca.vertsplit(robot, self.n)
            return length - straight
        cuts = ca.reshape(robot[: self.n * self.stretches], self.n, self.stretches)
        return cuts[:, -1] - cuts[:, 0]


def explicit_kind(robot: Robot, *, steps: int = STEPS_PER_SECTION) -> Kind:
    """Kind of a robot, with `steps` per section, half as many for tubes that vary along a piece.

    Such pieces are already cut into short stretches.
    """
    if not robot.even:
        known = steps_of(robot.tubes)
        steps = (steps + 1) // 2 if varies(robot.tubes) else steps
        lengths = np.diff(known.cuts, axis=1, prepend=0.0)
        # A helix rotates the natural moment by twist * h in a step: the error of order 4 grows with its fourth power.
        turn = float(np.abs(known.twist * lengths * (known.curvature > 0)).max())
        return Kind(robot.n_tubes, False, known.cuts.shape[1], steps * max(1, int(np.ceil(turn / MAX_HELIX_TURN))))
    return Kind(robot.n_tubes, robot.assembly(robot.home_translations).eccentric, steps=steps)


def explicit_parameters(robot: Robot) -> Array:
    """Parameters (7n,) of a robot for `explicit_arm`: kb, kt, m = kb kappa, straight and whole lengths, offset, angle.

    For tubes made of pieces, tables (n, C) over C stretches: arc length of the end, kb, kt, m, direction of the bend
    extrapolated to the held end, natural twist; then the natural turn (n,) up to the end of the tube.
    """
    home = robot.assembly(robot.home_translations)
    tubes = robot.tubes
    if not home.even:
        known = steps_of(tubes)
        start = np.pad(known.cuts, ((0, 0), (1, 0)))[:, :-1]
        direction = known.phase + known.twist_angle - known.twist * start
        end_turn = known.twist_angle[:, -1] + known.twist[:, -1] * (known.cuts - start)[:, -1]
        tables = known.cuts, known.bending, known.torsional, known.bending * known.curvature, direction, known.twist
        return np.concatenate([*(table.ravel(order="F") for table in tables), end_turn])
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
    """Function (tip rotations (n,), translations (n,), margin, robot) -> equilibrium.

    Outputs: joint `rotations` (n,); `fields` (sections,), determinants of the Jacobi fields of tubes softened by the
    margin, all positive if and only if the margin of the equilibrium is larger; `points` (3, p) and `tangents` (3, p)
    of the centreline, plate to tip, and their `arc_length` (p,).
    """
    n = kind.n
    tip, shift, margin, robot = (ca.MX.sym(k, m) for k, m in (("tip", n), ("d", n), ("mu", 1), ("robot", kind.size)))
    offsets: tuple[Any, ...] = ()
    if kind.stretches:
        length, *inputs, transmission, end_turn = _stretches(n, kind.stretches)(shift, robot)
        theta = tip - end_turn
    else:
        kb, kt, moment, straight, length_of_tube, *offset_and_angle = ca.vertsplit(robot, n)
        offsets = tuple(offset_and_angle)
        length, *inputs, transmission = _sections(n)(shift, kb, moment, straight, length_of_tube)
        inputs, theta = [*inputs, ca.repmat(kt, 1, kind.sections)], tip
    columns = [ca.horzsplit(table) for table in (length, *inputs)]
    step, determinant, fields = _step(n, kind.eccentric, kind.stretches > 0), determinant_function(n), []
    # At the tip w = 0; Jacobi fields of tip rotations start with y = 1, v = 0.
    w, y, v = ca.MX(ca.DM.zeros(n)), ca.MX(ca.densify(ca.DM.eye(n))), ca.MX(ca.DM.zeros(n, n))
    steps: list[tuple[Any, Any]] = []
    for section_length, kb, m, kt, *natural in reversed(list(zip(*columns, strict=True))):
        h = section_length / kind.steps
        if natural:
            direction, twist, kt_ratio = natural
            # The torque kt w is continuous where a tube changes its stiffness, not w.
            w, v = kt_ratio * w, ca.repmat(kt_ratio, 1, n) * v
        for k in range(kind.steps):
            parameters = (direction - k * h * twist, twist) if natural else offsets
            theta, w, y, v, curvature = step(theta, w, y, v, h, kb, m, kt, 1 - margin, *parameters)
            steps.append((h, curvature))
        fields.append(determinant(y))
    # The straight part behind the plate adds its twist: joint rotations vary by y - transmission v.
    fields[-1] = determinant(y - ca.repmat(transmission, 1, n) * v)
    # The shape, from plate to tip.
    frame, position, s = ca.MX(ca.densify(ca.DM.eye(3))), ca.MX(ca.DM.zeros(3)), ca.MX(0)
    points, tangents, arc_lengths = [position], [frame[:, 2]], [s]
    for h, curvature in reversed(steps):
        frame, position = _pose_step()(frame, position, h, curvature)
        s = s + h
        points.append(position)
        tangents.append(frame[:, 2])
        arc_lengths.append(s)
    shape = ca.horzcat(*points), ca.horzcat(*tangents), ca.vertcat(*arc_lengths)
    arm = ca.Function(
        "explicit_arm",
        [tip, shift, margin, robot],
        [theta - transmission * w, ca.vertcat(*fields), *shape],
        ["tip", "translations", "margin", "robot"],
        ["rotations", "fields", "points", "tangents", "arc_length"],
    )
    return arm.expand() if explicit_size(kind) < MAX_EXPANDED_SIZE else arm


@lru_cache(maxsize=16)
def explicit_joints(kind: Kind) -> ca.Function:
    """Function with the outputs `rotations` and `fields` of `explicit_arm`, which costs less without the shape."""
    inputs = explicit_arm(kind).mx_in()
    joints = ca.Function("explicit_joints", inputs, explicit_arm(kind).call(inputs)[:2])
    return joints.expand() if explicit_size(kind) < MAX_EXPANDED_SIZE else joints


@lru_cache(maxsize=16)
def explicit_rotations(kind: Kind) -> ca.Function:
    """Function (tip rotations (n,), translations (n,), robot) -> joint rotations (n,), at a sixth of the cost."""
    tip, shift, _, robot = explicit_arm(kind).mx_in()
    rotations = ca.Function("explicit_rotations", [tip, shift, robot], [explicit_arm(kind)(tip, shift, 0, robot)[0]])
    return rotations.expand() if explicit_size(kind) < MAX_EXPANDED_SIZE else rotations


def explicit_size(kind: Kind) -> int:
    """Number of operations of `explicit_arm`, without building it."""
    return kind.sections * kind.steps * int(_step(kind.n, kind.eccentric, kind.stretches > 0).n_instructions())


@lru_cache(maxsize=16)
def _sections(n: int) -> ca.Function:
    """Function (translations, kb, moment, straight and whole lengths (n,) each) -> 2n sections of constant curvature.

    Outputs: lengths (1, 2n), kb and moment (n, 2n) of the sections, transmissions (n,), m.
    """
    shift, kb, moment, straight, length = (ca.SX.sym(k, n) for k in ("d", "kb", "m", "straight", "whole"))
    columns = []
    for section in _sections_of(ca.horzcat(shift, shift - straight + length)):
        present = section.present
        columns.append((section.end - section.start, _stiffness(kb, present), moment * present * section.stretch[:, 1]))
    tables = [ca.densify(ca.horzcat(*table)) for table in zip(*columns, strict=True)]
    return ca.Function("sections", [shift, kb, moment, straight, length], [*tables, ca.fmax(straight - shift, 0)])


@lru_cache(maxsize=16)
def _stretches(n: int, count: int) -> ca.Function:
    """Function (translations, robot) -> sections of tubes with `count` stretches.

    Outputs, by columns of the sections: length, kb, moment, kt, natural direction of the bend at the end, its rate, and
    kt of the next section over that of the section; then transmissions (n,) times kt over its mean there, and natural
    turns (n,) up to the ends of the tubes.
    """
    kind = Kind(n, stretches=count)
    shift, robot = ca.SX.sym("d", n), ca.SX.sym("robot", kind.size)
    *tables, end_turn = ca.vertsplit(robot, [0, *(n * count * np.arange(1, 7)).tolist(), kind.size])
    cuts, kb, kt, moment, direction, twist = (ca.reshape(table, n, count) for table in tables)
    transmission = ca.fmax(cuts[:, 0] - shift, 0)
    columns: list[list[Any]] = []
    previous = ca.horzcat(ca.SX.zeros(n), cuts[:, :-1])
    for start, end, stretch, present in _sections_of(cuts - ca.repmat(transmission, 1, count)):
        section_kb, m, section_kt, at_zero, rate = (
            ca.sum2(stretch * table) for table in (kb, moment, kt, direction, twist)
        )
        at_end = at_zero + rate * (end + transmission)
        columns.append([end - start, _stiffness(section_kb, present), m * present, section_kt, at_end, rate])
    next_kt = [column[3] for column in columns[1:]] + [columns[-1][3]]
    tables = [ca.densify(ca.horzcat(*table)) for table in zip(*columns, strict=True)]
    tables.append(ca.horzcat(*(after / column[3] for column, after in zip(columns, next_kt, strict=True))))
    # Behind the plate the torque is constant, and the twist its integral with 1 / kt over each stretch there.
    behind = ca.fmin(ca.fmax(ca.repmat(transmission, 1, count) - previous, 0), cuts - previous)
    return ca.Function("stretches", [shift, robot], [*tables, ca.sum2(behind / kt) * columns[0][3], end_turn])


class _Section(NamedTuple):
    """Part of the arm between two breakpoints."""

    start: Any
    end: Any
    """Arc lengths, m."""
    stretch: Any
    """Indicator (n, C) of the stretch of each tube; beyond the end of a tube its last stretch."""
    present: Any
    """Indicator (n,) of the tubes that reach the section."""


def _sections_of(ends: Any) -> Iterator[_Section]:
    """Sections of tubes with C stretches each, which end at arc lengths `ends` (n, C)."""
    n, count = ends.shape
    breakpoints: list[Any] = [ca.fmax(end, 0) for end in ca.vertsplit(ca.vec(ends))]
    # Bubble sort by minima and maxima, which CasADi differentiates whatever the order.
    for last in range(len(breakpoints) - 1, 0, -1):
        for k in range(last):
            a, b = breakpoints[k : k + 2]
            breakpoints[k], breakpoints[k + 1] = ca.fmin(a, b), ca.fmax(a, b)
    for start, end in pairwise([ca.SX(0), *breakpoints]):
        # The middle of a section is on one side of every breakpoint; its ends may be on one.
        middle = ca.repmat((start + end) / 2, n, 1)
        later = ca.horzcat(*(middle >= ends[:, c] for c in range(count - 1)), ca.SX.zeros(n))
        yield _Section(start, end, ca.horzcat(ca.SX.ones(n), later[:, :-1]) - later, middle < ends[:, -1])


def _stiffness(kb: Any, present: Any) -> Any:
    """Bending stiffness (n,) of the tubes present, or of all tubes if none is.

    The middle of a section of no length, or of that of a rounding error, may lie at the end of all tubes. The sum of
    the stiffnesses must not be 0 there, since curvatures are divided by it.
    """
    return ca.if_else(ca.sum1(present) > 0, kb * present, kb)


@lru_cache(maxsize=16)
def _step(n: int, eccentric: bool, twisted: bool = False) -> ca.Function:
    """Step of `explicit_arm` towards the plate, of order 4.

    Inputs theta, w, Jacobi fields y, v, length, kb, moment, kt, softening, offset, angle. Outputs theta, w, y, v after
    the step, and curvatures (2, 3) at its near end, middle and far end. For `twisted` tubes the last two inputs are the
    natural direction of the bend at the far end, and its rate.
    """
    theta, w, h, kb, m, kt, softening, *parameters = (
        ca.SX.sym(k, 1 if k in ("h", "softening") else n)
        for k in ("theta", "w", "h", "kb", "m", "kt", "softening", "d", "gamma")
    )
    y, v = ca.SX.sym("y", n, n), ca.SX.sym("v", n, n)
    params = (kb, m, *(parameters if eccentric else ()))
    # Natural direction of the bend at far end, middle and near end.
    natural = [parameters[0] - x * h * parameters[1] for x in (0, 0.5, 1)] if twisted else [0.0, 0.0, 0.0]
    functions = section_functions(n, eccentric)
    balance, curvature = functions["balance"], functions["curvature"]

    def rate(theta: Any, w: Any) -> Any:
        return balance(theta, *params)[3] * w if eccentric else w

    state, stiffness = (theta, w, y, v), (kt, softening * kt)
    march = partial(_runge_kutta, balance) if eccentric else partial(_nystrom, balance, natural)
    start, start_w, *fields = march(state, params, stiffness, h)
    # Cubic Hermite interpolation at the middle, of order 4 as the step.
    middle = (theta + start) / 2 + h / 8 * (rate(start, start_w) - rate(theta, w))
    curvatures = ca.horzcat(*(curvature(at + natural[k], *params) for k, at in ((2, start), (1, middle), (0, theta))))
    inputs = [theta, w, y, v, h, kb, m, kt, softening, *parameters]
    return ca.Function("step", inputs, [start, start_w, *fields, ca.densify(curvatures)], {"cse": True})


def _nystrom(
    balance: Any, natural: list[Any], state: tuple[Any, ...], inputs: tuple[Any, ...], kt: tuple[Any, Any], h: Any
) -> list[Any]:
    """Step of order 4 of theta'' = M(theta + natural) / kt and of the Jacobi fields of softened tubes.

    `natural` are directions at far end, middle and near end; `kt` are stiffnesses of the tubes and of softened tubes.
    """
    theta, w, y, v = state

    def gains(theta: Any, node: int = 0) -> tuple[Any, Any]:
        moment, slope, *_ = balance(theta + natural[node], *inputs)
        return moment / kt[0], ca.diag(1 / kt[1]) @ slope

    # theta'' does not depend on theta': Nystrom's method of order 4 has three stages, not four.
    k1, slope = gains(theta)
    # Fields of the linearised equation, by the same method and stages: dM/dtheta is computed once.
    f1 = jacobi_rates(y, v, slope)[1]
    k2, slope = gains(theta - h / 2 * w + h**2 / 8 * k1, 1)
    f2 = jacobi_rates(y - h / 2 * v + h**2 / 8 * f1, v, slope)[1]
    k3, slope = gains(theta - h * w + h**2 / 2 * k2, 2)
    f3 = jacobi_rates(y - h * v + h**2 / 2 * f2, v, slope)[1]
    return [
        theta - h * w + h**2 / 6 * (k1 + 2 * k2),
        w - h / 6 * (k1 + 4 * k2 + k3),
        y - h * v + h**2 / 6 * (f1 + 2 * f2),
        v - h / 6 * (f1 + 4 * f2 + f3),
    ]


def _runge_kutta(
    balance: Any, state: tuple[Any, ...], inputs: tuple[Any, ...], kt: tuple[Any, Any], h: Any
) -> list[Any]:
    """The same of theta' = g w, kt w' = M; see `_nystrom`."""
    theta, w, y, v = state

    def rates(state: State, _: int) -> State:
        theta, torque, *fields = state
        out = balance(theta, *inputs)
        return [out[3] * torque / kt[0], out[0], *_field_rates(out, torque, fields, 1 / kt[0], kt[0] / kt[1])]

    theta, torque, y, torque_change = classical_step([theta, kt[0] * w, y, ca.diag(kt[1]) @ v], rates, -h)
    return [theta, torque / kt[0], y, ca.diag(1 / kt[1]) @ torque_change]


@lru_cache(maxsize=1)
def _pose_step() -> ca.Function:
    """Function (R, p, length, curvatures (2, 3)) -> R, p after a Magnus step of order 4 on SE(3).

    The curvatures are those at near end, middle and far end of the step.
    """
    frame, position, h, u = ca.SX.sym("R", 3, 3), ca.SX.sym("p", 3), ca.SX.sym("h"), ca.SX.sym("u", 2, 3)
    near, middle, far = u[:, 0], u[:, 1], u[:, 2]
    # Magnus series: Simpson's rule for int u ds, and h^2 / 12 times the bracket of the twists (u, e3) at both ends.
    mean = h / 6 * (near + 4 * middle + far)
    factor = h**2 / 12
    omega = ca.vertcat(mean, factor * (near[0] * far[1] - near[1] * far[0]))
    # Translational part of the bracket: (u_near - u_far) x e3.
    change = near - far
    rotation, shift = exponential(omega, ca.vertcat(factor * change[1], -factor * change[0], h))
    out = [ca.densify(frame @ rotation), ca.densify(position + frame @ shift)]
    return ca.Function("pose_step", [frame, position, h, u], out, {"cse": True})

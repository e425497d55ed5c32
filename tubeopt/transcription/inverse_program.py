"""Inverse kinematics as one nonlinear program: an equilibrium block whose joint values are free.

Beside the block's own unknowns and equations there are the joint values, in which base rotations, transmissions and
the lengths of the pieces are linear as long as the breakpoints keep their order; the pose of the tip, integrated along
the pieces; and the margin as a smooth constraint. The last is Jacobi's: with all torsional stiffnesses reduced by the
fraction mu, the fields

    (1 - mu) kt Y'' = V'' Y,   Y = 1, Y' = 0 at the tip

keep det Y > 0 along the arm and det(Y(0) - |beta| Y'(0)) > 0 if and only if the margin is above mu. The determinants
are smooth in all unknowns; the smallest eigenvalue is not where two of them cross, and is capped at 1 where nothing
couples. For tubes off the centreline the fields are those of `offset_margin`, with the twist V in place of Y'; the last
determinant is 0 where their margin is mu. Of more than MOST_STRETCHED tubes they are taken on the centreline, which
changes the margin by hundredths at most: they only guide a search, whose answers are told by the margin itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ..errors import InputError
from ..mechanics.shape import GAUSS_POINTS, magnus_step
from ..mechanics.torsion import cross_section, section_functions
from ..obstacles import Obstacle
from ..robots.assembly import Array
from .block import Block, BlockInput, Structure, add_equilibrium
from .nlp import Builder, Nlp

MOST_STRETCHED = 3
"""Tubes off the centreline up to which the fields are their own; the expressions grow with the fourth power."""

STEPS = 2
"""Steps of the shape per piece: the fast path, and forward kinematics after it, integrate more finely."""

JACOBI_STEPS = 2
"""Steps of Nystrom's method per piece for the Jacobi fields: the margin to about 1e-5."""

SHARPNESS = 30.0
"""Sharpness of the smooth least distance from an obstacle, over the length of the robot: on the safe side."""


@dataclass(frozen=True)
class Question:
    """What makes two programs the same but for numbers.

    pointed: the direction is a constraint.   aimed: it is a cost.   objective: "nearest", "margin" or "curvature".
    obstacles, length: what the arm keeps away from, and the length (m) by which distances are measured.
    """

    structure: Structure
    carriages: tuple[tuple[int, ...], ...]
    pointed: bool
    aimed: bool
    objective: str
    obstacles: tuple[Obstacle, ...]
    length: float
    closings: int


@dataclass(frozen=True, eq=False)
class Program:
    """The program, its solver, and what reads a solution.

    `joints` (slice) are the joint values among the unknowns; `closing` (slice) the constraints that keep the order of
    breakpoints; `tip` (x, p) -> position, direction; `margin` (x, p) -> the Jacobi determinants;
    `theta` (x, p) -> rotations (n, N) at the collocation points; `jacobian` (x, p) -> that of the constraints. All for
    scaled x.
    """

    nlp: Nlp
    solver: Any
    joints: slice
    closing: slice
    tip: Any
    margin: Any
    theta: Any
    jacobian: Any


@dataclass(frozen=True, eq=False)
class Given:
    """Parameters of the program, as symbols.

    length, length_slope: (P,), (P, G) of the pieces, transmission (n,) at translations 0, kt (n,); stiffness, moment
    (n, P); place: offset and angle of eccentric tubes; target: position, direction, weight of the direction, least
    margin, clearance, radius (P,), reference and weights of the joints, order (closings, G) and its bounds.
    """

    length: Any
    length_slope: Any
    transmission: Any
    torsional: Any
    stiffness: Any
    moment: Any
    place: tuple[Any, Any]
    position: Any
    direction: Any
    direction_weight: Any
    min_margin: Any
    clearance: Any
    radius: Any
    reference: Any
    weights: Any
    order: Any
    bound: Any


@lru_cache(maxsize=64)
def inverse_program(question: Question) -> Program:
    """The program of a question, with its derivatives; built once."""
    structure = question.structure
    n, groups = structure.n_tubes, len(question.carriages)
    builder = Builder()
    names = [f"rotation of tube {i + 1}" for i in range(n)]
    names += [f"translation of carriage {k + 1}" for k in range(groups)]
    scale = np.concatenate([np.ones(n), np.full(groups, question.length / 2)])
    q = builder.variable(names, scale=scale)
    best = builder.variable(["margin"], lower=0.0, upper=0.999) if question.objective == "margin" else None
    given = _given(builder, question)
    shift = ca.vertcat(*(q[n + k] for i in range(n) for k, tubes in enumerate(question.carriages) if i in tubes))
    length = given.length + given.length_slope @ q[n:]
    lengths = BlockInput(
        q[:n], given.transmission - shift, given.torsional, length, given.stiffness, given.moment, *given.place
    )
    block = add_equilibrium(builder, structure, lengths)
    arm = _Arm(structure, lengths, block)
    tip, direction, points, bend = arm.shape()
    builder.constrain([f"tip position, {axis}" for axis in "xyz"], (tip - given.position) / question.length)
    if question.pointed:
        builder.constrain([f"tip direction, {axis}" for axis in "xy"], _aside(direction, given.direction))
        builder.constrain(["tip direction, sense"], ca.dot(direction, given.direction), lower=0.0, upper=np.inf)
    floor = given.min_margin if best is None else best
    fields = arm.jacobi(floor)
    names = [f"margin, Jacobi fields at piece {k + 1}" for k in range(fields.numel() - 1)] + ["margin"]
    builder.constrain(names, fields, lower=0.0, upper=np.inf)
    if best is not None:
        builder.constrain(["margin above its bound"], best - given.min_margin, lower=0.0, upper=np.inf)
    if question.closings:
        closing = given.order @ q[n:] - given.bound
        names = [f"order of breakpoints {k + 1}" for k in range(question.closings)]
        builder.constrain(names, closing / question.length, lower=0.0, upper=np.inf)
    for k, obstacle in enumerate(question.obstacles):
        clear = _soft_distance(obstacle, points, given.radius, question.length) - given.clearance
        builder.constrain([f"clearance of obstacle {k + 1}"], clear / question.length, lower=0.0, upper=np.inf)
    distance = given.weights * (q - given.reference)
    if question.objective == "nearest":
        builder.minimise(ca.sumsqr(distance) / 2)
    elif best is not None:
        builder.minimise(-best)
    else:
        builder.minimise(bend * question.length / 2)
    if question.aimed:
        builder.minimise(given.direction_weight * ca.sumsqr(direction - given.direction) / 2)
    return _close(builder, question, (block.rotation, tip, direction, fields))


def _close(builder: Builder, question: Question, parts: tuple[Any, ...]) -> Program:
    """Build the program with derivatives: the Jacobian in two parts, since its few dense rows are cheap in reverse."""
    theta, tip, direction, fields = parts
    nlp = builder.build()
    first = question.structure.n_tubes
    options: dict[str, Any] = {"ipopt.max_iter": 150, "ipopt.tol": 1e-7, "ipopt.constr_viol_tol": 1e-10}
    sparse = [k for k, name in enumerate(nlp.constraint_names) if _local(name)]
    dense = [k for k, name in enumerate(nlp.constraint_names) if not _local(name)]
    table = ca.SX(len(nlp.constraint_names), len(nlp.names))
    table[sparse, :] = ca.jacobian(nlp.constraints[sparse], nlp.x)
    for k in dense:
        table[k, :] = ca.gradient(nlp.constraints[k], nlp.x).T
    options["jac_g"] = ca.Function("jac_g", [nlp.x, nlp.p], [nlp.constraints, table], ["x", "p"], ["g", "jac_g_x"])
    # Second derivatives of shape and Jacobi fields take seconds to build for every order of breakpoints; IPOPT's
    # quasi-Newton approximation needs no more iterations with them than without.
    options["ipopt.hessian_approximation"] = "limited-memory"
    order = [k for k, name in enumerate(nlp.constraint_names) if name.startswith("order of breakpoints")]
    closing = slice(order[0], order[-1] + 1) if order else slice(0, 0)
    count = first + len(question.carriages)
    return Program(
        nlp=nlp,
        solver=nlp.ipopt("inverse", **options),
        joints=slice(0, count),
        closing=closing,
        tip=ca.Function("tip", [nlp.x, nlp.p], [tip, direction]),
        margin=ca.Function("margin", [nlp.x, nlp.p], [fields]),
        jacobian=ca.Function("jacobian", [nlp.x, nlp.p], [table]),
        theta=ca.Function("theta", [nlp.x, nlp.p], [ca.densify(theta)]),
    )


DENSE = ("tip", "margin", "clearance")


def _local(name: str) -> bool:
    """Whether a constraint depends on few unknowns only."""
    return not name.startswith(DENSE)


def _given(builder: Builder, question: Question) -> Given:
    """Parameters, in the order of the fields of `Given`."""
    structure = question.structure
    n, pieces, groups = structure.n_tubes, structure.n_pieces, len(question.carriages)
    matrix = {"length_slope": (pieces, groups), "stiffness": (n, pieces), "moment": (n, pieces)}
    size = {"length": pieces, "transmission": n, "torsional": n, "position": 3, "direction": 3, "radius": pieces}
    size |= dict.fromkeys(("direction_weight", "min_margin", "clearance"), 1)
    size |= dict.fromkeys(("reference", "weights"), n + groups) | {"bound": question.closings}
    matrix["order"] = (question.closings, groups)
    values: dict[str, Any] = {}
    for name in Given.__dataclass_fields__:
        if name == "place":
            eccentric = structure.eccentric
            values[name] = (builder.parameter(n), builder.parameter(n)) if eccentric else (None, None)
        elif name in matrix:
            rows, columns = matrix[name]
            values[name] = ca.reshape(builder.parameter(rows * columns), rows, columns)
        else:
            values[name] = builder.parameter(size[name])
    return Given(**values)


def given_values(**values: Any) -> Array:
    """Numbers for the parameters: a value for every field of `Given`, `place` a pair or None."""
    parts = []
    for name in Given.__dataclass_fields__:
        value = values[name]
        if name == "place":
            parts += [np.ravel(each) for each in value or ()]
        else:
            parts.append(np.ravel(np.asarray(value, dtype=float), order="F"))
    return np.concatenate(parts)


def _aside(direction: Any, target: Any) -> Any:
    """(2,) components of a direction square to the target, in the basis of Duff et al. (JCGT 6(1), 2017)."""
    x, y, z = target[0], target[1], target[2]
    sign = ca.if_else(z >= 0, 1.0, -1.0)
    a = -1 / (sign + z)
    b = x * y * a
    first = ca.vertcat(1 + sign * x**2 * a, sign * b, -sign * x)
    second = ca.vertcat(b, sign + y**2 * a, -y)
    return ca.vertcat(ca.dot(first, direction), ca.dot(second, direction))


@lru_cache(maxsize=64)
def has_formula(obstacle: Obstacle) -> bool:
    """Whether an obstacle's distance can be written with symbols."""
    point = ca.SX.sym("p", 3)
    try:
        obstacle.distance(point[0], point[1], point[2])
    except InputError:
        return False
    return True


def _soft_distance(obstacle: Obstacle, points: Sequence[tuple[int, Any]], radius: Any, length: float) -> Any:
    """A smooth number at most the least distance of the arm from an obstacle: -log(sum exp(-k d)) / k."""
    sharp = SHARPNESS * 10 / length
    distance = ca.vertcat(*(obstacle.distance(p[0], p[1], p[2]) - radius[piece] for piece, p in points))
    return -ca.logsumexp(-sharp * distance) / sharp


class _Arm:
    """Expressions along the arm of a block."""

    def __init__(self, structure: Structure, given: BlockInput, block: Block) -> None:
        self.structure, self.given, self.block = structure, given, block
        self.stretched = structure.eccentric and structure.n_tubes <= MOST_STRETCHED

    def rotation(self, piece: int, x: Array) -> Any:
        """theta (n, len(x)) at fractions x of a piece, by the polynomial of the collocation."""
        t, degree = self.structure.tableau, self.structure.degree
        h = self.given.length[piece]
        theta = ca.repmat(self.block.start_rotation[:, piece], 1, len(x))
        theta += h * self.block.start_twist[:, piece] @ ca.DM(x).T
        if not self.structure.collocated[piece]:
            return theta
        first = sum(self.structure.collocated[:piece]) * degree
        gain, extra = [], []
        for k in range(first, first + degree):
            here = self.section(piece, self.block.rotation[:, k])
            gain.append(here.moment / self.given.torsional_stiffness)
            extra.append((here.stretch - 1) * self.block.twist[:, k])
        theta += h**2 * ca.horzcat(*gain) @ t.lagrange(x, integrals=2).T
        if self.structure.eccentric:
            theta += h * ca.horzcat(*extra) @ t.lagrange(x, integrals=1).T
        return theta

    def twist(self, piece: int, x: Array) -> Any:
        """Twist w (n, len(x)) at fractions x of a piece with collocation points."""
        degree, t = self.structure.degree, self.structure.tableau
        first = sum(self.structure.collocated[:piece]) * degree
        points = [self.block.rotation[:, k] for k in range(first, first + degree)]
        gain = ca.horzcat(*(self.section(piece, theta).moment / self.given.torsional_stiffness for theta in points))
        start = ca.repmat(self.block.start_twist[:, piece], 1, len(x))
        return start + self.given.length[piece] * gain @ t.lagrange(x, integrals=1).T

    def section(self, piece: int, theta: Any) -> Any:
        g = self.given
        return cross_section(theta, g.stiffness[:, piece], g.moment[:, piece], g.offset, g.offset_angle)

    def shape(self) -> tuple[Any, Any, list[tuple[int, Any]], Any]:
        """Tip, its direction, points along the arm with their pieces, and int |u|^2 ds."""
        frame, position, bend = ca.SX.eye(3), ca.SX.zeros(3), ca.SX(0)
        points: list[tuple[int, Any]] = [(0, position)]
        x = ((np.arange(STEPS)[:, None] + GAUSS_POINTS) / STEPS).ravel()
        for piece in range(self.structure.n_pieces):
            h = self.given.length[piece] / STEPS
            theta = self.rotation(piece, x)
            u = ca.horzcat(*(self.section(piece, theta[:, k]).curvature for k in range(len(x))))
            for k in range(STEPS):
                own = u[:, 3 * k : 3 * k + 3]
                before, ahead = position, frame[:, 2]
                frame, position = magnus_step(frame, position, own, h)
                points += [(piece, p) for p in _cubic(before, position, h * ahead, h * frame[:, 2])]
                bend += h * ca.dot(ca.DM([5, 8, 5]) / 18, ca.sum1(own**2).T)
        return position, frame[:, 2], points, bend

    def jacobi(self, margin: Any) -> Any:
        """Determinants of the Jacobi fields of tubes softened by `margin`: where pieces begin, tip to base, then of
        the base with the transmissions."""
        n = self.structure.n_tubes
        softened = (1 - margin) * self.given.torsional_stiffness
        y, slope = ca.SX.eye(n), ca.SX.zeros(n, n)
        x = np.arange(2 * JACOBI_STEPS + 1) / (2 * JACOBI_STEPS)
        out = []
        for piece in reversed(range(self.structure.n_pieces)):
            if self.structure.collocated[piece]:
                h = self.given.length[piece] / JACOBI_STEPS
                stages = self._stages(piece, x, softened)
                step = stretched_step if self.stretched else _nystrom
                for k in reversed(range(0, 2 * JACOBI_STEPS, 2)):
                    y, slope = step(y, slope, stages[k : k + 3], h)
            else:
                y = y - self.given.length[piece] * slope
            if piece:
                out.append(_determinant(y))
        out.append(_determinant(y - ca.diag(self.given.transmission) @ slope))
        return ca.vertcat(*out)

    def _stages(self, piece: int, x: Array, softened: Any) -> list[Any]:
        """Coefficients of the fields at fractions x of a piece."""
        g, theta = self.given, self.rotation(piece, x)
        stiffness, moment = g.stiffness[:, piece], g.moment[:, piece]
        if not self.stretched:
            return [coupling(theta[:, k], stiffness, moment, softened) for k in range(len(x))]
        place, twist = (g.offset, g.offset_angle), self.twist(piece, x)
        return [stretched_stage(theta[:, k], twist[:, k], (stiffness, moment, *place), softened) for k in range(len(x))]


def coupling(theta: Any, stiffness: Any, moment: Any, softened: Any) -> Any:
    """V'' / kt (n, n) at a cross-section of concentric tubes."""
    cos, sin = moment * ca.cos(theta), moment * ca.sin(theta)
    pull = ca.sum1(cos), ca.sum1(sin)
    own = ca.diag(cos * pull[0] + sin * pull[1])
    return ca.diag(1 / softened) @ (own - cos @ cos.T - sin @ sin.T) / ca.sum1(stiffness)


Stage = tuple[Any, Any, Any]


def stretched_stage(theta: Any, twist: Any, section: tuple[Any, ...], softened: Any) -> Stage:
    """w g' (n, n), g (n, n) and M' / kt (n, n) of y' = w (g' y) + g v, v' = M' y / kt at a cross-section of tubes off
    the centreline, given by stiffness, moment, offset and angle."""
    _, turned, _, stretch, stretched = section_functions(theta.shape[0], True)["balance"](theta, *section)
    return ca.diag(twist) @ stretched, ca.diag(stretch), ca.diag(1 / softened) @ turned


def stretched_step(y: Any, v: Any, stages: list[Stage], h: Any) -> tuple[Any, Any]:
    """One step of Runge and Kutta's method for fields of tubes off the centreline, from the far end of a length h to
    its near end; stages (near, middle, far)."""
    near, middle, far = stages

    def rates(stage: Stage, a: Any, b: Any) -> tuple[Any, Any]:
        return stage[0] @ a + stage[1] @ b, stage[2] @ a

    k1 = rates(far, y, v)
    k2 = rates(middle, y - h / 2 * k1[0], v - h / 2 * k1[1])
    k3 = rates(middle, y - h / 2 * k2[0], v - h / 2 * k2[1])
    k4 = rates(near, y - h * k3[0], v - h * k3[1])
    return (
        y - h / 6 * (k1[0] + 2 * (k2[0] + k3[0]) + k4[0]),
        v - h / 6 * (k1[1] + 2 * (k2[1] + k3[1]) + k4[1]),
    )


def _cubic(start: Any, end: Any, ahead: Any, behind: Any) -> list[Any]:
    """Points at the middle and the end of a step with tangents (times its length) at both ends."""
    return [(start + end) / 2 + (ahead - behind) / 8, end]


def _nystrom(y: Any, slope: Any, stiffness: list[Any], h: Any) -> tuple[Any, Any]:
    """One step of Y'' = S Y over a length h from its far end to its near end; S (near, middle, far)."""
    near, middle, far = stiffness
    k1 = far @ y
    k2 = middle @ (y - h / 2 * slope + h**2 / 8 * k1)
    k3 = near @ (y - h * slope + h**2 / 2 * k2)
    return y - h * slope + h**2 / 6 * (k1 + 2 * k2), slope - h / 6 * (k1 + 4 * k2 + k3)


def _determinant(matrix: Any) -> Any:
    """Determinant; of more than three rows by elimination without pivoting: the fields begin as the identity."""
    n = matrix.shape[0]
    if n <= 3:
        return ca.det(matrix)
    product: Any = 1.0
    for _ in range(n - 1):
        pivot = matrix[0, 0]
        product = product * pivot
        matrix = matrix[1:, 1:] - matrix[1:, 0] @ matrix[0, 1:] / pivot
    return product * matrix[0, 0]

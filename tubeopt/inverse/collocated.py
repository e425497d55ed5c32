"""Inverse kinematics as one nonlinear program: an equilibrium block whose joint values are free.

Beside the block's own unknowns and equations there are the joint values, in which base rotations, transmissions and
the lengths of the pieces are linear as long as the breakpoints keep their order; the pose of the tip, integrated along
the pieces; and the margin as a smooth constraint. The last is Jacobi's: with all torsional stiffnesses reduced by the
fraction mu, the fields

    (1 - mu) kt Y'' = V'' Y,   Y = 1, Y' = 0 at the tip

keep det Y > 0 along the arm and det(Y(0) - |beta| Y'(0)) > 0 if and only if the margin is above mu. The determinants
are smooth in all unknowns; the smallest eigenvalue is not where two of them cross, and is capped at 1 where nothing
couples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ..bodies.obstacles import Obstacle
from ..errors import InputError
from ..physics.matrix import determinant
from ..physics.shape import GAUSS_POINTS, magnus_step
from ..transcription.block import Block, BlockInput, Structure, add_equilibrium
from ..transcription.fields import marched_fields
from ..transcription.nlp import Builder, Nlp
from ..typing import Array

STEPS = 2
"""Steps of the shape per piece: the fast path, and forward kinematics after it, integrate more finely."""

JACOBI_STEPS = 2
"""Steps per piece for the Jacobi fields: margins below 0.9 to about 1e-6."""

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
    tip, direction, points, bend = _shape(block)
    builder.constrain([f"tip position, {axis}" for axis in "xyz"], (tip - given.position) / question.length)
    if question.pointed:
        builder.constrain([f"tip direction, {axis}" for axis in "xy"], _aside(direction, given.direction))
        builder.constrain(["tip direction, sense"], ca.dot(direction, given.direction), lower=0.0, upper=np.inf)
    floor = given.min_margin if best is None else best
    fields = _jacobi(block, structure.collocated, lengths.transmission, floor)
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


def _shape(block: Block) -> tuple[Any, Any, list[tuple[int, Any]], Any]:
    """Tip, its direction, points along the arm with their pieces, and int |u|^2 ds."""
    frame, position, bend = ca.SX.eye(3), ca.SX.zeros(3), ca.SX(0)
    points: list[tuple[int, Any]] = [(0, position)]
    x = ((np.arange(STEPS)[:, None] + GAUSS_POINTS) / STEPS).ravel()
    for piece, torsion in enumerate(block.torsion):
        h, u = torsion.piece.length / STEPS, torsion.curvature(x)
        for k in range(STEPS):
            own = u[:, 3 * k : 3 * k + 3]
            before, ahead = position, frame[:, 2]
            frame, position = magnus_step(frame, position, own, h)
            points += [(piece, p) for p in _cubic(before, position, h * ahead, h * frame[:, 2])]
            bend += h * ca.dot(ca.DM([5, 8, 5]) / 18, ca.sum1(own**2).T)
    return position, frame[:, 2], points, bend


def _jacobi(block: Block, collocated: tuple[bool, ...], transmission: Any, margin: Any) -> Any:
    """Determinants of the Jacobi fields of tubes softened by `margin`: where pieces begin, tip to base, then of the
    base with the transmissions."""
    n = transmission.numel()
    fields = ca.vertcat(ca.SX.eye(n), ca.SX.zeros(n, n))
    out = []
    for piece, torsion in reversed(list(enumerate(block.torsion))):
        if collocated[piece]:
            fields = marched_fields(torsion, fields, margin, steps=JACOBI_STEPS)
        else:
            fields = ca.vertcat(fields[:n, :] - torsion.piece.length * fields[n:, :], fields[n:, :])
        if piece:
            out.append(determinant(fields[:n, :]))
    out.append(determinant(fields[:n, :] - ca.diag(transmission) @ fields[n:, :]))
    return ca.vertcat(*out)


def _cubic(start: Any, end: Any, ahead: Any, behind: Any) -> list[Any]:
    """Points at the middle and the end of a step with tangents (times its length) at both ends."""
    return [(start + end) / 2 + (ahead - behind) / 8, end]

"""Numbers of an arm: the unknowns of a block where a solve begins, and what a solution says between its points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol, Self, TypeVar

import numpy as np
import scipy

from ..robots.load import Load
from ..robots.robot import Robot, is_general
from ..typing import Array
from .transcription import arm as arms
from .transcription import functions
from .transcription.arm import ArmShape, CollocationPoints, Profile
from .transcription.buffered import section_function
from .transcription.functions import field_rows, field_size
from .transcription.model import Model
from .transcription.reduced import ReducedProblem

# --- Initial equilibrium ----------------------------------------------------------------------------------------------

# A block knows how the solved equilibrium is used that it begins from, not how one is found.


class InitialEquilibrium(Protocol):
    """A solved equilibrium; `tubeopt.Equilibrium` is one."""

    @property
    def robot(self) -> Robot:
        """The robot of the equilibrium."""

    @property
    def rotations(self) -> Array:
        """(n,) rad."""

    @property
    def translations(self) -> Array:
        """(n,) m."""

    @property
    def tip_position(self) -> Array:
        """(3,) m."""

    @property
    def arm(self) -> ArmShape:
        """The whole arm."""

    @property
    def points(self) -> CollocationPoints:
        """Where it is known best."""

    @property
    def load(self) -> Load | None:
        """What pushes."""

    @property
    def margin(self) -> float:
        """Its stability margin."""

    def collocated(self) -> tuple[ReducedProblem, Profile]:
        """The collocated problem that it solves, and the torsion along its arm."""

    def at(
        self,
        robot: Robot,
        rotations: Array,
        translations: Array,
        rotation_at: Callable[[Array], Array] | None = None,
        *,
        load: Load | None = None,
        curvature_at: Callable[[Array], Array] | None = None,
    ) -> Self:
        """An equilibrium of a robot at joint values, from rotations (n, P) of its tubes at arc lengths (P,), and under
        `load` from curvatures (2, P), or cold."""

    def verified(self) -> Self:
        """The same, verified by adaptive re-integration."""


N = TypeVar("N", bound=InitialEquilibrium)


Shape = tuple[Array, ...]
"""theta, w (n, P) and theta inside (n, P K); under load also bending moments (2, P) and inside (2, P K)."""


def points_of(model: Model) -> tuple[Array, Array]:
    """Arc lengths where the pieces begin (P,), and of their points (P K,)."""
    length = np.maximum(np.asarray(model.lengths, dtype=float).ravel(), 0.0)
    start = np.concatenate([[0.0], np.cumsum(length)[:-1]])
    return start, (start[:, None] + length[:, None] * model.grid.tableau.nodes).ravel()


def shape_at_start(initial: InitialEquilibrium, model: Model) -> Shape:
    """An equilibrium at the places of the pieces of a model; beyond its tip, as at the tip."""
    places = points_of(model)
    torsion = _torsion_under_load(initial, *places) if initial.load is not None else _torsion(initial, *places)
    return (*torsion, *_bending_of(initial, *places)) if model.grid.loaded else torsion


def _torsion(initial: InitialEquilibrium, start: Array, inside: Array) -> Shape:
    problem, arm = initial.collocated()
    last = float(problem.assembly.total_length)
    start, inside = np.minimum(start, last), np.minimum(inside, last)
    theta = arms.interpolate(problem, arm, start).T
    twist = arms.torque_at(problem, arm, start) / [tube.torsional_stiffness for tube in initial.robot.tubes]
    return theta, twist.T, arms.interpolate(problem, arm, inside).T


def _torsion_under_load(initial: InitialEquilibrium, start: Array, inside: Array) -> tuple[Array, Array, Array]:
    """theta, w (n, P) at arc lengths (P,) and theta (n, N) at arc lengths (N,) of an equilibrium, off its points."""
    s = initial.arm.arc_length
    theta, w = initial.arm.rotation - initial.robot.assembly(initial.translations).wound(s).T, initial.arm.torsion
    if is_general(initial.robot):
        # Without the natural twist, which ends where a tube does, and as it would be at the stiffness of the tube.
        w = np.gradient(theta, s, axis=1)
    between = scipy.interpolate.CubicHermiteSpline(s, theta, w, axis=1)(np.clip(inside, s[0], s[-1]))
    at_start = [np.array([np.interp(start, s, row) for row in table]) for table in (theta, w)]
    return at_start[0], at_start[1], between


def _bending_of(initial: InitialEquilibrium, start: Array, inside: Array) -> tuple[Array, Array]:
    """Bending moments (2, P) and (2, N), N m, that a load makes, at arc lengths (P,) and (N,)."""
    if initial.load is None:
        return np.zeros((2, len(start))), np.zeros((2, len(inside)))
    assembly = initial.robot.assembly(initial.translations)
    known, at = initial.points, initial.points.point
    here = assembly.cross_sections(at, at)
    theta, kb = known.point_rotation - here.wound + here.phase, here.stiffness
    unloaded = section_function("curvature", len(kb), kb.shape[1], False)(theta, kb, here.moment)[0]
    bending = (known.point_curvature - unloaded) * kb.sum(1)[:, None]
    return tuple(np.array([np.interp(s, at, row) for row in bending.T]) for s in (start, inside))  # type: ignore[return-value]


def columns_of(inside: Array, pieces: int) -> Array:
    """(2 K, P) of (2, P K): what is given of the points of a piece, in one column."""
    return np.asarray(inside.T.reshape(pieces, -1).T)


def sample(model: Model, arc_length: Array) -> tuple[Array, Array, Array]:
    """theta and w, (n, len(arc_length)) each, of tubes of pieces the elastic rotation, and the curvature (2, ...) of a
    solved arm at places along it, m."""
    start, _ = points_of(model)
    inside = functions.inside_function(model.grid)
    base = np.array([1.0, 0, 0, 0]), np.zeros(3)
    theta, twist, curvature = [], [], []
    for s in arc_length:
        k = max(int(np.searchsorted(start, s, side="right")) - 1, 0)
        x = min((s - start[k]) / model.lengths[k], 1.0) if model.lengths[k] > 0 else 0.0
        out = inside(*base, x, *model.piece(k))
        theta.append(np.array(out[2]).ravel())
        twist.append(np.array(out[3]).ravel())
        curvature.append(np.array(out[4]).ravel())
    return np.array(theta).T, np.array(twist).T, np.array(curvature).T


def poses_of(model: Model) -> tuple[Array, Array]:
    """(4, P - 1), (3, P - 1) poses where the pieces but the first begin, by integration."""
    step = functions.pose_function(model.grid)
    q, p = np.array([1.0, 0, 0, 0]), np.zeros(3)
    out = []
    for k in range(model.n_pieces - 1):
        q, p = (np.array(part).ravel() for part in step(q, p, *model.piece(k)))
        out.append((q, p))
    return np.array([q for q, _ in out]).reshape(-1, 4).T, np.array([p for _, p in out]).reshape(-1, 3).T


def fields_of(model: Model, margin: float) -> tuple[Array, Array, Array]:
    """Jacobi fields of tubes softened by `margin`, every piece from y = 1 where it ends: v / y (n n (P - 1),) where the
    pieces but the first begin, and y (n n K P,) at the points, by columns."""
    n, m, degree = field_size(model.grid), field_rows(model.grid), model.grid.degree
    step, matrix = functions.fields_function(model.grid), functions.field_matrix_function(model.grid)
    softness = [np.hsplit(np.array(part), model.n_pieces) for part in model.softness(margin)]
    fields: Any = np.concatenate([np.eye(n), np.zeros((n, n))])
    out, points, ahead = [], [], []
    for k in reversed(range(model.n_pieces)):
        inputs = [model.lengths[k], *(part[k] for part in softness)]
        forced = np.array(step(fields, np.zeros((m, degree * n)), *inputs)[1])
        columns = forced.reshape(m, n, degree).transpose(2, 0, 1).reshape(degree * m, n)
        own = -np.linalg.solve(np.array(matrix(*inputs)), columns)
        inner = own.reshape(degree, m, n).transpose(1, 2, 0).reshape(m, n * degree)
        y, v = np.split(np.array(step(fields, inner, *inputs)[0]), 2)
        ahead.append(y.ravel(order="F"))
        ratio = v @ np.linalg.pinv(y)
        fields = np.concatenate([np.eye(n), ratio])
        out.append(ratio.ravel(order="F"))
        points.append(inner.ravel(order="F"))
    held = y - np.array(model.held_at_the_plate).reshape(-1, 1) * v
    ratios = np.concatenate([*reversed(out[:-1]), np.zeros(0)])
    return ratios, np.concatenate([*reversed(points)]), np.concatenate([*reversed(ahead), held.ravel(order="F")])

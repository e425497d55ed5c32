"""Numbers of an arm: start values of the unknowns of a block, and values of a solution between its points."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, Self, TypeVar

import numpy as np

from ..robots.load import Load
from ..robots.robot import Robot
from ..typing import Array
from .transcription import arm as arms
from .transcription import functions
from .transcription.arm import ArmShape, CollocationPoints, Profile
from .transcription.buffered import section_function
from .transcription.functions import field_rows, field_size
from .transcription.model import Model
from .transcription.reduced import ReducedProblem

# --- Initial equilibrium ----------------------------------------------------------------------------------------------

# A block starts at a solved equilibrium; how one is solved belongs to the packages above.


class InitialEquilibrium(Protocol):
    """A solved equilibrium; `tubeopt.Equilibrium` is one."""

    @property
    def robot(self) -> Robot:
        """Robot of the equilibrium."""

    @property
    def rotations(self) -> Array:
        """Rotations (n,) of the tubes at their clamped ends, rad."""

    @property
    def translations(self) -> Array:
        """Translations (n,) of the tubes, m."""

    @property
    def tip_position(self) -> Array:
        """Position (3,) of the tip in the plate frame, m."""

    @property
    def arm(self) -> ArmShape:
        """Shape of the arm from plate to tip."""

    @property
    def points(self) -> CollocationPoints:
        """Collocation points of the solution."""

    @property
    def load(self) -> Load | None:
        """External load, or None."""

    @property
    def margin(self) -> float:
        """Stability margin."""

    def collocated(self) -> tuple[ReducedProblem, Profile]:
        """Collocated problem, and the torsion along the arm that solves it."""

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
        """Equilibrium of a robot at joint values.

        Args:
            rotation_at: rotations (n, P) of the tubes at arc lengths (P,), from which the solve starts; None is a cold
                start.
            curvature_at: curvatures (2, P) there, 1/m, with which a solve under `load` starts.
        """

    def verified(self) -> Self:
        """This equilibrium, verified by adaptive re-integration."""


N = TypeVar("N", bound=InitialEquilibrium)


class StartValues(NamedTuple):
    """Start values of a solve: torsion and bending of an arm on P elements with K points."""

    rotation: Array
    """Rotations theta (n, P) at the starts of elements, rad."""
    torsion: Array
    """Torsion w (n, P) at the starts of elements, rad/m."""
    rotation_inside: Array
    """Rotations theta (n, P K) at the points, rad."""
    moments: tuple[Array, ...] = ()
    """Bending moments under load (2, P) where elements begin, and (2 K, P) at their points, N m."""


def collocation_points(model: Model) -> tuple[Array, Array]:
    """Arc lengths (P,) where elements begin, and (P K,) of their points, m."""
    length = np.maximum(np.asarray(model.lengths, dtype=float).ravel(), 0.0)
    start = np.concatenate([[0.0], np.cumsum(length)[:-1]])
    return start, (start[:, None] + length[:, None] * model.grid.tableau.nodes).ravel()


def start_values(initial: InitialEquilibrium, model: Model) -> StartValues:
    """An equilibrium on the elements of a model; beyond its tip the values are those at the tip."""
    problem, arm = initial.collocated()
    start, inside = (np.minimum(s, problem.assembly.total_length) for s in collocation_points(model))
    theta = arms.interpolate(problem, arm, start).T
    # The unknowns refer to the stiffness where a tube is clamped.
    twist = arms.torque_at(problem, arm, start) / [tube.torsional_stiffness for tube in initial.robot.tubes]
    moments: tuple[Array, ...] = ()
    if model.grid.loaded:
        at_start, at_nodes = (bending_moment_of(initial, s) for s in (start, inside))
        # The moments at the points of an element are one column of unknowns.
        moments = at_start, at_nodes.T.reshape(model.n_elements, -1).T
    return StartValues(theta, twist.T, arms.interpolate(problem, arm, inside).T, moments)


def bending_moment_of(initial: InitialEquilibrium, arc_length: Array) -> Array:
    """Bending moment (2, S) that a load causes at arc lengths (S,) of an equilibrium, N m."""
    if initial.load is None:
        return np.zeros((2, len(arc_length)))
    assembly = initial.robot.assembly(initial.translations)
    known, at = initial.points, initial.points.point
    sections = assembly.cross_sections(at, at)
    theta, kb = known.point_rotation - sections.twist_angle + sections.phase, sections.stiffness
    unloaded = section_function("curvature", len(kb), kb.shape[1], False)(theta, kb, sections.moment)[0]
    bending = (known.point_curvature - unloaded) * kb.sum(1)[:, None]
    return np.array([np.interp(arc_length, at, row) for row in bending.T])


class ArmSample(NamedTuple):
    """Quantities of a solved arm at S arc lengths."""

    rotation: Array
    """Rotations theta (n, S), rad; for tubes made of pieces the elastic rotation."""
    torsion: Array
    """Torsion w (n, S), rad/m."""
    curvature: Array
    """Curvature u (2, S), 1/m."""


def sample(model: Model, arc_length: Array) -> ArmSample:
    """Rotation, torsion and curvature of a solved arm at arc lengths (S,), m."""
    start, _ = collocation_points(model)
    inside = functions.inside_function(model.grid)
    base = np.array([1.0, 0, 0, 0]), np.zeros(3)
    columns = []
    for s in arc_length:
        k = max(int(np.searchsorted(start, s, side="right")) - 1, 0)
        x = min((s - start[k]) / model.lengths[k], 1.0) if model.lengths[k] > 0 else 0.0
        _, _, *values = inside(*base, x, *model.element(k))[:5]
        columns.append([np.array(value).ravel() for value in values])
    return ArmSample(*(np.array(table).T for table in zip(*columns, strict=True)))


def poses_of(model: Model) -> tuple[Array, Array]:
    """Quaternions (4, P - 1) and positions (3, P - 1) where all elements but the first begin, by integration."""
    step = functions.pose_function(model.grid)
    q, p = np.array([1.0, 0, 0, 0]), np.zeros(3)
    turns, positions = np.zeros((4, model.n_elements - 1)), np.zeros((3, model.n_elements - 1))
    for k in range(model.n_elements - 1):
        q, p = (np.array(part).ravel() for part in step(q, p, *model.element(k)))
        turns[:, k], positions[:, k] = q, p
    return turns, positions


class JacobiFields(NamedTuple):
    """Unknowns of a margin constraint, by columns; see `add_margin`."""

    ratio: Array
    """Ratio v / y (n n (P - 1),) at the start of every element but the first, 1/m."""
    inside: Array
    """Jacobi fields y (n n K P,) at the points."""
    determinants: Array
    """Fields y (n n P,) at starts of elements, then y - |beta| v (n n,) at the plate, with positive determinants."""


def jacobi_fields(model: Model, margin: float) -> JacobiFields:
    """Jacobi fields of tubes softened by `margin`; every element starts from y = 1 at its distal end."""
    n, m, degree = field_size(model.grid), field_rows(model.grid), model.grid.degree
    step, matrix = functions.fields_function(model.grid), functions.field_matrix_function(model.grid)
    softness = [np.hsplit(np.array(part), model.n_elements) for part in model.softness(margin)]
    fields: Any = np.concatenate([np.eye(n), np.zeros((n, n))])
    ratios, points, begins = [], [], []
    for k in reversed(range(model.n_elements)):
        inputs = [model.lengths[k], *(part[k] for part in softness)]
        # The collocated equations are linear in y at the points: their defect at y = 0, then one solve.
        forced = np.array(step(fields, np.zeros((m, degree * n)), *inputs)[1])
        columns = forced.reshape(m, n, degree).transpose(2, 0, 1).reshape(degree * m, n)
        solved = -np.linalg.solve(np.array(matrix(*inputs)), columns)
        inner = solved.reshape(degree, m, n).transpose(1, 2, 0).reshape(m, n * degree)
        y, v = np.split(np.array(step(fields, inner, *inputs)[0]), 2)
        begins.append(y.ravel(order="F"))
        ratio = v @ np.linalg.pinv(y)
        fields = np.concatenate([np.eye(n), ratio])
        ratios.append(ratio.ravel(order="F"))
        points.append(inner.ravel(order="F"))
    plate = y - np.array(model.plate_compliance).reshape(-1, 1) * v
    return JacobiFields(
        ratio=np.concatenate([*reversed(ratios[:-1]), np.zeros(0)]),
        inside=np.concatenate(points[::-1]),
        determinants=np.concatenate([*reversed(begins), plate.ravel(order="F")]),
    )

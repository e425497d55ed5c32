"""Result of forward kinematics: plain arrays, saved as JSON and npz."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Annotated, Any, Protocol

import numpy as np
from pydantic import Field

from ..block.transcription.arm import ArmShape, CollocationPoints
from ..display import Displayed
from ..errors import InputError
from ..files.field_metadata import form, key, unit
from ..robots.concentric import Friction
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.blas import small
from ..typing import Array, Delegate, Mask, StatusEnum, lazy_import

if TYPE_CHECKING:
    from ..block.transcription.arm import Profile
    from ..block.transcription.reduced import ReducedProblem

# Every torsional stiffness may then be 5 % lower than that of the model before the pose snaps.
MIN_MARGIN = 0.05
"""Default of the smallest allowed margin of planned, solved and designed poses."""


class Status(StatusEnum):
    """Outcome of a solve, as a sentence."""

    STABLE = "a stable equilibrium was found"
    UNSTABLE = "an unstable equilibrium was found: any disturbance makes the robot leave it"
    HELD = "an equilibrium was found that only friction keeps stable: vibration makes the robot leave it"
    NOT_CONVERGED = "no equilibrium was found"
    BRANCH_ENDED = "the branch ends before the target joint values: the robot snaps"
    BRANCH_ENDED_UNDER_LOAD = "the branch from the unloaded equilibrium ends before the full load"
    MESH_TOO_COARSE = "the finest mesh did not reach the tolerance"


@dataclass(frozen=True)
class Statistics(Displayed):
    """Method, mesh, iterations and time of a solve."""

    method: str
    """Solver: "newton", "ipopt", "energy", or "increment" with friction."""
    iterations: int
    """Number of solver iterations."""
    elements: int
    """Number of elements of the mesh."""
    degree: int
    """Degree of the collocation polynomials."""
    start: str
    """Start of the successful solve."""
    seconds: float
    """Solve time without `loading`, s."""
    family: str = "gauss"
    """Family of collocation points."""
    refinement: int = 0
    """Number of times that the default mesh was halved."""
    loading: float = 0.0
    """Time to load the robot's kernel, once per process, or to compile it, once per machine, s."""


@dataclass(frozen=True)
class Verification(Displayed):
    """Difference between the solution and an adaptive re-integration of its initial values (DOP853, 1e-12)."""

    tip_position: Annotated[float, unit("mm"), form(".6g"), "difference of the tip position"]
    tip_rotation: Annotated[float, unit("rad"), form(".6g"), "angle between the tip frames"]
    rotation: Annotated[float, unit("rad"), form(".6g"), "largest difference of a tube's rotation"]
    end_torsion: Annotated[float, unit("rad_per_m"), form(".6g"), "largest remaining torsion at the end of a tube"]
    """Torsion at the tip beyond that of an applied moment; it should be 0."""
    base_rotation: Annotated[float, unit("rad"), form(".6g"), "largest difference from an imposed rotation at the base"]
    end_curvature: Annotated[float, unit("per_m"), form(".6g"), "curvature at the tip without a moment"] = 0.0
    """Curvature at the tip beyond that of an applied moment; it should be 0."""


@dataclass(frozen=True)
class FrictionState:
    """Friction torques of an equilibrium at R contacts; the last ones may be concentrated."""

    friction: Friction
    """Friction law of the tubes."""
    arc_length: tuple[float, ...]
    """(R,) positions of the contacts, m."""
    pair: tuple[int, ...]
    """(R,) numbers of the inner tubes, from 0."""
    torque: tuple[float, ...]
    """(R,) torques on the inner tube by the outer one, N m."""
    capacity: tuple[float, ...]
    """(R,) largest possible torques, N m."""
    held_margin: Annotated[float, "margin with friction; absent without friction"]
    """Smallest eigenvalue of the second variation over motions that keep sticking contacts stuck.

    Stability of the equilibrium without vibration.
    """
    heat: Annotated[
        float, key("friction_heat_mJ"), "heat of friction since the first waypoint; absent without friction"
    ]
    violation: float
    """Largest violation of the friction law, as a slip (rad) or a fraction of the capacity."""

    @property
    def sticking(self) -> Mask:
        """(R,) True where the torque is below the capacity."""
        return np.abs(self.torque) < np.array(self.capacity) * (1 - 1e-12)


@dataclass(frozen=True)
class WallForce(Displayed):
    """Contact of an arm with a wall."""

    body: Annotated[int, "number of the body, from 1"]
    arc_length: Annotated[float, unit("mm"), form(".4f"), "arc length from the base plate"]
    point: Annotated[tuple[float, float, float], unit("mm"), form(".4f"), "point of the centreline"]
    force: Annotated[tuple[float, float, float], unit("mN"), form(".4g"), "force on the arm in the base frame"]

    @property
    def size(self) -> float:
        """Contact force, N."""
        return math.hypot(*self.force)


@dataclass(frozen=True)
class WallState:
    """Contacts of an arm with walls that it cannot enter."""

    contacts: Annotated[tuple[WallForce, ...], "contacts with a force, base to tip"]
    clearance: Annotated[float, unit("mm"), form(".4g"), "smallest distance of the arm's surface from the walls"]
    """About 0 with a contact."""
    load: Load | None
    """Given load; that of the equilibrium also has the contact forces, as forces at points."""
    bodies: Annotated[tuple[Any, ...], Field(exclude=True)] = field(default=(), repr=False)
    """Walls; a saved equilibrium has none."""


@dataclass(frozen=True, eq=False)
class Jacobian(Displayed):
    """Derivatives with respect to `wrt`, n columns for each name in turn: per rad, per m, or per SI unit.

    Tubes on one carriage (the three of an eccentric segment) share the derivative with respect to its translation in
    equal parts. So the chain rule is right for every possible motion.

    Without a compiled kernel for all derivatives at once, those other than of the tip pose are computed when first
    read.
    """

    wrt: tuple[str, ...]
    """Meaning of the columns: "rotations", "translations", or a dimension of the tubes."""
    position: Array
    """(3, Q) derivatives of tip_position, m per unit."""
    rotation: Array
    """(3, Q) rotation vector of the tip frame, in the plate frame, rad per unit."""
    tip_rotations: Array
    """(n, Q) derivatives of theta at each tube's own end, rad per unit."""
    margin: Array
    """(Q,) derivatives of the margin; NaN if it is a double eigenvalue.

    Under a load without an energy they take a hundred times as long, and are NaN where breakpoints meet.
    """
    energy: Array
    """(Q,) derivatives of the elastic energy, J per unit."""

    @property
    def matrix(self) -> Array:
        """(6, Q) geometric Jacobian of the tip: position (m) above the turn of its frame (rad), in the plate frame."""
        return np.concatenate([self.position, self.rotation])

    @classmethod
    def of(cls, derivatives: Callable[[], Derivatives], margin: Callable[[], Array] | None = None) -> Jacobian:
        """Jacobian from `derivatives`, which is called again when more than the pose of the tip is read.

        The derivatives of the margin are those of `margin` if it is given.
        """
        result, jacobian = derivatives(), object.__new__(cls)
        pose = {"position": result.tip_position.copy(), "rotation": result.tip_rotation.copy()}
        jacobian.__dict__.update(wrt=result.wrt, **pose, _derivatives=derivatives, _margin=margin)
        return jacobian

    if not TYPE_CHECKING:  # which would take any name for an attribute

        def __getattr__(self, name: str) -> Array:
            derivatives = self.__dict__.get("_derivatives")
            if derivatives is None or name not in READ_LATER:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            margin = self.__dict__["_margin"]
            with small:
                value = margin() if name == "margin" and margin else getattr(derivatives(), name).copy()
            self.__dict__[name] = value
            return value

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}


READ_LATER = ("tip_rotations", "margin", "energy")
"""Fields of a Jacobian that are computed when they are first read."""


class Derivatives(Protocol):
    """Derivatives of an equilibrium in Q directions, computed when they are read; names as in `Jacobian`."""

    @property
    def wrt(self) -> tuple[str, ...]: ...

    @property
    def size(self) -> int:
        """Number Q of directions."""

    @property
    def shape(self) -> ArmShape:
        """Shape of the arm."""

    @property
    def cuts(self) -> Array:
        """Arc lengths (P + 1,) of the ends of the elements, m."""

    @property
    def moved(self) -> Array:
        """Motion (m, Q) along the arm of the shape points, which stay at fixed fractions of the elements, m."""

    @property
    def tip_position(self) -> Array: ...

    @property
    def tip_rotation(self) -> Array: ...

    @property
    def tip_rotations(self) -> Array: ...

    @property
    def margin(self) -> Array: ...

    @property
    def energy(self) -> Array: ...

    @property
    def position(self) -> Array: ...

    @property
    def bend(self) -> Array: ...

    @property
    def total_bend(self) -> float: ...


@dataclass(frozen=True)
class Accuracy:
    """Residual and estimated discretisation errors of an equilibrium."""

    residual: Annotated[float, unit("rad"), form(".1e", label="residual"), "residual of the equations"]
    """Largest violation of the collocation equations."""
    mesh_error: Annotated[float, unit("rad"), "estimated error of the tubes' rotations"]
    tip_error: Annotated[float, unit("mm"), "estimated error of the tip"]


@dataclass(frozen=True, eq=False)
class Equilibrium(Displayed):
    """Equilibrium of a robot with n tubes, at m points along the arm. SI units, angles not wrapped.

    Fields of its parts are attributes, too: `equilibrium.position` is `equilibrium.arm.position`.
    """

    _brief = ("robot", "rotations", "translations", "tip_position", "margin", "status")

    robot: Robot
    """Robot in equilibrium."""
    rotations: Annotated[Array, unit("deg"), form(".6g", label="rotations"), "rotation of every tube"]
    """(n,) joint rotations, rad."""
    translations: Annotated[Array, unit("mm"), form(".6g", label="translations"), "translation of every tube"]
    """(n,) joint translations, m."""
    arm: ArmShape
    """Centreline with its Bishop frame, and the rotations of the tubes along it."""
    tip_rotations: Annotated[
        Array, unit("deg"), form(".4f", label="rotations at the tips"), "rotation of every tube at its own tip"
    ]
    """(n,) rotations of the tubes at their own ends, rad."""
    section_start: Array
    """(k,) arc length of the breakpoints in front of the plate, m."""
    tube_end: Array
    """(n,) arc length of each tube's end, m."""
    points: CollocationPoints
    """Collocation points of the solution."""
    margin: Annotated[float, "stability margin"]
    """Smallest eigenvalue of the second variation relative to its torsional part. 1: the coupling has no softening
    effect. 0: snap. Negative: unstable. It decreases late and steeply, so it is no distance to a snap.
    """
    index: Annotated[int, "number of unstable directions (Morse index)"]
    """Number of negative eigenvalues of the second variation, 0 for a stable equilibrium."""
    energy: Annotated[float, unit("mJ"), form(".4f"), "elastic energy"]
    """Bending and torsion in front of the plate and torsion of the transmissions."""
    accuracy: Accuracy
    """Residual and error estimates."""
    status: Status
    """Result of the solve."""
    statistics: Statistics
    """Method, mesh, iterations and time."""
    verification: Annotated[Verification | None, "difference from adaptive re-integration"] = None
    """Difference from the independent integration; None unless requested."""
    load: Load | None = None
    """External load, or None."""
    work: float = 0.0
    """Work of dead loads, int n.t ds of the force n on the cross-sections, J.

    0 without a load, NaN for loads without an energy. Contact forces of walls do no work.
    """
    friction: FrictionState | None = None
    """State of the friction, needed to continue a motion with friction; None without friction."""
    walls: WallState | None = None
    """Contacts with walls, which the margin takes into account; None without walls."""

    arc_length, position, frame = Delegate[Array]("arm"), Delegate[Array]("arm"), Delegate[Array]("arm")
    curvature, rotation, torsion = Delegate[Array]("arm"), Delegate[Array]("arm"), Delegate[Array]("arm")
    point, point_rotation, point_curvature = (
        Delegate[Array]("points"),
        Delegate[Array]("points"),
        Delegate[Array]("points"),
    )
    residual, mesh_error, tip_error = (
        Delegate[float]("accuracy"),
        Delegate[float]("accuracy"),
        Delegate[float]("accuracy"),
    )

    @property
    def tip_position(self) -> Array:
        """(3,) end of the tube that reaches farthest, in the plate frame, m."""
        return np.asarray(self.position[-1])

    @property
    def tip_rotation(self) -> Array:
        """(3, 3) frame of the tip."""
        return np.asarray(self.frame[-1])

    @property
    def tip_pose(self) -> Array:
        """(4, 4) homogeneous transformation from the tip to the plate frame: rotation, and position in m."""
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = self.tip_rotation, self.tip_position
        return pose

    def plot(self, path: str | PathLike[str] | None = None) -> Any:
        """Figure of the shape, saved at `path`; see `tubeopt.plot_shape`."""
        return lazy_import("tubeopt.show.plots.shape.plot_shape")(self, path)

    @property
    def value(self) -> Array:
        """(3,) position of the tip, m."""
        return self.tip_position

    @property
    def stable(self) -> bool:
        """True if the margin is positive: the robot stays in this equilibrium."""
        return self.margin > 0

    @property
    def given_load(self) -> Load | None:
        """External load without contact forces of walls, or None."""
        return self.load if self.walls is None else self.walls.load

    @property
    def potential(self) -> float:
        """Potential: elastic energy less the work of dead loads, J; a stable equilibrium is its local minimum."""
        return self.energy - self.work

    @cached_property
    def snap_distance(self) -> float:
        """Largest rotation of all tubes, either way, that is proved to cause no snap, rad."""
        result: float = lazy_import("tubeopt.stability.snap_distance.snap_distance")(self).turn
        return result

    @cached_property
    def compliance(self) -> Array:
        """(6, 6) compliance of the tip: force (N) and moment (N m) -> translation (m) and rotation (rad), world axes.

        For small dead forces and moments, with or without load, on a robot with an energy. The rotation is that of the
        tube that ends last; of several concentric tubes, the innermost.
        """
        result: Array = lazy_import("tubeopt.equilibrium.jacobian.compliance_of")(self)
        return result

    def compliance_at(self, arc_length: float, tube: int | None = None) -> Array:
        """(6, 6) compliance at an arc length (m): motion (m, rad) of a cross-section per small dead load (N, N m).

        In world axes, for a robot with an energy.

        Args:
            tube: the tube, from 0, that carries the moment and is measured. By default the outermost tube there, or the
                sheath of an eccentric robot; at the tip the tube that ends last.

        Raises:
            InputError: an arc length outside the arm, or a tube that is not there.
        """
        result: Array = lazy_import("tubeopt.equilibrium.jacobian.compliance_at")(self, arc_length, tube)
        return result

    @cached_property
    def base_wrench(self) -> Array:
        """(6,) force (N) and moment about the plate's point (N m) that the load puts on the plate, world axes."""
        result: Array = lazy_import("tubeopt.equilibrium.jacobian.base_wrench_of")(self)
        return result

    def jacobian(self, *, wrt: Sequence[str] = ("rotations", "translations"), side: int = 1) -> Jacobian:
        """Derivatives of tip pose, margin and energy by joint values and dimensions; see `equilibrium.jacobian`."""
        result: Jacobian = lazy_import("tubeopt.equilibrium.jacobian.jacobian")(self, wrt=wrt, side=side)
        return result

    def margin_slopes(self, *, wrt: Sequence[str] = ("rotations", "translations")) -> Array:
        """(Q,) derivatives of the margin, as in `jacobian`."""
        return self.jacobian(wrt=wrt).margin

    def collocated(self) -> tuple[ReducedProblem, Profile]:
        """The collocated problem of this equilibrium, and its torsion along the arm; not with a load or friction.

        Raises:
            SolveError: Newton's method leaves the equilibrium: it is a fold.
        """
        result: tuple[ReducedProblem, Profile] = lazy_import("tubeopt.equilibrium.kinematics.collocated")(self)
        return result

    def at(
        self,
        robot: Robot,
        rotations: Array,
        translations: Array,
        rotation_at: Callable[[Array], Array] | None = None,
        *,
        load: Load | None = None,
        curvature_at: Callable[[Array], Array] | None = None,
    ) -> Equilibrium:
        """An equilibrium of a robot at joint values, from given rotations along the arm or cold.

        Args:
            rotation_at: rotations (n, P) of the tubes at arc lengths (P,) that start the solve, stable or not; the
                elastic rotations for tubes made of pieces. None solves cold by `forward_kinematics`.
            load, curvature_at: external load, and the curvatures (2, P) that start the solve under it.

        Raises:
            SolveError: no equilibrium was found.
        """
        result: Equilibrium = lazy_import("tubeopt.equilibrium.kinematics.equilibrium_at")(
            robot, rotations, translations, rotation_at, load=load, curvature_at=curvature_at
        )
        return result

    def verified(self) -> Equilibrium:
        """Same equilibrium with its `verification` by adaptive re-integration."""
        result: Equilibrium = lazy_import("tubeopt.equilibrium.verification.verify_equilibrium")(self)
        return result

    def save(self, directory: str | PathLike[str]) -> None:
        """Write `result.json` and `arrays.npz` into `directory`; `load_equilibrium` reads them back."""
        lazy_import("tubeopt.equilibrium.file.save_equilibrium")(self, directory)


def refuse_load(equilibrium: Equilibrium) -> None:
    """Raise InputError for an equilibrium with a load or friction, in functions that support neither."""
    if equilibrium.load is not None:
        raise InputError("the equilibrium has a load; this function supports equilibria without load only")
    refuse_contact(equilibrium)


def refuse_friction(equilibrium: Equilibrium) -> None:
    """Raise InputError for an equilibrium with friction, in functions that do not support it."""
    if equilibrium.friction is not None:
        raise InputError("the equilibrium has friction; this function supports equilibria without friction only")


def refuse_contact(equilibrium: Equilibrium) -> None:
    """Raise InputError for an equilibrium with friction or with contact forces of walls, as `refuse_friction`."""
    refuse_friction(equilibrium)
    if equilibrium.walls is not None and equilibrium.walls.contacts:
        raise InputError("the equilibrium touches walls; this function supports equilibria without contact only")


def small_turn(turn: Array) -> Array:
    """(3,) turn vector of a small turn (3, 3), or of the rate of one: the antisymmetric part, which loses no digits."""
    return np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2

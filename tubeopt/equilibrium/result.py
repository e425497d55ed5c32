"""The result of a forward-kinematics solve: plain arrays, saved as JSON + npz."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np

from ..display import Displayed
from ..errors import InputError
from ..robots.friction import Friction
from ..robots.load import Load
from ..robots.robot import Robot
from ..typing import Array, Mask, Sentence, late

if TYPE_CHECKING:
    from ..block.transcription.arm import Profile
    from ..block.transcription.reduced import ReducedProblem


class Status(Sentence):
    """What became of a solve; every value reads as a sentence."""

    STABLE = "a stable equilibrium was found"
    UNSTABLE = "an unstable equilibrium was found: the robot would leave it at the slightest touch"
    HELD = "an equilibrium was found that friction alone holds: shaken, the robot leaves it"
    NO_MARGIN = (
        "an equilibrium was found; moments and forces that turn with the tip have no energy, so it has no margin"
    )
    NOT_CONVERGED = "no equilibrium was found"
    BRANCH_ENDED = "the branch that was followed ends before the wanted joint values: the robot snaps"
    BRANCH_ENDED_UNDER_LOAD = "the branch that grows from no load is lost before the whole load is on"
    MESH_TOO_COARSE = "the wanted tolerance was not reached on the finest mesh"


@dataclass(frozen=True)
class Statistics(Displayed):
    """How a solve went: method, iterations, elements of the mesh and their degree, and on which points."""

    method: str
    iterations: int
    elements: int
    degree: int
    start: str
    """How the answer was reached."""
    seconds: float
    """That the solve took, `loading` apart."""
    family: str = "gauss"
    """Of collocation."""
    refinement: int = 0
    """How often the pieces of the default mesh were halved."""
    loading: float = 0.0
    """Seconds in which the robot's kernel was got ready first: in a process loaded once, on a machine compiled once."""


@dataclass(frozen=True)
class Verification(Displayed):
    """Difference between the solution and an adaptive re-integration of its initial values (DOP853, 1e-12)."""

    tip_position: float
    """m"""
    tip_rotation: float
    """Angle between both, rad."""
    rotation: float
    """Largest of a theta_i(s), rad."""
    end_torsion: float
    """Largest torsion at a tube's own end, rad/m, which should be 0."""
    base_rotation: float
    """Largest difference from the rotations that are imposed, rad."""


@dataclass(frozen=True)
class FrictionState:
    """What friction does in an equilibrium, at R places where tubes rub, of which the last may be concentrated.

    friction: as given.   arc_length: (R,) m.   pair: (R,) the inner tube, from 0.
    torque: (R,) N m that the outer tube bears at the place against the inner one.   capacity: (R,) N m, what it can be.
    held_margin: least eigenvalue of the second variation, relative to its torsional part, along all motions in which
        what sticks goes on sticking: how stable the equilibrium is while nothing shakes it.
    heat: what friction has taken since the history began, J.
    violation: of the laws of friction, as a slip (rad) or a part of the capacity.
    """

    friction: Friction
    arc_length: tuple[float, ...]
    pair: tuple[int, ...]
    torque: tuple[float, ...]
    capacity: tuple[float, ...]
    held_margin: float
    heat: float
    violation: float

    @property
    def sticking(self) -> Mask:
        """(R,) whether a place bears less than it could."""
        return np.abs(self.torque) < np.array(self.capacity) * (1 - 1e-12)


@dataclass(frozen=True, eq=False)
class Jacobian(Displayed):
    """Derivatives with respect to `wrt`, n columns for each name in turn: per rad, per m, or per SI unit.

    Tubes that one carriage moves (the three of an eccentric segment) share the derivative with respect to its
    translation in equal parts, so that the chain rule holds for every motion that is possible.

    Attributes:
        wrt: of what the columns are: "rotations", "translations", or a dimension of the tubes.
        position: (3, Q) of tip_position.  rotation: (3, Q) turn vector of the tip frame, in the plate frame, rad.
        tip_rotations: (n, Q) of theta at each tube's own end.
        margin: (Q,); NaN where the margin is a double eigenvalue.  energy: (Q,), J.
    """

    wrt: tuple[str, ...]
    position: Array
    rotation: Array
    tip_rotations: Array
    margin: Array
    energy: Array


@dataclass(frozen=True, eq=False)
class Equilibrium(Displayed):
    """One equilibrium of a robot; n tubes, m points along the arm. SI units, angles not wrapped.

    Attributes:
        robot, rotations (n,), translations (n,): the input.
        tip_position (3,), tip_rotation (3, 3): pose of the end of the longest tube in the plate frame.
        arc_length (m,), position (m, 3), frame (m, 3, 3), curvature (m, 2): centreline with its Bishop frame, and the
            curvature vector in that frame.
        rotation (n, m), torsion (n, m): theta_i(s) and its derivative; beyond a tube's end constant, and 0.
        tip_rotations (n,): theta_i at each tube's own end.
        section_start (k,): arc length of the breakpoints in front of the plate.
        tube_end (n,): arc length of each tube's end.
        point (N,), point_rotation (N, n): arc length of the collocation points, and theta_i there of the
            tubes that are coupled there (their base rotation for the others): where a warm start begins.
        margin: smallest eigenvalue of the second variation relative to its torsional part; 1 no elastic coupling,
            0 a snap, below 0 unstable.
        index: number of negative eigenvalues of the second variation, 0 for a stable equilibrium.
        energy: bending and torsion in front of the plate and torsion of the transmissions, J.
        residual: largest violation of the collocation equations, rad.
        mesh_error: estimated largest error of theta_i(s), rad.   tip_error: estimated error of tip_position, m.
        status, statistics: how the solve ended, and its cost.
        verification: comparison with an adaptive re-integration, where asked for.
        load: the load that the robot bears, None without one.
        work: int n.t ds of the force n on the cross-sections, what dead loads do on the arm, J; 0 without load, NaN for
            loads that have no energy.
        point_curvature (N, 2): curvature at the collocation points under load; empty without one.
        friction: what friction does, and where a motion with friction goes on from; None without friction.
    """

    _brief = ("robot", "rotations", "translations", "tip_position", "margin", "status")

    robot: Robot
    rotations: Array
    translations: Array
    tip_position: Array
    tip_rotation: Array
    arc_length: Array
    position: Array
    frame: Array
    curvature: Array
    rotation: Array
    torsion: Array
    tip_rotations: Array
    section_start: Array
    tube_end: Array
    point: Array
    point_rotation: Array
    margin: float
    index: int
    energy: float
    residual: float
    mesh_error: float
    tip_error: float
    status: Status
    statistics: Statistics
    verification: Verification | None = None
    load: Load | None = None
    work: float = 0.0
    point_curvature: Array = field(default_factory=lambda: np.zeros(0))
    friction: FrictionState | None = None

    @property
    def value(self) -> Array:
        """(3,) m, where the tip is: what forward kinematics is asked for."""
        return self.tip_position

    @property
    def stable(self) -> bool:
        """Whether the robot stays in this equilibrium: margin > 0. Not told, so False, where there is no margin."""
        return self.margin > 0

    @property
    def potential(self) -> float:
        """Elastic energy less the work of dead loads, J: what a stable equilibrium makes least."""
        return self.energy - self.work

    @cached_property
    def compliance(self) -> Array:
        """(6, 6) translation (m) and rotation (rad) of the tip by a small dead force (N) and moment (N m) there, in
        world axes; with or without load, concentric tubes only. The rotation is that of the tube that ends last."""
        found: Array = late("tubeopt.equilibrium.loaded.compliance_of")(self)
        return found

    def compliance_at(self, arc_length: float, tube: int | None = None) -> Array:
        """(6, 6) translation (m) and rotation (rad) of the arm at an arc length (m) by a small dead force (N) and
        moment (N m) there, in world axes; concentric tubes, without load or under forces that keep their direction.

        Args:
            tube: from 0, on which the moment acts and whose rotation is told; by default the outermost there.

        Raises:
            InputError: a place that is not on the arm, a tube that is not there, a load without an energy.
        """
        found: Array = late("tubeopt.equilibrium.loaded.compliance_at")(self, arc_length, tube)
        return found

    @cached_property
    def base_wrench(self) -> Array:
        """(6,) force (N) and moment about the plate's point (N m) that the load puts on the plate, world axes."""
        found: Array = late("tubeopt.equilibrium.loaded.base_wrench_of")(self)
        return found

    def jacobian(self, *, wrt: Sequence[str] = ("rotations", "translations"), side: int = 1) -> Jacobian:
        """Derivatives of tip pose, margin and energy by joint values and dimensions; see `equilibrium.jacobian`."""
        found: Jacobian = late("tubeopt.equilibrium.jacobian.jacobian")(self, wrt=wrt, side=side)
        return found

    def collocated(self) -> tuple[ReducedProblem, Profile]:
        """The collocated problem that it solves, and the torsion along its arm; with a load or friction there is none.

        Raises:
            SolveError: Newton's method does not stay at the equilibrium: it is a fold.
        """
        found: tuple[ReducedProblem, Profile] = late("tubeopt.equilibrium.solving.collocated")(self)
        return found

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
        """An equilibrium of a robot at joint values: `forward_kinematics` cold, or, stable or not, from where rotations
        (n, P) of its tubes at arc lengths (P,) begin; of tubes made of pieces these are the elastic rotations. Under
        `load` curvatures (2, P) belong to them.

        Raises:
            SolveError: there is none.
        """
        found: Equilibrium = late("tubeopt.equilibrium.anew.equilibrium_at")(
            robot, rotations, translations, rotation_at, load=load, curvature_at=curvature_at
        )
        return found

    def verified(self) -> Equilibrium:
        """The same, with its `verification` by adaptive re-integration."""
        found: Equilibrium = late("tubeopt.equilibrium.verification.verify_equilibrium")(self)
        return found

    def save(self, directory: str | PathLike[str]) -> None:
        """Write `result.json` and `arrays.npz` into `directory`; `load_equilibrium` reads them back."""
        late("tubeopt.equilibrium.file.save_equilibrium")(self, directory)


def refuse_load(equilibrium: Equilibrium) -> None:
    """Raise InputError for an equilibrium under load or friction, where what is asked knows of neither."""
    if equilibrium.load is not None:
        raise InputError("the equilibrium bears a load, which is not supported here; give one without load")
    if equilibrium.friction is not None:
        raise InputError("the equilibrium bears friction, which is not supported here; give one without friction")


def small_turn(turn: Array) -> Array:
    """(3,) turn vector of a small turn (3, 3), or of the rate of one: the antisymmetric part, which loses no digits."""
    return np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]]) / 2


ALONG_THE_ARM = ("arc_length", "position", "frame", "curvature", "rotation", "torsion")
"""Arrays with a value per point."""

ARRAYS = tuple(field.name for field in dataclasses.fields(Equilibrium) if field.type == "Array")
"""Names of the array fields, in order."""

"""Requirements of a design. Every requirement is data; `design.constraints` turns it into constraints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np

from ..arguments import typed
from ..block.custom import CustomRequirement
from ..block.quantities import Quantities
from ..bodies.corridors import Corridor as Vessel
from ..bodies.obstacles import Obstacle, checked_obstacles, scene_of
from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import MIN_MARGIN, Equilibrium
from ..errors import InputError, choice, finite, finite_array, instance, items, numbers, positive, triple, vector, whole
from ..files.field_metadata import NOT_NEGATIVE, POSITIVE, REQUIRED, Checked, Typical, check_fields, key, unit
from ..robots.load import ZERO, Load
from ..robots.order import last_tube
from ..robots.robot import Robot
from ..robots.tubes import Tube
from ..typing import Array, Mask

# Fractions of the arm's length at which a deployment is checked.
DEPLOYED_FRACTIONS = (0.25, 0.5, 0.75)

# Fractions of a withdrawn arm at which its distance from the whole arm is checked.
ALONG = (0.5, 0.75, 1.0)


class Retracted(NamedTuple):
    """Arm with withdrawn tubes, so that it has a fraction of its length."""

    translations: Array
    """Translations (n,), m."""
    withdrawn: Mask
    """Mask (n,) of the tubes that end beyond the fraction and are withdrawn."""
    last: int
    """The tube that ends last."""


def retracted(tubes: Sequence[Tube], translations: Array, fraction: float) -> Retracted:
    """The arm at translations (n,), m, withdrawn to a fraction of its length."""
    ends = translations + np.array([tube.length - tube.straight_length for tube in tubes])
    last = int(last_tube(ends))
    beyond = ends - fraction * ends[last]
    return Retracted(translations - np.maximum(beyond, 0.0), beyond > 0, last)


def draw(robot: Robot, equilibrium: Equilibrium, fraction: float) -> Equilibrium:
    """The arm of a pose withdrawn to a fraction of its length, by forward kinematics."""
    return forward_kinematics(
        robot, equilibrium.rotations, retracted(robot.tubes, equilibrium.translations, fraction).translations
    )


Rows = tuple[tuple[float, ...], ...]


def _rows(name: str, values: Any) -> Rows:
    return tuple(tuple(row) for row in finite_array(name, values, 2).tolist())


@dataclass(frozen=True)
class SnapFree(Displayed):
    """Requirement of no snap at any rotation: certificate mu_cert >= margin.

    Over a box the worst case counts, found by exchange.
    """

    margin: Annotated[float, "required certificate, below 1"] = 0.05
    translations: Annotated[
        Rows | None, unit("mm"), "translations with the required certificate, one row per configuration; default all 0"
    ] = None
    box: Annotated[
        tuple[tuple[float, ...], tuple[float, ...]] | None, unit("mm"), "smallest and largest translations"
    ] = None
    tolerance: Annotated[float, POSITIVE, "tolerance on the required margin inside the box"] = 1e-4
    max_force: Annotated[
        float,
        key("max_tip_force_mN"),
        NOT_NEGATIVE,
        "the margin is certified for every dead tip force up to this size, in any direction",
    ] = 0.0
    curvature_error: Annotated[
        float, unit("percent"), NOT_NEGATIVE, "the margin is certified for relative curvature errors up to this"
    ] = 0.0
    stiffness_error: Annotated[
        float,
        unit("percent"),
        NOT_NEGATIVE,
        "the margin is certified for relative errors of bending and torsional stiffness up to this",
    ] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "the certificate")
        if self.margin >= 1:
            raise InputError(f"margin of the certificate is {self.margin:g}; it must be less than 1")
        for name in ("curvature_error", "stiffness_error"):
            if (value := getattr(self, name)) >= 1:
                raise InputError(f"{name} of the certificate is {value:.6g}; it must be less than 1")
        if self.max_force and self.growth > 1:
            raise InputError("max_force and tube errors are both given; a certificate covers one of them")
        if self.max_force and self.box is not None:
            raise InputError("max_force and box are both given; a certificate under force needs fixed translations")
        if self.translations is not None:
            object.__setattr__(self, "translations", _rows("translations of the certificate", self.translations))
        if self.box is not None:
            rows = _rows("box of translations", self.box)
            if len(rows) != 2:
                raise InputError(
                    f"box of translations has {len(rows)} rows; it must have 2, the smallest and the largest"
                )
            low, high = rows
            if any(a > b for a, b in zip(low, high, strict=True)):
                raise InputError("box of translations: the first row must not exceed the second")
            object.__setattr__(self, "box", (low, high))

    @property
    def growth(self) -> float:
        """Largest growth factor of 1 - mu_cert if every tube deviates by the errors, each on its own.

        Let c and s be the errors of curvature and stiffness. The coupling c_ij = kb_i kappa_i kb_j kappa_j / sum kb
        grows by at most ((1 + c)(1 + s))^2 / (1 - s). The torsional part of the second variation falls by at most 1 -
        s. 1 - mu_cert is the largest quotient of a sum of |c_ij| with that part.
        """
        c, s = self.curvature_error, self.stiffness_error
        return ((1 + c) * (1 + s) / (1 - s)) ** 2

    @property
    def required_margin(self) -> float:
        """Certificate of the nominal tubes that ensures the margin for all tubes within the errors."""
        return 1 - (1 - self.margin) / self.growth

    def eased(self, amount: float) -> SnapFree:
        """Requirement with its minimum margin lowered by `amount`."""
        return replace(self, margin=1 - (1 - self.required_margin + amount) * self.growth)


@dataclass(frozen=True)
class SnapFreeInUse:
    """Requirement of no snap at every task pose and, with `paths`, on the straight paths between them."""

    margin: Annotated[float, POSITIVE, "smallest allowed margin at poses and on paths"] = MIN_MARGIN
    paths: Annotated[bool, "check the straight joint path from each pose to the next"] = True
    deployed: Annotated[bool, "check the arm while it is deployed along a straight line to each pose"] = False
    tolerance: Annotated[float, POSITIVE, "tolerance on the required margin on paths"] = 1e-3

    def __post_init__(self) -> None:
        check_fields(self, "the robot in use")
        if self.margin >= 1:
            raise InputError(f"margin in use is {self.margin:g}; it must be between 0 and 1")


@dataclass(frozen=True)
class Strain:
    """Largest bending strain of every tube: when straightened, and at every task pose, r |u - u*| / (1 - r |u*|).

    Joint paths between poses are not checked.
    """

    limits: Annotated[
        tuple[float, ...],
        unit("percent"),
        REQUIRED,
        POSITIVE,
        Typical(1e-4, 1.0),
        "one limit per tube, or one for all",
    ] = (0.01,)
    straightened: Annotated[bool, "limit the strain of straightened tubes"] = True
    in_poses: Annotated[bool, "limit the strain at every task pose"] = True

    def __post_init__(self) -> None:
        limits = numbers("limits of the strain", self.limits)
        if not limits:
            raise InputError("limits of the strain is empty; it must be one, or one per tube")
        object.__setattr__(self, "limits", tuple(positive("strain limit", limit) for limit in limits))
        check_fields(self, "the strain")


@dataclass(frozen=True)
class Nesting(Checked):
    """Smallest difference of diameters, m, between a tube and the tube around it."""

    clearance: Annotated[
        float,
        key("clearance_mm"),
        NOT_NEGATIVE,
        Typical(1e-6, 0.01),
        "smallest difference between the inner diameter of a tube and the outer diameter of the tube inside it",
    ] = 0.0
    _owner = "nested tubes"


@dataclass(frozen=True)
class Wall(Checked):
    """Smallest wall thickness of all tubes, m."""

    thickness: Annotated[float, key("wall_mm"), POSITIVE, Typical(1e-5, 0.01), "smallest wall thickness"]
    _owner = "a wall"


@dataclass(frozen=True)
class Channel(Checked):
    """Smallest diameter of the largest free circle between the tubes of an eccentric robot, m."""

    diameter: Annotated[
        float,
        key("channel_mm"),
        POSITIVE,
        Typical(1e-5, 0.05),
        "smallest diameter of the free circle between the tubes of an eccentric robot",
    ]
    _owner = "a channel"


@dataclass(frozen=True)
class Bore(Checked):
    """Smallest inner diameter, m, of every tube that contains no other one."""

    diameter: Annotated[
        float, key("bore_mm"), POSITIVE, Typical(1e-5, 0.05), "smallest inner diameter of tubes without one inside"
    ]
    _owner = "a bore"


@dataclass(frozen=True)
class Girth(Checked):
    """Largest inner diameter of the sheath of an eccentric robot, m."""

    limit: Annotated[
        float,
        key("girth_mm"),
        POSITIVE,
        Typical(1e-5, 0.1),
        "largest inner diameter of the sheath of an eccentric robot",
    ]
    _owner = "a girth"


LENGTHS = ("length", "straight_length", "curved_length")


@dataclass(frozen=True)
class Length:
    """Largest length (overall, straight or curved) of one tube (from 0), m; with `least` the smallest length."""

    field: str
    tube: int
    limit: float
    least: bool = False

    def __post_init__(self) -> None:
        choice("length", self.field, LENGTHS)
        whole("tube of a length", self.tube)
        positive("limit of a length", self.limit)
        instance("least of a length", self.least, bool)


@dataclass(frozen=True)
class Stroke(Checked):
    """Largest travel of a carriage between any two task poses, m."""

    limit: Annotated[
        float, key("stroke_mm"), POSITIVE, Typical(1e-4, 5.0), "largest travel of a carriage between task poses"
    ]
    _owner = "a stroke"


@dataclass(frozen=True)
class StrokeForce:
    """Smallest force along the tip, N, that makes the arm buckle or snap in a task pose with given joint values."""

    limit: Annotated[float, key("stroke_force_mN"), POSITIVE, "smallest axial tip force that every pose must withstand"]

    def __post_init__(self) -> None:
        if positive("stroke force", self.limit) > 10:
            raise InputError(f"stroke force is {self.limit:g} N; it must be at most 10 N")


@dataclass(frozen=True)
class Target:
    """Target position and direction of the tip."""

    position: Annotated[tuple[float, float, float], unit("mm"), Typical(1e-3, 10.0), "position in the base frame"]
    tolerance: Annotated[float, unit("mm"), POSITIVE, Typical(1e-9, 0.1), "largest distance between tip and target"] = (
        1e-4
    )
    direction: Annotated[
        tuple[float, float, float] | None, "direction of the tip, any length; default any direction"
    ] = None
    direction_tolerance: Annotated[float, unit("deg"), POSITIVE, "largest angle between tip and direction"] = (
        np.radians(2.0)
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", triple("position of a target", self.position))
        check_fields(self, "a target")
        if self.direction is not None:
            d = vector("direction of a target", self.direction, 3, "x, y, z")
            size = float(np.linalg.norm(d))
            if size == 0:
                raise InputError("direction of a target is 0, 0, 0; it must point somewhere")
            object.__setattr__(self, "direction", tuple((d / size).tolist()))
            if self.direction_tolerance >= np.pi / 2:
                raise InputError(
                    f"direction_tolerance is {self.direction_tolerance:g} rad; it must be between 0 and pi/2"
                )


@dataclass(frozen=True)
class Reach:
    """Requirement that the tip reaches every target; each is a task pose with free joint values."""

    targets: tuple[Target, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "targets", items("targets", self.targets, Target, "Target"))
        if not self.targets:
            raise InputError("targets is empty; reach needs at least one target")


@dataclass(frozen=True)
class Coverage:
    """The tip reaches every point of a box, checked at its corners and at Sobol points."""

    lower: Annotated[tuple[float, float, float], unit("mm"), "corner with the smallest coordinates"]
    upper: Annotated[tuple[float, float, float], unit("mm"), "corner with the largest coordinates"]
    tolerance: Annotated[float, unit("mm"), POSITIVE, Typical(1e-9, 0.1), "largest distance between tip and target"] = (
        1e-3
    )
    samples: Annotated[int, NOT_NEGATIVE, "number of Sobol points inside the box"] = 32

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):
            object.__setattr__(self, name, triple(f"{name} corner of the workspace box", getattr(self, name)))
        if any(a > b for a, b in zip(self.lower, self.upper, strict=True)):
            raise InputError("the workspace box: the lower corner must not exceed the upper corner")
        check_fields(self, "the workspace box")
        whole("samples of the workspace box", self.samples, 0)


@dataclass(frozen=True)
class Poses:
    """Task poses with given joint values: rotations (T, n) rad, translations (T, n) m."""

    rotations: Rows
    translations: Rows

    def __post_init__(self) -> None:
        for name in ("rotations", "translations"):
            object.__setattr__(self, name, _rows(f"{name} of the poses", getattr(self, name)))
        if len(self.rotations) != len(self.translations):
            raise InputError("poses have as many rows of rotations as of translations")


def deviations(q: Quantities, poses: Sequence[int]) -> Any:
    """Vectors (3 K,), m, between the fully and the partly deployed arm, for all poses one after the other."""
    return ca.vertcat(
        *(
            q.poses[k].retracted(fraction).position(along) - q.poses[k].position(fraction * along)
            for k in poses
            for fraction in DEPLOYED_FRACTIONS
            for along in ALONG
        )
    )


@dataclass(frozen=True)
class Deployment(Checked, CustomRequirement):
    """Largest distance, m, of the partly deployed arm from the fully deployed arm, for every task pose.

    The arm is deployed along straight lines in translation. It is checked at DEPLOYED_FRACTIONS of its length, at the
    fractions ALONG of each partly deployed arm.
    """

    limit: Annotated[
        float,
        key("deployment_mm"),
        POSITIVE,
        Typical(1e-6, 0.2),
        "largest distance between the deploying arm and the fully deployed arm",
    ]
    description, unit, factor, size, is_upper_bound = "deviation of the deployment", "mm", 1e3, 1e-3, True
    _owner = description

    def expression(self, q: Quantities) -> Any:
        """Limit minus the distance, at every checked point."""
        gaps = ca.reshape(deviations(q, range(len(q.poses))), 3, -1)
        return self.limit - ca.sqrt(ca.sum1(gaps**2).T + ROUNDED**2)


@dataclass(frozen=True)
class Deflection(Checked, CustomRequirement):
    """Largest displacement of the tip, m, by a dead force and moment on it, in every task pose."""

    limit: Annotated[float, unit("mm"), POSITIVE, REQUIRED, Typical(1e-6, 1.0), "largest displacement of the tip"] = (
        1e-3
    )
    tip_force: Annotated[tuple[float, float, float], unit("mN"), "force on the tip, in the base frame"] = ZERO
    tip_moment: Annotated[tuple[float, float, float], unit("mN_m"), "moment on the tip, in the base frame"] = ZERO
    description, unit, factor, size, is_upper_bound = "tip deflection under the required load", "mm", 1e3, 1e-3, True
    _owner = "a deflection"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("tip_force", "tip_moment"):
            object.__setattr__(self, name, triple(f"{name} of a deflection", getattr(self, name)))
        if not any((*self.tip_force, *self.tip_moment)):
            raise InputError("tip_force and tip_moment of a deflection are 0; one must not be 0")

    def expression(self, q: Quantities) -> Any:
        """Limit minus the displacement, in every task pose."""
        moved = [pose.deflection(Load(self.tip_force, self.tip_moment)) for pose in q.poses]
        return ca.vertcat(*(self.limit - ca.sqrt(ca.sumsqr(each) + ROUNDED**2) for each in moved))


# Length (m) by which norms are smoothed at 0, where they have no derivative.
ROUNDED = 1e-6


@dataclass(frozen=True)
class Avoid:
    """Smallest distance (m) of the arm's surface from all obstacles at every task pose.

    With `deployed` also for partly deployed arms, at DEPLOYED_FRACTIONS of the length. Joint paths between poses are
    not checked: `plan_trajectory` finds and proves them.
    """

    obstacles: tuple[Obstacle, ...]
    clearance: float = 0.0
    deployed: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "obstacles", checked_obstacles(self.obstacles))
        if not self.obstacles:
            raise InputError("obstacles is empty; there must be at least one to avoid")
        finite("clearance of the obstacles", self.clearance)
        instance("deployed", self.deployed, bool)

    def signed_distance(self, points: Array) -> Array:
        """Distances (m,) of points (m, 3) from the nearest obstacle, m, < 0 inside."""
        return scene_of(self.obstacles).nearest(points)

    def gradient(self, points: Array) -> Array:
        """Gradients (m, 3) of `signed_distance`."""
        return scene_of(self.obstacles).gradient(points)


@typed
def Corridor(centreline: tuple[tuple[float, float, float], ...], radius: float | tuple[float, ...]) -> Avoid:
    """`Avoid` for everything outside a corridor: at every task pose the whole arm lies within it.

    Args:
        centreline: (N, 3) points of a polyline, m.
        radius: radius of the corridor, m: one number or one per point.
    """
    return Avoid((Vessel(centreline, radius),))


Requirement = (
    SnapFree
    | SnapFreeInUse
    | Strain
    | Nesting
    | Wall
    | Channel
    | Bore
    | Girth
    | Length
    | Stroke
    | StrokeForce
    | Reach
    | Coverage
    | Poses
    | Avoid
    | CustomRequirement
)
"""Requirement on a design."""


def of_kind(requirements: Sequence[Requirement], kind: type[Any]) -> list[Any]:
    """Requirements of one kind, in order."""
    return [requirement for requirement in requirements if isinstance(requirement, kind)]

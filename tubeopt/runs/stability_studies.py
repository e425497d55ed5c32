"""Studies of stability: equilibria, snaps on a path, motion through waypoints, certificate, map, load limit."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field, PrivateAttr, ValidationInfo, model_validator

from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.readings import to_model
from ..equilibrium.result import Equilibrium
from ..files.checked import NotNegative, Positive, Whole, in_file
from ..files.field_metadata import Typical, form, key, unit
from ..robots.concentric import friction_of
from ..robots.file import Waypoints, load_waypoints
from ..robots.load import Load
from ..robots.robot import Robot
from ..stability import (
    ASSUMING,
    Finding,
    LoadLimit,
    Path,
    Snap,
    SnapAssessment,
    SnapInTime,
    StabilityMap,
    WorstCertificate,
    assess_snapping,
    find_equilibria,
    find_load_limit,
    find_snap,
    find_stroke_force,
    follow,
    snap_free_certificate,
    snap_in_time,
    stability_map,
    worst_certificate,
)
from ..stability.certificate import ROUNDING
from ..stability.snap_in_time import RELAXATION
from ..typing import Array, Progress
from ..validation.certainty import certificate_bounds
from .robot_keys import (
    HOME,
    SHIFTED,
    ExternalLoad,
    Joints,
    Loaded,
    OnePerTube,
    Posed,
    RobotPath,
    Translations,
    joints_of,
)
from .study_file import Arguments, Options, Timed, question, rewording
from .surroundings_file import WallBodies


@dataclass(frozen=True, eq=False)
class Equilibria(Displayed):
    """All equilibria of a robot at given joint values, lowest energy first."""

    robot: Robot
    rotations: Array
    """(n,) rotations of the joints, rad."""
    translations: Array
    """Translations (n,), m."""
    equilibria: Annotated[
        tuple[Equilibrium, ...], "all equilibria, the lowest energy first; without an energy the largest margin first"
    ]


@question("searching equilibria")
def equilibria(robot: RobotPath, joints: Joints, load: ExternalLoad) -> Equilibria:
    """Every equilibrium of a robot at given joint values, stable and unstable."""
    return Equilibria(robot, *joints, tuple(find_equilibria(robot, *joints, load=load)))


@dataclass(frozen=True, eq=False)
class StraightMotion(Displayed):
    """First snap on a straight joint path, or the equilibrium at its end."""

    robot: Robot
    """Robot that moves."""
    start: tuple[Array, Array]
    """Rotations (n,), rad, and translations (n,), m."""
    end: tuple[Array, Array]
    """Rotations (n,), rad, and translations (n,), m."""
    snap: Annotated[Snap | None, "the snap; null without one"]
    arrived: Annotated[Equilibrium | None, "equilibrium at the end of a path without a snap"]
    """Equilibrium at the end of the motion; None if the robot snaps."""
    in_time: Annotated[SnapInTime | None, "the snap in time; absent unless requested"] = None
    """None unless requested, and without a snap."""


WaypointsPath = Annotated[
    Waypoints,
    in_file(load_waypoints, "a CSV file", of="robot"),
    Field(description="path of the CSV file of waypoints, relative to this file"),
]


class SnapStudy(Loaded, Timed):
    """First snap on the straight path between two sets of joint values."""

    doing = "searching for the snap"

    kind: Literal["snap"]
    robot: RobotPath
    from_deg: OnePerTube | None = Field(
        None, description="rotations at the start; default 0, or the nearest allowed value"
    )
    to_deg: OnePerTube | None = Field(None, description="rotations at the end; default those of the start")
    from_mm: OnePerTube | None = Field(None, description=f"translations at the start; default {HOME}")
    to_mm: OnePerTube | None = Field(None, description="translations at the end; default those of the start")
    in_time: bool = Field(False, description="simulate the snap in time, with inertia and material damping")
    quasi_static_bending: bool = Field(
        False, description="in time: leave out the mass of the arm, so that only its tubes have inertia"
    )
    relaxation_us: Annotated[NotNegative | None, Typical(1e-8, 1e-3)] = Field(
        None,
        description=f"in time: relaxation time of the damping, loss factor over angular frequency; default "
        f"{RELAXATION * 1e6:g}",
    )
    duration_ms: Annotated[Positive | None, Typical(1e-5, 10.0)] = Field(
        None, description="in time: time to simulate; default one period of the slowest vibration after the snap"
    )
    friction: bool = Field(
        False,
        description="in time: friction of the robot file acts; the drives must turn (rates_deg_per_s) to overcome it",
    )
    rates_deg_per_s: OnePerTube | None = Field(
        None, description="in time: rotation rates of the drives; default drives at rest"
    )

    @model_validator(mode="after")
    def _needs_time(self) -> Self:
        keys = "quasi_static_bending", "relaxation_us", "duration_ms", "friction", "rates_deg_per_s"
        given = [key for key in keys if getattr(self, key) not in (None, False)]
        if given and not self.in_time:
            raise ValueError(f"{given[0]} is given without in_time; it is for a snap in time")
        if self.friction and friction_of(self.robot) is None:
            raise ValueError("friction is given, but the robot file has no friction")
        return self

    def _in_time(self, snap: Snap) -> SnapInTime:
        return snap_in_time(
            snap,
            bending_inertia=not self.quasi_static_bending,
            relaxation=self.si("relaxation_us"),
            friction=friction_of(self.robot) if self.friction else None,
            rates=self.si("rates_deg_per_s"),
            duration=self.si("duration_ms"),
        )

    def _ends(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        start = self.si("from_deg"), self.si("from_mm")
        end = self.si("to_deg") or start[0], self.si("to_mm") or start[1]
        return joints_of(self.robot, *start), joints_of(self.robot, *end)

    @model_validator(mode="after")
    def _goes_somewhere(self) -> Self:
        start, end = self._ends()
        # Without motion there is no snap to search for.
        if np.array_equal(start, end):
            raise ValueError("start and end are the same joint values; give other values for to_deg or to_mm")
        return self

    def run(self, progress: Progress | None = None) -> StraightMotion:
        """Search for the first snap; raises SolveError without a stable equilibrium before or after it."""
        start, end = self._ends()
        load = self.external_load
        snap = find_snap(self.robot, start, end, load=load)
        if snap is not None:
            return StraightMotion(self.robot, start, end, snap, None, self._in_time(snap) if self.in_time else None)
        # Equilibria are not unique: the one at the end depends on the path.
        motion = follow(self.robot, [start[0], end[0]], [start[1], end[1]], load=load)
        return StraightMotion(self.robot, start, end, None, motion.equilibria[-1])


Shaken = Annotated[bool, Field(description="ignore the friction of the robot file, as if vibration released it")]


@question("following the path")
def follow_path(
    robot: RobotPath,
    path: WaypointsPath,
    load: ExternalLoad,
    walls: WallBodies = (),
    shaken: Shaken = False,
    progress: Progress | None = None,
) -> Path:
    """Slow motion through waypoints of joint values, and its snaps; a calibrated robot's are drive readings."""
    last = len(path.rotations) - 1
    # Waypoint 0 is the start, so that the last one is the count of steps.
    step = None if progress is None else lambda waypoint: progress(waypoint, last)
    joints = to_model(robot, path.rotations, path.translations)
    return follow(
        robot, *joints, load=load, friction=None if shaken else friction_of(robot), walls=walls, progress=step
    )


@dataclass(frozen=True, eq=False)
class Certification(Displayed):
    """Assessment of whether a robot can snap."""

    robot: Robot
    """Assessed robot."""
    verdict: SnapAssessment
    """Assessment at the given translations, or at those with the smallest certificate in `box`."""
    box: Annotated[WorstCertificate | None, "the searched box of translations"]
    """None unless requested."""
    robot_file: str = "ROBOT.yaml"
    """Name of the robot in the printed commands that repeat the result."""
    force: Annotated[float | None, key("max_tip_force_mN"), "largest force on the tip, in any direction"] = None
    """None unless requested."""
    forced: Annotated[
        float | None,
        key("certificate_under_force"),
        "lower bound on the margin at all rotations and under all such forces",
    ] = None
    real: Annotated[
        Array | None,
        key("real_certificate"),
        "certificate of the real robot with 95 and 99.9 %, to first order; absent without posterior",
    ] = None

    @property
    def finding(self) -> Finding:
        """Finding of the verdict, under the force if one is given: only a positive `forced` proves anything then."""
        if self.forced is None or self.forced > ROUNDING or self.verdict.finding is not Finding.SNAP_FREE:
            return self.verdict.finding
        return Finding.OPEN


class CertifyStudy(Timed):
    """Proof that a robot cannot snap at any rotation, at given translations or anywhere in a box of them."""

    doing = "searching for snaps"
    assuming = f"Results are valid {ASSUMING}."

    kind: Literal["certify"]
    robot: RobotPath
    _robot_file: str = PrivateAttr("ROBOT.yaml")
    translations_mm: OnePerTube | None = SHIFTED
    box: bool = Field(
        False, description="search the smallest certificate over all translations within the limits of the robot"
    )
    lower_mm: OnePerTube | None = Field(
        None, description="lower end of the searched translations, instead of box; default the lower limits"
    )
    upper_mm: OnePerTube | None = Field(
        None, description="upper end of the searched translations, instead of box; default the upper limits"
    )
    max_tip_force_mN: Annotated[Positive | None, Typical(1e-4, 20.0)] = Field(
        None, description="certify also under any dead tip force up to this size, in any direction"
    )

    def model_post_init(self, context: Any) -> None:
        """Store the path of the robot file; a sweep passes a robot without one."""
        self._robot_file = (context or {}).get("files", {}).get("robot", self._robot_file)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.over_box and self.translations_mm is not None:
            raise ValueError("translations_mm are given as well as a box of translations; give one of them")
        return self

    @property
    def over_box(self) -> bool:
        """True if the certificate is searched over a box of translations."""
        return self.box or self.lower_mm is not None or self.upper_mm is not None

    def run(self, progress: Progress | None = None) -> Certification:
        """Assess snapping; raises SolveError as `assess_snapping`."""
        worst = self._worst() if self.over_box else None
        # Over a box, the assessment is at the smallest certificate that the search found.
        shift = self._shift("translations_mm") if worst is None else worst.certificate.translations
        verdict = assess_snapping(self.robot, shift, progress=progress)
        force, forced = self.si("max_tip_force_mN"), None
        if force is not None:
            with rewording({r"^max_force\b": "max_tip_force_mN"}):
                forced = snap_free_certificate(self.robot, verdict.certificate.translations, max_force=force)
        certificate = partial(snap_free_certificate, max_force=force or 0.0)
        real = certificate_bounds(self.robot, certificate, verdict.certificate.translations)
        return Certification(self.robot, verdict, worst, self._robot_file, force, forced, real)

    def _shift(self, key: str) -> Array:
        return joints_of(self.robot, None, self.si(key))[1]

    def _worst(self) -> WorstCertificate:
        low, high = np.array(self.robot.limits.translations).T
        low = low if self.lower_mm is None else self._shift("lower_mm")
        high = high if self.upper_mm is None else self._shift("upper_mm")
        return worst_certificate(self.robot, low, high)


def _two_tubes(tubes: list[int], info: ValidationInfo) -> list[int]:
    robot = info.data.get("robot")
    last = "n" if robot is None else robot.n_tubes
    unknown = robot is not None and not all(1 <= tube <= robot.n_tubes for tube in tubes)
    if len(tubes) != 2 or tubes[0] == tubes[-1] or unknown:
        raise ValueError(f"is {tubes}; it must be two different tubes from 1 to {last}")
    return tubes


@dataclass(frozen=True, eq=False)
class RobotMap(Displayed):
    """Stability map of a robot."""

    robot: Robot
    translations: Annotated[Array, unit("mm"), form(".9g"), "translations"]
    """Translations (n,), m."""
    map: StabilityMap


TwoTubes = Annotated[
    list[Whole],
    AfterValidator(_two_tubes),
    Field(description="numbers of the two rotated tubes; 1 is the innermost", examples=["I,J"]),
]


@question("mapping the margin", assuming=f"Results are valid {ASSUMING}.")
def map_stability(
    robot: RobotPath,
    translations: Translations,
    tubes: TwoTubes = [1, 2],  # noqa: B006  # pydantic copies it
    *,
    options: Annotated[Options, Arguments(stability_map, "samples", "directions", "workers")],
    progress: Progress | None = None,
) -> RobotMap:
    """The margin and the snap boundary over two rotations."""
    first, second = tubes
    stability = stability_map(robot, translations, tubes=(first - 1, second - 1), progress=progress, **options)
    return RobotMap(robot, translations, stability)


# --- load limits ------------------------------------------------------------------------------------------------------

# With a load of 1 mN the load factor of the report is the force in mN.
UNIT_FORCE = 1e-3
"""Unit of a stroke force: axial load, N, for a load factor of 1."""

# Most robots lose stability below a factor of 10; each search stops at its bound.
SEARCH_BOUNDS = (10.0, 100.0, 1000.0)
"""Largest load factors of successive searches; the first one is also the largest axial force, N."""


@dataclass(frozen=True, eq=False)
class LoadLimitResult(Displayed):
    """Load limit of a robot at given joint values."""

    robot: Robot
    rotations: Array
    """(n,) rotations of the joints, rad."""
    translations: Array
    """Translations (n,), m."""
    load: Load
    """Load that the factor multiplies."""
    limit: Annotated[LoadLimit | None, "the load limit; null if stability is not lost"]
    up_to: Annotated[float, "largest load factor searched"]


class LoadLimitStudy(Posed, Loaded, Timed):
    """Load factor that makes a robot lose stability."""

    doing = "putting the load on"

    kind: Literal["load_limit"]
    from_deg: OnePerTube | None = Field(
        None,
        description="rotations of an unloaded start: the robot moves from there to its "
        "rotations, then the load grows; default no motion",
    )
    axial: bool = Field(
        False,
        description="use as load a force of 1 mN against the initial direction of the tip (stroke force); "
        "it keeps its direction",
    )
    up_to: Positive | None = Field(
        None,
        description="largest load factor to search, by default 10, then 100 and 1000 until the limit is found; "
        "with axial, largest force, N, by default 10",
    )

    @model_validator(mode="after")
    def _has_load(self) -> Self:
        load = self.external_load
        if load is None and not self.axial:
            raise ValueError("no load is given; give tip_force_mN, tip_moment_mN_m, gravity_m_per_s2 or load, or axial")
        if load is not None and load == Load(frame=load.frame):
            raise ValueError("the load is 0; it must not be 0")
        if load is not None and self.axial:
            raise ValueError("axial and a load are both given; give one of them")
        return self

    def run(self, progress: Progress | None = None) -> LoadLimitResult:
        """Find the load limit; raises SolveError without a stable unloaded equilibrium, or if the branch is lost."""
        rotations, translations = self.joints
        load, up_to = self.external_load, self.si("up_to")
        start = None
        if self.from_deg is not None:
            path = [joints_of(self.robot, self.si("from_deg"), self.si("translations_mm"))[0], rotations]
            start = follow(self.robot, path, [translations, translations]).equilibria[-1]
        if load is not None:
            limit, bound = None, 0.0
            for bound in SEARCH_BOUNDS if up_to is None else (up_to,):
                limit = find_load_limit(self.robot, rotations, translations, load, equilibrium=start, up_to=bound)
                if limit is not None:
                    break
            return LoadLimitResult(self.robot, rotations, translations, load, limit, bound)
        # The force is directed against the tip of the unloaded robot.
        start = start or forward_kinematics(self.robot, rotations, translations)
        up_to = SEARCH_BOUNDS[0] if up_to is None else up_to
        stroke = find_stroke_force(self.robot, rotations, translations, equilibrium=start, up_to=up_to)
        x, y, z = (-UNIT_FORCE * start.tip_rotation[:, 2]).tolist()
        # `find_stroke_force` returns N; the report has multiples of the unit force.
        limit = None if stroke is None else replace(stroke, factor=stroke.factor / UNIT_FORCE)
        return LoadLimitResult(self.robot, rotations, translations, Load((x, y, z)), limit, up_to / UNIT_FORCE)

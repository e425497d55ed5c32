"""Studies of motion: plans of one robot or several, and verification of any trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import Decimal
from os import PathLike
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from ..bodies.anatomy import Anatomy
from ..bodies.corridors import Corridor
from ..bodies.frames import Frame, Plane
from ..bodies.obstacles import Obstacle, scene_of
from ..display import Displayed
from ..errors import InputError, without_unit_warnings
from ..files.checked import Entry, NotNegative, Positive, Triple, Whole, check_kind, in_file
from ..files.field_metadata import Typical
from ..files.fields import EntryOf, keys_from, values
from ..files.units import MM
from ..files.yaml_file import load_yaml
from ..planning import (
    ArmsPlan,
    Deployment,
    EntryRegion,
    PlacedRobot,
    PlanOptions,
    Proof,
    RateLimits,
    TipGoal,
    Trajectory,
    deploy,
    plan_arms,
    plan_from_region,
    plan_trajectory,
    verify_trajectory,
)
from ..planning.motion import ANY_RATES
from ..planning.tip_path import follow_the_leader, follow_tip_path
from ..planning.trajectory import TimedJoints, load_trajectory
from ..robots.robot import Robot
from ..typing import Array, Progress
from ..validation.certainty import PROBABILITIES, path_bounds
from .real_robot import MOST_MARGIN, Judged, Reserve, check_confidence, kept_by_real_robot
from .robot_keys import (
    DEFAULT_MARGIN,
    ExternalLoad,
    Loaded,
    MinMargin,
    OnePerTube,
    RobotPath,
    Started,
    check_within,
    joints_of,
    rewording_joints,
)
from .study_file import Arguments, Options, Study, Timed, question, rewording
from .surroundings_file import BasePart, Bodies, LumenBodies, Position, Surrounded, TipPosition

RatesEntry = EntryOf[RateLimits]


def check_rates(rates: RatesEntry | None, *robots: Robot) -> None:
    """Raise ValueError unless there is one rate per tube of the robot."""
    for key, value in rates or ():
        for robot in robots:
            if isinstance(value, list) and len(value) not in (1, robot.n_tubes):
                raise ValueError(
                    f"rates.{key} is [{', '.join(map(str, value))}]; it must be one number, or {robot.n_tubes} "
                    "(one per tube)"
                )


class EntryPart(Entry):
    """Allowed poses of the base plate, in the given base frame. The plan chooses one."""

    radius_mm: Positive | None = Field(
        None, description="radius of the disc of entry points, perpendicular to the direction"
    )
    box_mm: Triple | None = Field(
        None, description="half-size of the box of entry points along x, y and z of the base frame"
    )
    at: Annotated[list[str], Field(min_length=1)] | None = Field(
        None, description="anatomy landmarks; one of them becomes the entry point"
    )
    cone_deg: NotNegative = Field(Decimal(0), lt=90, description="half angle of the cone of entry directions")
    places: Annotated[Whole, Field(ge=1, le=16384)] = Field(64, description="number of base poses to check")

    def region(self, around: Anatomy) -> EntryRegion:
        """Region in SI; raises InputError unless exactly one form is given, or for unknown landmarks."""
        return EntryRegion(
            self.si("radius_mm") or 0.0,
            self.si("box_mm") or (0.0, 0.0, 0.0),
            None if self.at is None else np.array([around.landmark(name) for name in self.at]),
            self.si("cone_deg"),
        )


class CutPart(Entry):
    """Section plane for figures: a point and a normal, or landmarks."""

    at_mm: Position | None = Field(None, description="a point of the plane, in the given base frame")
    normal: Triple | None = Field(None, description="normal of the plane, any length")
    through: Annotated[list[str], Field(min_length=2, max_length=3)] | None = Field(
        None,
        description="three anatomy landmarks in the plane, or two (the base is the third); instead of point and normal",
    )

    @model_validator(mode="after")
    def _one_plane(self) -> Self:
        defined = self.at_mm is not None, self.normal is not None
        # Exactly one of two forms, and the first one complete.
        if any(defined) != all(defined) or any(defined) == (self.through is not None):
            raise ValueError("must give at_mm and normal, or through")
        return self

    def plane(self, around: Anatomy) -> Plane:
        """Plane in the base frame; raises InputError for unknown or collinear landmarks."""
        if self.at_mm is not None and self.normal is not None:
            return Plane(np.array(self.si("at_mm")), np.array(self.si("normal")))
        a, b, *more = (around.landmark(name) for name in self.through or ())
        # Two landmarks and the plate at the origin make a plane.
        return Plane.through(a, b, *(more or [np.zeros(3)]))


class Aimed(Started):
    """Robot with its start and its goal: joint values or a pose of the tip."""

    goal_deg: OnePerTube | None = Field(None, description="rotations at the goal; default those of the start")
    goal_mm: OnePerTube | None = Field(None, description="translations at the goal; default those of the start")
    tip_mm: TipPosition | None = Field(None, description="goal position of the tip in the base frame")
    tip_at: str | None = Field(
        None, description="goal of the tip in the anatomy: name of a landmark, or target for the target region"
    )
    tip_direction: Triple | None = Field(
        None, description="direction of the tip in the base frame, any length; default any direction"
    )

    @model_validator(mode="after")
    def _points_at_something(self) -> Self:
        if self.tip_direction is not None and self.tip_mm is None and self.tip_at is None:
            raise ValueError("tip_direction is given without tip_mm or tip_at")
        return self

    def goal(self, around: Anatomy) -> tuple[Array, Array] | TipGoal:
        """Joint values, or a pose of the tip; raises InputError for an unknown landmark."""
        if self.tip_mm is not None:
            position = np.array(self.si("tip_mm"))
        elif self.tip_at is not None:
            position = around.position(self.tip_at)
        else:
            return joints_of(
                self.robot, self.si("goal_deg") or self.si("start_deg"), self.si("goal_mm") or self.si("start_mm")
            )
        return TipGoal(position, None if self.tip_direction is None else np.array(self.si("tip_direction")))


# --- the real robot ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Required:
    """Requirements on the real robot."""

    margin: float
    clearance: float
    """Smallest distance from obstacles, m."""
    confidence: float | None
    """Probability of both; None requires nothing."""


def of_real_robot(
    proof: Proof, rotations: Array, translations: Array, bodies: tuple[Obstacle, ...], required: Required
) -> Proof:
    """Proof with bounds on the real robot, and with faults where they miss the requirements."""
    if len(proof.samples) < len(rotations):
        return proof
    confidence = required.confidence
    probabilities = PROBABILITIES if confidence is None else (confidence,)
    real = path_bounds(proof.samples[0], rotations, translations, scene_of(bodies) if bodies else None, probabilities)
    if real is None:
        return proof
    # The proof holds between the configurations at which real robots are solved.
    real = replace(real, margin=tuple(min(each, proof.least_margin) for each in real.margin))
    if confidence is None:
        return replace(proof, real=real)
    faults, shown = list(proof.faults), f"with {100 * confidence:g} % the real robot has"
    if real.margin[0] < required.margin or not real.margin[0]:
        faults.append(f"{shown} a margin of {real.margin[0]:.4g}; it must be at least {required.margin:g}")
    if real.clearance[0] < required.clearance:
        distance, least = real.clearance[0] * 1e3, required.clearance * 1e3
        faults.append(f"{shown} a clearance of {distance:.4g} mm; it must be at least {least:.6g} mm")
    return replace(proof, real=real, faults=tuple(faults))


@keys_from(PlanOptions)
class PlanStudy(Aimed, Surrounded, Loaded, Study):
    """A snap-free motion: to joint values, to a pose of the tip, along a curve, or follow-the-leader."""

    doing = "planning"
    assuming = "Results assume no friction, and no load or weight except the given ones."
    either = (
        frozenset({"goal_deg", "goal_mm"}),
        frozenset({"tip_mm"}),
        frozenset({"tip_at"}),
        frozenset({"tip_path_mm"}),
    )

    kind: Literal["plan"]
    tip_path_mm: Annotated[list[Triple], Field(min_length=2)] | None = Field(
        None, description="points of a curve for the tip; the start configuration comes from inverse kinematics"
    )
    spline: bool = Field(
        False, description="connect the points of tip_path_mm by a smooth spline instead of a polyline"
    )
    tolerance_mm: Annotated[Positive, Typical(1e-6, 0.05)] = Field(
        Decimal("0.5"), description="largest distance between the tip and the curve of tip_path_mm"
    )
    leader: bool = Field(False, description="follow-the-leader deployment: the arm stays close to the path of its tip")
    begin_percent: Positive = Field(
        Decimal(20), lt=100, description="fraction of the arm that is in front of the base when deployment starts"
    )
    entry: EntryPart | None = Field(None, description="allowed base poses; one is chosen")
    min_margin: MinMargin = DEFAULT_MARGIN
    confidence: Positive | None = Field(
        None,
        gt=0.5,
        lt=1,
        description="the real robot must keep margin and clearance at this probability, estimated from "
        "the posterior of its file; default not required",
        examples=["P"],
    )
    cut: CutPart | None = Field(None, description="section plane for plots of the obstacles")
    rates: RatesEntry = Field(default_factory=RatesEntry, description="rate and acceleration limits of the actuators")

    @model_validator(mode="after")
    def _one_goal(self) -> Self:
        check_rates(self.rates, self.robot)
        joints = self.goal_deg is not None or self.goal_mm is not None
        tips = sum(goal is not None for goal in (self.tip_mm, self.tip_at, self.tip_path_mm))
        if joints + tips != 1:
            raise ValueError("one goal must be given: goal_deg and goal_mm, tip_mm, tip_at, or tip_path_mm")
        if self.tip_at is not None:
            if self.anatomy is None:
                raise ValueError("tip_at is given without an anatomy; it is the name of a landmark of the anatomy")
            self.anatomy.position(self.tip_at)
        if self.leader and self.tip_path_mm is not None:
            raise ValueError("leader needs a goal, not a curve for the tip")
        if self.external_load is not None and (self.leader or self.tip_path_mm is not None):
            raise ValueError(
                "a load is given with leader or tip_path_mm; under load, only plans to a goal are supported"
            )
        if self.cut is not None:
            self.cut.plane(self.around)
        if self.entry is not None:
            self.entry.region(self.around)
            if self.leader or self.tip_path_mm is not None or self.external_load is not None:
                raise ValueError(
                    "entry is given with leader, tip_path_mm or a load; it is supported for "
                    "plans to a goal without load only"
                )
        return self

    @model_validator(mode="after")
    def _known_robot(self) -> Self:
        check_confidence(self.confidence, self.robot)
        return self

    def run(self, progress: Progress | None = None) -> Trajectory:
        """Plan the trajectory; raises SolveError if there is none, or none is found in time."""
        with rewording_joints(start=("start_deg", "start_mm"), goal=("goal_deg", "goal_mm")):
            plan = self._kept_by_real_robot(progress)
        if self.cut is None:
            return plan
        plane = self.cut.plane(self.around)
        # The plane was given in the old base frame; the plan chose another one.
        return replace(plan, cut=plane if plan.entry is None else plane.seen_from(plan.entry.frame))

    def _kept_by_real_robot(self, progress: Progress | None) -> Trajectory:
        """Plan with bounds on the real robot, repeated with more margin and clearance until it keeps both."""
        margin, options = self.si("min_margin"), PlanOptions(**values(PlanOptions, self))
        required = Required(margin, options.clearance, self.si("confidence"))

        def plan_with(reserve: Reserve) -> Judged[Trajectory]:
            wanted = replace(options, clearance=options.clearance + reserve.clearance)
            plan = self._plan(progress, min(margin + reserve.margin, MOST_MARGIN), wanted)
            proof = of_real_robot(plan.proof, plan.rotations, plan.translations, plan.obstacles, required)
            answer = replace(plan, proof=proof)
            if proof.faults == plan.proof.faults or proof.real is None:
                return Judged(answer, ())
            margins, clearances = proof.real.margin, proof.real.clearance
            lack = Reserve(margin=margin - margins[0], clearance=options.clearance - clearances[0])
            return Judged(answer, proof.faults, lack)

        return kept_by_real_robot("plan", plan_with)

    def _plan(self, progress: Progress | None, margin: float, options: PlanOptions) -> Trajectory:
        common: dict[str, Any] = {
            "obstacles": self.bodies,
            "min_margin": margin,
            "rate_limits": self.rates.build(),
            "options": options,
        }
        robot, start, goal = self.robot, self.start, self.goal(self.around)
        # A goal modulo turns is moved into the limits by the planner.
        if isinstance(goal, tuple) and not values(PlanOptions, self).get("modulo_turns"):
            check_within(robot, "goal", *goal)
        if self.tip_path_mm is not None:
            has_start = self.start_deg is not None or self.start_mm is not None
            curve = self.in_si("tolerance_mm", "spline")
            return follow_tip_path(robot, self.si("tip_path_mm"), start=start if has_start else None, **curve, **common)
        if self.leader:
            return follow_the_leader(robot, goal, start_fraction=self.si("begin_percent"), **common)
        if self.entry is not None:
            region, count = self.entry.region(self.around), self.entry.places
            plan = plan_from_region(robot, start, goal, region, count=count, progress=progress, **common)
            if self.anatomy is None or plan.entry is None:
                return plan
            # The chosen base pose relative to the given one, expressed in the patient.
            return replace(plan, entry=replace(plan.entry, base=self.anatomy.base.inverse.of(plan.entry.frame)))
        return plan_trajectory(robot, start, goal, load=self.external_load, **common)


# --- several robots ---------------------------------------------------------------------------------------------------


class PlacedPart(Started):
    """Robot with base pose and start, in a plan of several."""

    name: str = Field("", description="name in messages and plots; default the name of the robot")
    base: BasePart | None = Field(None, description="base plate in the common frame")

    def placed(self, anatomy: Anatomy) -> PlacedRobot:
        """Robot at its base pose; landmarks come from the anatomy."""
        base = Frame() if self.base is None else self.base.frame(anatomy.landmarks)
        return PlacedRobot(self.robot, base, self.name)


def shared(anatomy: Anatomy | None) -> Anatomy:
    """Anatomy around all arms; raises ValueError if it has a base pose, which only one robot can have."""
    common = Anatomy() if anatomy is None else anatomy
    # Each arm has its own base: one of the anatomy would be a second one.
    if not (np.array_equal(common.base.axes, np.eye(3)) and np.array_equal(common.base.origin, np.zeros(3))):
        raise ValueError("anatomy has a base or a registration; give the base of every arm instead")
    return common


class ArmPart(Aimed, PlacedPart):
    """Robot with its goal, in a plan of several; without a goal it does not move."""

    tip_mm: Position | None = Field(None, description="goal position of the tip in the common frame")

    @model_validator(mode="after")
    def _one_goal(self) -> Self:
        joints = self.goal_deg is not None or self.goal_mm is not None
        if joints + (self.tip_mm is not None) + (self.tip_at is not None) > 1:
            raise ValueError("has several goals; it must have one: goal_deg and goal_mm, tip_mm, or tip_at")
        return self


@keys_from(PlanOptions, "objective", "seed")
class ArmsStudy(Surrounded, Study):
    """Motions of several robots on one plate or endoscope, without snap and without contact between them."""

    doing = "planning"
    assuming = "Results assume no friction, load or weight."

    kind: Literal["plan_arms"]
    arms: Annotated[list[ArmPart], Field(min_length=2)] = Field(description="the robots, at least two")
    obstacles: Bodies = Field(
        (), description="obstacles for all arms, in the common frame: a YAML file or a list of bodies"
    )
    clearance_mm: Annotated[NotNegative, Typical(1e-5, 0.1)] = Field(
        Decimal("0.5"), description="smallest allowed distance of every arm from obstacles and other arms"
    )
    min_margin: MinMargin = DEFAULT_MARGIN
    rates: RatesEntry = Field(default_factory=RatesEntry, description="rate and acceleration limits of the actuators")
    time_limit_s: Positive = Field(Decimal(120), description="time limit of the command")

    @model_validator(mode="after")
    def _landmarks(self) -> Self:
        check_rates(self.rates, *(arm.robot for arm in self.arms))
        around = shared(self.anatomy)
        for arm in self.arms:
            arm.placed(around)
            arm.goal(around)
        return self

    def run(self, progress: Progress | None = None) -> ArmsPlan:
        """Plan the motions; raises SolveError if there are none, or none are found in time."""
        return plan_arms(
            [arm.placed(self.around) for arm in self.arms],
            [arm.start for arm in self.arms],
            [arm.goal(self.around) for arm in self.arms],
            obstacles=self.bodies,
            min_margin=self.si("min_margin"),
            rate_limits=self.rates.build(),
            options=PlanOptions(**values(PlanOptions, self)),
        )


# --- check of a trajectory --------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class VerifiedTrajectory(Displayed):
    """Trajectory from a file, with its proof."""

    file: str
    """Path of the trajectory file."""
    joints: TimedJoints
    """Joint values over time."""
    proof: Proof
    """Bounds and violations over the whole trajectory."""
    obstacles: tuple[Obstacle, ...] = ()
    """Obstacles that the clearance refers to."""


def load_plan_study(path: str | PathLike[str]) -> PlanStudy:
    """Load a study of kind plan from a YAML file."""
    return check_kind({"plan": PlanStudy}, load_yaml(path), path)


class VerifyStudy(Surrounded, Loaded, Timed):
    """Check of any trajectory for snaps, collisions and rates."""

    doing = "following the trajectory"
    assuming = "Results assume no friction, and no load or weight except the given ones."

    kind: Literal["verify"]
    robot: RobotPath | None = Field(
        None, description="robot file; default the one named in the trajectory", examples=["ROBOT.yaml"]
    )
    trajectory: Annotated[tuple[str, TimedJoints], in_file(load_trajectory, "a CSV file", of="robot", named=True)] = (
        Field(
            description="path of a CSV file with columns time_s, rotation_1_deg, ... and, "
            "if tubes translate, translation_1_mm, ..."
        )
    )
    min_margin: NotNegative | None = Field(
        None, lt=1, description="smallest allowed stability margin, below 1; default 0", examples=["MU"]
    )
    clearance_mm: Annotated[NotNegative | None, Typical(1e-5, 0.1)] = Field(
        None, description="smallest allowed distance between arm and obstacles; default 0"
    )
    max_tip_force_mN: Annotated[NotNegative | None, Typical(1e-4, 20.0)] = Field(
        None,
        description="check margin and clearance under any tip force up to this size, in any direction; default 0",
        examples=["F"],
    )
    rates: RatesEntry | None = Field(
        None, description="rate and acceleration limits of the actuators; default not checked"
    )
    tip_mm_per_s: Annotated[Positive | None, Typical(1e-4, 2.0)] = Field(
        None, description="largest tip speed; overrides the rates of the study; default no limit", examples=["V"]
    )
    confidence: Positive | None = Field(
        None,
        gt=0.5,
        lt=1,
        description="the real robot must keep margin and clearance at this probability, estimated from "
        "the posterior of its file; default not required",
        examples=["P"],
    )
    study: Annotated[PlanStudy, in_file(load_plan_study, "a study of kind plan")] | None = Field(
        None,
        description="study of kind plan that supplies margin, obstacles, clearance, force, "
        "load and rates not given here",
        examples=["STUDY.yaml"],
    )

    @model_validator(mode="after")
    def _rates_of_the_robot(self) -> Self:
        check_rates(self._requirements().rates, self.trajectory[1].robot)
        check_confidence(self._requirements().confidence, self.trajectory[1].robot)
        return self

    def _requirements(self) -> VerifyStudy | PlanStudy:
        """Study with the requirements: the plan study, if given, with the keys of this study replacing its own."""
        if self.study is None:
            return self
        # Kind and robot are those of the trajectory.
        shared = (VerifyStudy.model_fields.keys() & PlanStudy.model_fields) - {"kind", "robot"}
        overrides = {key: getattr(self, key) for key in self.model_fields_set & shared}
        return self.study.model_copy(update={key: value for key, value in overrides.items() if value is not None})

    def run(self, progress: Progress | None = None) -> VerifiedTrajectory:
        """Verify the trajectory; raises SolveError if its equilibria cannot be followed."""
        required = self._requirements()
        file, joints = self.trajectory
        rates, tip_speed = None if required.rates is None else required.rates.build(), self.si("tip_mm_per_s")
        if tip_speed is not None:
            with without_unit_warnings():
                rates = replace(rates or ANY_RATES, tip=tip_speed)
        proof = verify_trajectory(
            joints.robot,
            joints.time,
            joints.rotations,
            joints.translations,
            start=joints.start(required.external_load),
            obstacles=required.bodies,
            min_margin=required.si("min_margin") or 0.0,
            clearance=required.si("clearance_mm") or 0.0,
            rate_limits=rates,
            max_force=required.si("max_tip_force_mN") or 0.0,
            load=required.external_load,
        )
        asked = Required(
            required.si("min_margin") or 0.0, required.si("clearance_mm") or 0.0, required.si("confidence")
        )
        proof = of_real_robot(proof, joints.rotations, joints.translations, required.bodies, asked)
        return VerifiedTrajectory(file, joints, proof, required.bodies)


# --- Deployment among walls that the arm touches ----------------------------------------------------------------------


def _centreline(walls: tuple[Obstacle, ...]) -> Array:
    """Centreline (k, 3) of the only corridor among the walls, in front of the plate, m.

    Raises:
        InputError: there is no corridor, or more than one.
    """
    corridors = [body for body in walls if isinstance(body, Corridor)]
    if len(corridors) != 1:
        raise InputError(f"walls have {len(corridors)} corridors; without tip_path_mm they must have 1")
    points = np.array(corridors[0].centreline)
    in_front = points[points[:, 2] > 0]
    if len(in_front) < 2:
        raise InputError(
            f"the corridor has {len(in_front)} points in front of the plate; without tip_path_mm it needs 2"
        )
    return in_front


TipPath = Annotated[
    list[Triple] | None,
    Field(
        min_length=1,
        description="points that lead the tip, such as the centreline of a vessel; default the centreline of the only "
        "corridor among the walls",
    ),
]


@question("leading the tip")
def deploy_tip(
    robot: RobotPath,
    walls: LumenBodies,
    load: ExternalLoad,
    options: Annotated[Options, Arguments(deploy, "largest_force", "tolerance", "min_margin")],
    tip_path_mm: TipPath = None,
    progress: Progress | None = None,
) -> Deployment:
    """Motion that leads the tip along a path among walls; no contact force exceeds a limit."""
    path = _centreline(walls) if tip_path_mm is None else np.array(tip_path_mm, dtype=float) * MM
    step = None if progress is None else lambda points: progress(points, 0)
    with rewording({r"^path\b": "tip_path_mm"}):
        return deploy(robot, path, walls=walls, load=load, progress=step, **options)

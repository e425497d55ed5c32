"""The study of a trajectory: whether it snaps, collides or goes too fast."""

from __future__ import annotations

from dataclasses import dataclass, replace
from os import PathLike
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..bodies.obstacles import Obstacle
from ..display import Displayed
from ..errors import undoubted
from ..files.checked import NotNegative, Positive, check_kind, in_file
from ..files.field_metadata import Typical
from ..files.yaml_file import load_yaml
from ..planning import Proof, verify_trajectory
from ..planning.file import TimedJoints, load_trajectory
from ..planning.motion import ANY_RATES
from ..typing import Progress
from .load_file import Loaded
from .obstacle_file import Surrounded
from .plan_study import PlanStudy, RatesEntry, check_rates
from .robot_keys import RobotPath
from .study_file import Timed


@dataclass(frozen=True, eq=False)
class Checked(Displayed):
    """A trajectory of whatever origin, and what was found on it."""

    file: str
    """That it was read from."""
    joints: TimedJoints
    """Joint values over time."""
    proof: Proof
    """What was found."""
    obstacles: tuple[Obstacle, ...] = ()
    """That the arm was to keep away from."""


def _plan_study(path: str | PathLike[str]) -> PlanStudy:
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
    study: Annotated[PlanStudy, in_file(_plan_study, "a study of kind plan")] | None = Field(
        None,
        description="study of kind plan that supplies margin, obstacles, clearance, force, "
        "load and rates not given here",
        examples=["STUDY.yaml"],
    )

    @model_validator(mode="after")
    def _rates_of_the_robot(self) -> Self:
        check_rates(self._asked().rates, self.trajectory[1].robot)
        return self

    def _asked(self) -> VerifyStudy | PlanStudy:
        """What is asked: of the plan study where there is one, but for the keys that are given beside it."""
        if self.study is None:
            return self
        shared = (VerifyStudy.model_fields.keys() & PlanStudy.model_fields) - {"kind", "robot"}
        given = {key: getattr(self, key) for key in self.model_fields_set & shared}
        return self.study.model_copy(update={key: value for key, value in given.items() if value is not None})

    def run(self, progress: Progress | None = None) -> Checked:
        """What is found on the trajectory; raises SolveError where it cannot be followed."""
        asked = self._asked()
        file, joints = self.trajectory
        rates, tip = None if asked.rates is None else asked.rates.build(), self.si("tip_mm_per_s")
        if tip is not None:
            with undoubted():
                rates = replace(rates or ANY_RATES, tip=tip)
        proof = verify_trajectory(
            joints.robot,
            joints.time,
            joints.rotations,
            joints.translations,
            start=joints.start(asked.external_load),
            obstacles=asked.bodies,
            min_margin=asked.si("min_margin") or 0.0,
            clearance=asked.si("clearance_mm") or 0.0,
            rate_limits=rates,
            max_force=asked.si("max_tip_force_mN") or 0.0,
            load=asked.external_load,
        )
        return Checked(file, joints, proof, asked.bodies)

"""Studies of molds: grooves or mandrel, mold materials, and spring-back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..display import Displayed
from ..files.checked import NotNegative, Number, Positive, Whole, in_file
from ..files.field_metadata import Typical, key
from ..robots.tubes import Tube
from ..shaping.heating.rig import Rig
from ..shaping.materials import mold_material
from ..shaping.mold.heat import HeatSpec
from ..shaping.mold.mandrel import Mandrel, plan_mandrel
from ..shaping.mold.measured_tube import MeasuredTube, measure_tube
from ..shaping.mold.mold import RobotMold, chosen_tubes, plan_robot_mold
from ..shaping.mold.photo import TubePhoto, load_photo
from ..shaping.mold.ranking import MaterialRating, rank_mold_materials
from ..shaping.mold.spec import MoldSpec
from ..shaping.mold.springback import Calibration, Springback, calibrate_springback
from ..typing import Progress
from .robot_keys import RobotPath, TubeNumber
from .study_file import Arguments, Options, Study, Timed, question
from .workshop_file import Trials, load_mold_spec, load_rig, load_springback, load_trials


@dataclass(frozen=True, eq=False)
class MoldRanking(Displayed):
    """Ranking of mold materials for a tube."""

    ratings: Annotated[tuple[MaterialRating, ...], key("materials"), "the materials, best first"]
    tube: Tube
    heat: HeatSpec
    """Heating conditions of the ranking."""


MOLD = in_file(load_mold_spec, "a mold file", kind=MoldSpec)

MoldPath = Annotated[
    Annotated[MoldSpec, MOLD] | None,
    Field(
        description="mold file: grooves, plates, clamps, machine and heat; default plates of calcium silicate",
        examples=["MOLD.yaml"],
    ),
]
"""Mold specification, given as the path of its file."""

MandrelMold = Annotated[
    Annotated[MoldSpec, MOLD] | None,
    Field(
        description="mold file: grooves, plates, clamps, machine and heat; without it all keys have default values",
        examples=["MOLD.yaml"],
    ),
]

SpringbackPath = Annotated[
    Annotated[Springback, in_file(load_springback, "a spring-back file")] | None,
    Field(
        description="YAML file of spring-back from `tubeopt mold calibrate`; default that of the mold file",
        examples=["FILE.yaml"],
    ),
]


class MoldStudy(Study):
    """The mold for the tubes of a robot."""

    doing = "planning the mold"

    kind: Literal["mold_plan"]
    robot: RobotPath
    mold: MoldPath = None
    tubes: list[Whole] | None = Field(
        None, description="numbers of the tubes, from 1; default every different curved tube", examples=["N,.."]
    )
    material: str | None = Field(
        None,
        description="material of both plates: steel, mdf, glass_mica or "
        "calcium_silicate; default that of the mold file",
    )
    springback: SpringbackPath = None
    cold_length_mm: Annotated[NotNegative | None, Typical(1e-4, 0.5)] = Field(
        None,
        description="length of tube beside a clamp that stays too cold; the curved part begins beyond it; "
        "default estimated",
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        self._spec()
        chosen_tubes(self.robot, self.tubes)
        return self

    def _spec(self) -> MoldSpec:
        """Specification of the mold file, with the keys of the study replacing its own."""
        material = None if self.material is None else mold_material(self.material)
        overrides = {"material": material, **self.in_si("springback", "cold_length_mm")}
        return replace(
            self.mold or MoldSpec(), **{name: value for name, value in overrides.items() if value is not None}
        )

    def run(self, progress: Progress | None = None) -> RobotMold:
        """Plan the mold; raises InputError if none is possible."""
        return plan_robot_mold(self.robot, self._spec(), self.tubes)


@question("planning the mandrel", timed=False)
def mandrel(robot: RobotPath, tube: TubeNumber = 1, mold: MandrelMold = None) -> Mandrel:
    """Mandrel for a tube that is a helix or another space curve."""
    return plan_mandrel(robot.tubes[tube - 1], mold, number=tube)


class MaterialsStudy(Timed):
    """Mold materials for a tube of a robot, or for a tube of given sizes, compared."""

    kind: Literal["mold_materials"]
    robot: RobotPath | None = Field(None, description="robot file with the tube; default a tube with the sizes below")
    tube: TubeNumber = 1
    outer_diameter_mm: Annotated[Positive, Typical(1e-4, 0.1)] = Field(
        Decimal("1.92"), description="outer diameter of the tube, without a robot file"
    )
    inner_diameter_mm: Annotated[NotNegative, Typical(2e-5, 0.1)] = Field(
        Decimal("1.57"), description="inner diameter of the tube, without a robot file"
    )
    curved_length_mm: Annotated[Positive, Typical(1e-3, 10.0)] = Field(
        Decimal(94), description="heated length of the tube, without a robot file"
    )
    set_degC: Number = Field(Decimal(525), description="set temperature of the tube")
    hold_s: Positive = Field(Decimal(60), description="hold time at the set temperature")
    rig: Annotated[Rig, in_file(load_rig, "a rig file", kind=Rig)] | None = Field(
        None, description="rig file; default the rig of the thesis", examples=["RIG.yaml"]
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        fields = type(self).model_fields
        sizes = [key for key in ("outer_diameter_mm", "inner_diameter_mm", "curved_length_mm")
                 if getattr(self, key) != fields[key].default]  # fmt: skip
        if self.robot is not None and sizes:
            raise ValueError(f"{sizes[0]} and robot are both given; give one of them")
        self._tube()
        self._heat()
        return self

    def _tube(self) -> Tube:
        if self.robot is not None:
            return self.robot.tubes[self.tube - 1]
        sizes = self.in_si("outer_diameter_mm", "inner_diameter_mm", "curved_length_mm")
        # Heating depends on the cross-section and the heated length, not on the bend.
        return Tube(**sizes, straight_length=0.0, curvature=0.0)

    def _heat(self) -> HeatSpec:
        return HeatSpec(set_temperature=self.si("set_degC"), hold_time=self.si("hold_s"))

    def run(self, progress: Progress | None = None) -> MoldRanking:
        """Rank the materials, best first."""
        rig = self.rig or Rig()
        return MoldRanking(rank_mold_materials(self._tube(), self._heat(), rig=rig), self._tube(), self._heat())


TrialsPath = Annotated[
    Trials,
    in_file(load_trials, "a CSV file"),
    Field(
        description="path of a CSV file with the columns mold_radius_mm, obtained_radius_mm and, if known, "
        "obtained_error_mm (standard error)"
    ),
]


@question("running the study", timed=False)
def calibrate_mold(
    trials: TrialsPath, options: Annotated[Options, Arguments(calibrate_springback, "model")]
) -> Calibration:
    """Spring-back of tubes, from trials."""
    return calibrate_springback(
        trials.mold_radius, trials.obtained_radius, obtained_error=trials.obtained_error, **options
    )


PhotoPath = Annotated[
    TubePhoto,
    in_file(load_photo, "a picture", kind=TubePhoto),
    Field(description="path of a scan or photo: PNG, JPEG or TIFF"),
]


@question("measuring the tube", timed=False)
def measure_photo(
    photo: PhotoPath,
    options: Annotated[Options, Arguments(measure_tube, "dpi", "marks", "scale_error", "mold_radius")],
) -> MeasuredTube:
    """Radius of a tube in a scan or photo, with its 95 % interval."""
    return measure_tube(photo, **options)

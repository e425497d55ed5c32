"""The study of where to measure."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Literal

from pydantic import Field

from ..files.checked import NotNegative, Positive, Whole
from ..files.units import MM, to_si
from ..validation import Placement, where_to_measure
from .base import Progress, RobotPath, Study


class MeasureStudy(Study):
    """Configurations that determine chosen parameters of a robot best, joined without a snap."""

    doing = "choosing configurations"

    kind: Literal["measure"]
    robot: RobotPath
    fit: list[str] = Field(
        description="parameters to be estimated: rotation_all, translation_all, curvature_2, ...", examples=["NAME,.."]
    )
    count: Annotated[Whole, Field(ge=3)] = Field(30, description="how many configurations")
    min_margin: NotNegative = Field(Decimal("0.1"), lt=1, description="least stability margin")
    noise_mm: Positive = Field(Decimal("0.5"), description="noise of a measured coordinate, for the expected errors")
    registration: Literal["rigid", "base-axis", "none"] = Field(
        "rigid", description="how the device's frame will be brought to the plate's: rigid, base-axis or none"
    )
    seed: Whole = Field(0, description="of the random configurations that are chosen from")

    def run(self, progress: Progress | None = None) -> Placement:
        """The configurations; raises SolveError where too few have the margin."""
        if progress is not None:
            progress(0, 0)
        return where_to_measure(
            self.robot,
            self.fit,
            self.count,
            min_margin=float(self.min_margin),
            noise=to_si(self.noise_mm, MM),
            registration=self.registration,
            seed=self.seed,
        )

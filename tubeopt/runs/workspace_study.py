"""The study of a workspace: where the tip reaches, how large that is, and what snapping takes."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..files.checked import Number, Positive
from ..files.units import MM, to_si
from ..workspaces import Findings, examine, workspace
from ..workspaces.loss import require_centred
from .base import Progress, RobotPath, Study, Whole


class WorkspaceStudy(Study):
    """Tips at many joint values within a robot's limits."""

    kind: Literal["workspace"]
    robot: RobotPath
    samples: Annotated[Whole, Field(ge=1, description="joint values")] = 10_000
    method: Literal["sobol", "random", "grid"] = Field("sobol", description="how they are chosen")
    seed: Annotated[Whole, Field(ge=0)] = 0
    voxel_mm: Positive | None = Field(None, description="edge of the voxels; by default about fifty samples each")
    min_margin: Annotated[Number, Field(le=1)] = Field(Decimal(0), description="only shapes at least as stable count")
    loss: Annotated[Whole, Field(ge=0)] = Field(0, description="equilibria that tell what is lost to snapping")

    @model_validator(mode="after")
    def _has_a_loss(self) -> Self:
        if self.loss:
            require_centred(self.robot)
        return self

    def run(self, progress: Progress | None = None) -> Findings:
        """The workspace with its voxels and volumes; raises InputError where no sample is stable enough."""
        found = workspace(self.robot, self.samples, method=self.method, seed=self.seed, progress=progress)
        size = None if self.voxel_mm is None else to_si(self.voxel_mm, MM)
        return examine(found, size, min_margin=float(self.min_margin), loss=self.loss)

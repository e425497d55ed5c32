"""The study of a workspace: where the tip reaches, how large that is, and what snapping takes."""

from __future__ import annotations

from decimal import Decimal
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from ..files.checked import Number, Positive, Whole
from ..files.field_metadata import Typical
from ..typing import Progress
from ..workspaces import Findings, examine, workspace
from ..workspaces.loss import require_centred
from .base import RobotPath, Timed


class WorkspaceStudy(Timed):
    """Tips at many joint values within a robot's limits."""

    doing = "solving"
    keeps = "finished samples are in {out}; the same command continues"

    kind: Literal["workspace"]
    robot: RobotPath
    samples: Annotated[Whole, Field(ge=1)] = Field(10_000, description="number of sampled configurations")
    method: Literal["sobol", "random", "grid"] = Field("sobol", description="sampling method: sobol, random or grid")
    seed: Annotated[Whole, Field(ge=0)] = Field(
        0, description="random seed of random and Sobol samples", examples=["K"]
    )
    voxel_mm: Annotated[Positive | None, Typical(1e-5, 0.1)] = Field(
        None,
        description="edge length of the voxels; by default 1, 2 or 5 times a power of ten, for about "
        "50 samples per voxel of the bounding box",
    )
    min_margin: Annotated[Number, Field(le=1)] = Field(
        Decimal(0), description="smallest stability margin of a counted configuration", examples=["MU"]
    )
    loss: Annotated[Whole, Field(ge=0)] = Field(
        0,
        description="number of sampled equilibria, stable or not, that estimate the share of the workspace lost to "
        "snapping; 0 to skip",
    )
    workers: Annotated[Whole, Field(ge=0)] = Field(1, description="number of threads; 0 for one per core")

    @model_validator(mode="after")
    def _has_a_loss(self) -> Self:
        if self.loss:
            require_centred(self.robot)
        return self

    def run_in(self, out: Path | None, progress: Progress | None = None) -> Findings:
        """The workspace with its voxels and volumes; raises InputError where no sample is stable enough.

        With `out` the samples are saved there as they come, and a run that was stopped goes on.
        """
        found = workspace(
            self.robot,
            self.samples,
            out=out,
            progress=progress,
            **self.in_si("method", "seed", "workers"),
        )
        return examine(found, self.si("voxel_mm"), progress=progress, **self.in_si("min_margin", "loss"))

"""What a design is good for: every objective is a number that falls as the design gets better."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..block.own import OwnObjective
from ..errors import InputError, numbers, vector
from ..files.marks import POSITIVE, OneOf, check_fields, unit

KINDS = {
    "tip_curvature": ("tip curvature", "1/m", 1.0, -1),
    "turning_radius": ("turning radius", "mm", 1e3, 1),
    "reach_radius": ("reachable radius", "mm", 1e3, -1),
    "strain": ("largest strain", "%", 1e2, 1),
    "length": ("length of the robot", "mm", 1e3, 1),
    "margin": ("least margin", "", 1.0, -1),
    "tip_deflection": ("tip deflection", "mm", 1e3, 1),
    "tip_stiffness": ("tip stiffness", "N/m", 1.0, -1),
    "stroke_force": ("stroke force", "mN", 1e3, -1),
    "dexterity": ("dexterity", "mm", 1e3, -1),
    "orientability": ("orientability", "deg", 180 / np.pi, -1),
    "workspace_volume": ("volume that is swept", "cm^3", 1e6, -1),
    "deployment": ("deviation of the deployment", "mm", 1e3, 1),
    "change": ("change of the robot", "", 1.0, 1),
}
"""Name, unit, what turns SI into it, and whether less (1) or more (-1) is better."""

POSED = (
    "tip_deflection",
    "tip_stiffness",
    "stroke_force",
    "dexterity",
    "orientability",
    "workspace_volume",
    "deployment",
)
"""What is told of task poses."""

PUSHED = ("tip_deflection", "tip_stiffness")
"""What is told under a force on the tip."""


@dataclass(frozen=True)
class Objective:
    """One aim of a design.

    kind:
        "tip_curvature": curvature of the arm at its tip, all tubes bending to one side, at `translations` (more is
            better); "turning_radius": one over it.
        "reach_radius": distance of the tip from the axis of the plate that it can reach at height `depth`, m.
        "strain": largest strain of any tube held straight.
        "length": overall length of the longest tube.
        "margin": the least certificate where a certificate is required, else the least margin of the task poses.
        "tip_deflection": how far `tip_force` moves the tip, the farthest of all task poses; "tip_stiffness": its size
            over how far it moves the tip along itself, the least of all task poses.
        "stroke_force": the largest force with which the tip can push along itself before the arm buckles or snaps, the
            least of all task poses, whose joint values are given; 10 N where all bear that.
        "dexterity": by how much joints move the tip, for 1 rad or 50 mm, in the direction in which they move it least:
            the least singular value s_3 of its Jacobian, smooth where two are equal, as the sum of s_k^-8 to the power
            -1/8, which is s_3 or up to 13 % less; the mean of all task poses.
        "orientability": by how much joints turn the direction of the tip, for 1 rad or 50 mm, while its place stays,
            in the direction in which they turn it least: the lesser of two singular values, smooth where they are
            equal, as (s_1^-8 + s_2^-8)^(-1/8), which is s_2 or up to 8 % less; the mean of all task poses. Place and
            direction are five numbers: it takes three tubes.
        "workspace_volume": of what the polygon of the tips of the task poses, in their order, sweeps when it is turned
            about the axis of the plate, as all tubes turned together do.
        "deployment": root of the mean square distance between arms on their way out, their tubes drawn back straight,
            and where the whole arm will be, over all task poses.
        "change": sum of squares of the changes from the start, each relative to its size.
    weight: where there are several objectives, what they are multiplied by before they are added, in SI.
    """

    kind: Annotated[str, OneOf(tuple(KINDS))]
    weight: Annotated[float, POSITIVE, "of the value in SI, where there are several"] = 1.0
    depth: Annotated[float | None, unit("mm"), "for reach_radius: height of the tip"] = None
    translations: Annotated[
        tuple[float, ...] | None, unit("mm"), "for tip_curvature and turning_radius; home if not given"
    ] = None
    tip_force: Annotated[
        tuple[float, float, float] | None, unit("mN"), "for tip_deflection and tip_stiffness, in axes of the plate"
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, "the objective")
        if (self.kind == "reach_radius") != (self.depth is not None):
            raise InputError("depth belongs to the objective reach_radius, which needs it, and to no other")
        if (self.kind in PUSHED) != (self.tip_force is not None):
            raise InputError(f"tip_force belongs to the objectives {' and '.join(PUSHED)}, which need it, and no other")
        if self.tip_force is not None:
            force = vector("tip_force of the objective", self.tip_force, 3, "x, y, z")
            if not force.any():
                raise InputError("tip_force of the objective is 0; it must push")
            object.__setattr__(self, "tip_force", tuple(force.tolist()))
        if self.translations is not None:
            if self.kind not in ("tip_curvature", "turning_radius"):
                raise InputError(
                    "translations belong to the objectives tip_curvature and turning_radius, and to no other"
                )
            object.__setattr__(self, "translations", numbers("translations of the objective", self.translations))

    @property
    def words(self) -> str:
        """What it is called."""
        return KINDS[self.kind][0]

    @property
    def unit(self) -> str:
        """Unit in which it is shown."""
        return KINDS[self.kind][1]

    @property
    def factor(self) -> float:
        """What turns SI into that unit."""
        return KINDS[self.kind][2]

    @property
    def sign(self) -> int:
        """1 where less is better, -1 where more is better."""
        return KINDS[self.kind][3]


AnyObjective = Objective | OwnObjective
"""A built-in aim or an own one."""


def key_of(one: AnyObjective) -> str:
    """By what an objective is known among those of its task: its kind, or the words of an own one."""
    return one.kind if isinstance(one, Objective) else one.words


def shown(one: AnyObjective, value: float) -> str:
    """An objective's value with its name and unit."""
    return f"{one.words} {value * one.factor:.6g} {one.unit}".strip()

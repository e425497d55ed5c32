"""Objectives of a design, as expressions of tubes and poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np

from ..block.custom import CustomObjective
from ..block.quantities import Expression, PoseQuantities, Quantities, recorded
from ..display import Displayed
from ..errors import InputError, numbers, vector
from ..files.field_metadata import POSITIVE, OneOf, check_fields, unit
from ..physics.torsion import cross_section
from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.load import ZERO, Load
from ..robots.robot import Robot
from ..typing import Delegate
from .parameters import DesignSpace
from .requirements import ROUNDED, Rows, deviations


class Kind(NamedTuple):
    """Description of an objective."""

    description: str
    """Name of the objective."""
    unit: str
    """Unit for display."""
    factor: float
    """Factor from SI to that unit."""
    sign: int
    """1 if it is minimised, -1 if it is maximised."""


KINDS = {
    "tip_curvature": Kind("tip curvature", "1/m", 1.0, -1),
    "turning_radius": Kind("turning radius", "mm", 1e3, 1),
    "reach_radius": Kind("reachable radius", "mm", 1e3, -1),
    "strain": Kind("largest strain", "%", 1e2, 1),
    "length": Kind("length of the robot", "mm", 1e3, 1),
    "margin": Kind("least margin", "", 1.0, -1),
    "tip_deflection": Kind("tip deflection", "mm", 1e3, 1),
    "tip_stiffness": Kind("tip stiffness", "N/m", 1.0, -1),
    "stroke_force": Kind("stroke force", "mN", 1e3, -1),
    "dexterity": Kind("dexterity", "mm", 1e3, -1),
    "orientability": Kind("orientability", "deg", 180 / np.pi, -1),
    "workspace_volume": Kind("volume that is swept", "cm^3", 1e6, -1),
    "deployment": Kind("deviation of the deployment", "mm", 1e3, 1),
    "change": Kind("change of the robot", "", 1.0, 1),
}
# Objectives on task poses.
POSED = (
    "tip_deflection",
    "tip_stiffness",
    "stroke_force",
    "dexterity",
    "orientability",
    "workspace_volume",
    "deployment",
)

# Objectives under a force on the tip.
PUSHED = ("tip_deflection", "tip_stiffness")

# Translation (m) that counts as much as a rotation of 1 rad: at that distance from the axis, 1 rad moves the tip by
# as much.
PER_TURN = 0.05

# Length (m) in which singular values are counted, and what is added to their squares: the fourth power of an inverse
# overflows without it where one is 0. It changes a singular value of 1 mm by 5e-7.
UNIT, REGULAR = 0.01, 1e-8

# Added to squares of singular values of a rotation, rad^2: the root has no derivative at 0.
SLIGHT = 1e-7


@dataclass(frozen=True)
class Objective(Displayed):
    """Objective of a design.

    kind:
        "tip_curvature": curvature of the arm at its tip at `translations`, all tubes bending to one side; maximised.
            Of a bundle, halfway along the arm in the first task pose.
        "turning_radius": its inverse; minimised.
        "reach_radius": largest distance of the tip from the plate axis at height `depth`, m.
        "strain": largest strain of any tube, if straightened.
        "length": overall length of the longest tube.
        "margin": smallest certificate where a certificate is required, else the smallest margin of the task poses.
        "tip_deflection": largest displacement of the tip by `tip_force` and `tip_moment` over all task poses.
        "tip_stiffness": size of `tip_force` over the displacement along it, the smallest over all task poses.
        "stroke_force": largest force of the tip along its own direction before the arm buckles or snaps. The smallest
        over all task poses with given joint values; 10 N if all withstand that.
        "dexterity": smallest singular value s_3 of the tip Jacobian, per 1 rad or 50 mm, averaged over all task poses.
            It is smoothed as (sum of s_k^-8)^(-1/8), which is up to 13 % less.
        "orientability": rotation of the tip direction at a fixed tip position, per 1 rad or 50 mm, in the least
            responsive direction, averaged over all task poses. It is the smaller of two singular values, smoothed as
            (s_1^-8 + s_2^-8)^(-1/8), which is up to 8 % less. Position and direction are five numbers, so it needs
            three tubes.
        "workspace_volume": volume that the polygon of the tips of the task poses, in their order, sweeps around the
            plate axis when all tubes are rotated together.
        "deployment": RMS distance between the partly deployed arms (tubes retracted, not rotated) and the fully
            deployed arm, over all task poses.
        "change": sum of squares of the relative changes from the start.
    weight: factor of this objective in the sum of several, in SI.
    """

    kind: Annotated[str, OneOf(tuple(KINDS))]
    weight: Annotated[float, POSITIVE, "factor on the value in SI units, if there are several objectives"] = 1.0
    depth: Annotated[float | None, unit("mm"), "height of the tip, for reach_radius"] = None
    translations: Annotated[
        tuple[float, ...] | None, unit("mm"), "translations for tip_curvature and turning_radius; default all 0"
    ] = None
    tip_force: Annotated[
        tuple[float, float, float] | None,
        unit("mN"),
        "tip force for tip_deflection and tip_stiffness, in the base frame",
    ] = None
    tip_moment: Annotated[
        tuple[float, float, float] | None, unit("mN_m"), "tip moment for tip_deflection, in the base frame"
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, "the objective")
        if (self.kind == "reach_radius") != (self.depth is not None):
            raise InputError("depth is required for the objective reach_radius, and not allowed for others")
        if self.tip_moment is not None and self.kind != "tip_deflection":
            raise InputError("tip_moment is allowed for the objective tip_deflection only")
        if (self.kind in PUSHED) != (self.tip_force is not None or self.tip_moment is not None):
            raise InputError(
                f"tip_force is required for the objectives {' and '.join(PUSHED)}, and not allowed for others"
            )
        for name in ("tip_force", "tip_moment"):
            if getattr(self, name) is not None:
                push = vector(f"{name} of the objective", getattr(self, name), 3, "x, y, z")
                if not push.any():
                    raise InputError(f"{name} of the objective is 0; it must not be 0")
                object.__setattr__(self, name, tuple(push.tolist()))
        if self.translations is not None:
            if self.kind not in ("tip_curvature", "turning_radius"):
                raise InputError("translations are allowed for the objectives tip_curvature and turning_radius only")
            object.__setattr__(self, "translations", numbers("translations of the objective", self.translations))

    description, unit, factor, sign = (
        Delegate[str]("traits"),
        Delegate[str]("traits"),
        Delegate[float]("traits"),
        Delegate[int]("traits"),
    )

    @property
    def traits(self) -> Kind:
        """Name, unit and direction of the objective, from its kind."""
        return KINDS[self.kind]


AnyObjective = Objective | CustomObjective
"""Built-in or custom objective."""


def key_of(objective: AnyObjective) -> str:
    """Name of an objective within its task: its kind, or the description of a custom one."""
    return objective.kind if isinstance(objective, Objective) else objective.description


def shown(objective: AnyObjective, value: float) -> str:
    """Text of an objective's value with its name and unit."""
    return f"{objective.description} {value * objective.factor:.6g} {objective.unit}".strip()


def aim(
    objective: AnyObjective, space: DesignSpace, poses: Sequence[int], certified: Rows, depth_pose: int | None
) -> Expression | None:
    """CasADi expression of an objective in its own sign, SI; None for the change of the unknowns.

    The largest of its numbers counts if it is minimised, the smallest if it is maximised.

    Args:
        space: unknowns of the design.
        poses: numbers of the poses that count.
        certified: translations of the certificate, m.
        depth_pose: number of the pose of reach_radius.
    """
    if isinstance(objective, Objective) and objective.kind == "change":
        return None
    numbers = (
        objective.expression
        if isinstance(objective, CustomObjective)
        else partial(_numbers, objective, space.robot, poses, certified, depth_pose)
    )
    pieces = space.pieces
    last = max([*poses, depth_pose or 0] if isinstance(objective, Objective) else poses, default=-1)
    expression = recorded(numbers, len(pieces), last + 1, objective.description, pieces)
    count = expression.value.numel_out()
    if isinstance(objective, CustomObjective) and count != 1:
        raise InputError(f"the objective {objective.description} has {count} numbers; it must be one")
    return expression


def _numbers(
    objective: Objective,
    robot: Robot,
    poses: Sequence[int],
    certified: Rows,
    depth_pose: int | None,
    q: Quantities,
) -> Any:
    at = [q.poses[k] for k in poses]
    match objective.kind:
        case "strain":
            return ca.vertcat(*(q.straightened_strain(i) for i in range(q.n_tubes)))
        case "margin" if certified:
            return ca.vertcat(*(q.certificate(row) for row in certified))
        case "margin":
            return ca.vertcat(*(pose.margin for pose in at))
        case "tip_deflection":
            load = Load(objective.tip_force or ZERO, objective.tip_moment or ZERO)
            return ca.vertcat(*(ca.norm_2(pose.deflection(load)) for pose in at))
        case "tip_stiffness":
            force = ca.DM(list(objective.tip_force or ()))
            return ca.vertcat(*(ca.sumsqr(force) / ca.dot(force, pose.deflection(objective.tip_force)) for pose in at))
        case "stroke_force":
            return ca.vertcat(*(pose.stroke_force for pose in at))
        case "dexterity":
            return sum(_smallest_motion(pose.jacobian) for pose in at) / len(at)
        case "orientability":
            return sum(_smallest_turn(pose) for pose in at) / len(at)
        case "workspace_volume":
            return _swept([pose.tip_position for pose in at])
        case "deployment":
            gaps = deviations(q, poses)
            return ca.sqrt(ca.sumsqr(gaps) * 3 / gaps.numel() + ROUNDED**2)
        case "length":
            return q.tubes["straight_length"] + q.tubes["curved_length"]
        case "reach_radius":
            assert depth_pose is not None
            return ca.norm_2(q.poses[depth_pose].tip_position[:2])
        case "tip_curvature":
            return _tip_curvature(objective, robot, q)
        case _:
            return 1 / _tip_curvature(objective, robot, q)


def _scaled(jacobian: Any) -> Any:
    """Jacobian (3, 2 n) by rotations and translations, scaled to 1 rad or PER_TURN."""
    n = jacobian.shape[1] // 2
    return ca.horzcat(jacobian[:, :n], PER_TURN * jacobian[:, n:])


def _smallest_turn(pose: PoseQuantities) -> Any:
    """Smoothed smallest rotation of the tip direction at a fixed tip position, (s_1^-8 + s_2^-8)^(-1/8), rad.

    s_1 and s_2 are the singular values of the Jacobian of the direction, projected on the null space of that of the
    position.
    """
    moves, heading = _scaled(pose.jacobian) / UNIT, pose.tip_direction
    turns = -ca.skew(heading) @ _scaled(pose.turning)
    free = ca.DM.eye(moves.shape[1]) - moves.T @ ca.inv(moves @ moves.T + REGULAR * ca.DM.eye(3)) @ moves
    square = turns @ free @ turns.T  # its third eigenvalue, along the direction, is 0
    plain = ca.trace(square)
    total = plain + 2 * SLIGHT
    product = (plain**2 - ca.trace(square @ square)) / 2 + SLIGHT * plain + SLIGHT**2
    quartic = (total**2 - 2 * product) ** 2 - 2 * product**2
    return ca.sqrt(product) * quartic ** (-1 / 8)


def _smallest_motion(jacobian: Any) -> Any:
    """Smoothed smallest singular value (sum s_k^-8)^(-1/8) of the Jacobian (3, 2 n) of the tip, m."""
    scaled = _scaled(jacobian) / UNIT
    inverse = ca.inv(scaled @ scaled.T + REGULAR * ca.DM.eye(3))
    return UNIT * ca.trace(inverse @ inverse @ inverse @ inverse) ** (-1 / 8)


def _swept(tips: Sequence[Any]) -> Any:
    """Volume of the body of revolution of a polygon of points (3,), by Pappus; independent of its orientation."""
    radius = [ca.sqrt(tip[0] ** 2 + tip[1] ** 2 + ROUNDED**2) for tip in tips]
    total = 0.0
    for k, tip in enumerate(tips):
        r, z, s, w = radius[k - 1], tips[k - 1][2], radius[k], tip[2]
        total += (r * w - s * z) * (r + s)
    return np.pi / 3 * ca.sqrt(total**2 + 1e-12**2)


def _tip_curvature(objective: Objective, robot: Robot, q: Quantities) -> Any:
    """Curvature of the section at the tip, 1/m, with all tubes bending to one side; of a bundle as in `Objective`."""
    if not robot.fixed_sections:
        return ca.norm_2(q.poses[0].curvature(0.5))
    shift = ca.DM.zeros(q.n_tubes) if objective.translations is None else ca.DM(objective.translations)
    kb, end = q.tubes["bending_stiffness"], shift + q.tubes["curved_length"]
    stiffness = kb * (end >= ca.mmax(end) - LENGTH_ROUND_OFF)
    bent = stiffness * ca.fabs(q.tubes["curvature"]) * (q.tubes["curved_length"] > 0)
    return cross_section(ca.DM.zeros(q.n_tubes), stiffness, bent).curvature[0]

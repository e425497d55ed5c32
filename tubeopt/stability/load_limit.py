"""Load limit: fold or bifurcation at the end of the stable branch of an equilibrium under a growing load."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..equilibrium.continuation import Family, reach, step_to
from ..equilibrium.kinematics import forward_kinematics, point_of, to_equilibrium
from ..equilibrium.member import AnyPoint, Member
from ..equilibrium.problem import check_load
from ..equilibrium.result import Equilibrium, Statistics
from ..errors import InputError, SolveError, positive
from ..files.field_metadata import unit
from ..robots.eccentric import by_model
from ..robots.load import Load
from ..robots.robot import Robot, joint_values
from ..solvers.blas import small
from ..solvers.time_limit import TIME_LIMIT, limited
from ..typing import StatusEnum
from .folds import MIN_JUMP, PAST, Loss, across, branch_end, fall

# The mesh must suit the largest load of a stage. Four times the load needs at most twice the pieces, and ten times the
# load, the default limit, takes three stages.
LOAD_STAGE = 4.0
"""Ratio of the largest loads of successive stages of a growing load; every stage has its own mesh."""


class LoadLimitStatus(StatusEnum):
    """Kind of the end of a branch, as a sentence."""

    FOLD = "the equilibrium vanishes in a fold, and the robot snaps"
    BIFURCATION = "the equilibrium becomes unstable at a bifurcation, and the robot buckles"
    ENDS = "ends of tubes separate or pass each other, and the robot snaps"
    FLUTTER = "the equilibrium becomes unstable, and the robot begins to flutter: it oscillates more and more"


@dataclass(frozen=True, eq=False)
class LoadLimit(Displayed):
    """End of the stable branch as the load grows from 0."""

    factor: Annotated[float, "load factor at which stability is lost"]
    kind: Annotated[
        str,
        "fold: the equilibrium vanishes; bifurcation: it becomes unstable; ends: the order of ends of tubes changes; "
        "flutter: slow oscillations grow",
    ]
    """"fold", "bifurcation", "ends" or "flutter".

    At a fold the equilibrium vanishes, and the robot snaps. At a bifurcation it continues but is unstable, and the
    robot leaves it to one of two sides, like a buckling column; symmetric poses do this. In a bundle ends of tubes that
    are at one place may separate, or pass each other, and the robot snaps. Flutter occurs only under a load without an
    energy: the equilibrium continues, but slow oscillations about it grow (docs/loads.md).
    """
    before: Annotated[Equilibrium, "equilibrium at the limit"]
    """Equilibrium at the limit; its margin is 0, but for the kind "ends"."""
    after: Annotated[Equilibrium | None, "equilibrium after the loss of stability; null if none was found"]
    """Equilibrium after the loss of stability.

    At a fold, and at ends that separate, at the same load; at a bifurcation at a load larger by the fraction
    `folds.PAST`, on one of two equally likely sides. None if descent finds no equilibrium, and after flutter.
    """
    tip_jump: Annotated[float, unit("mm"), "distance that the tip jumps"]
    """Distance at the load of `after`, from the equilibrium that the robot leaves; NaN without `after`."""
    energy_released: Annotated[float, unit("mJ"), "energy released by tubes and load; null for a load without energy"]
    """Energy released by tubes and load, J; NaN under a load without an energy."""

    @property
    def value(self) -> float:
        """Load factor."""
        return self.factor

    @property
    def status(self) -> LoadLimitStatus:
        """Kind of the limit, as a sentence."""
        return LoadLimitStatus[self.kind.upper()]

    @property
    def statistics(self) -> Statistics:
        """Statistics of the equilibrium at the limit."""
        return self.before.statistics


@typed
@by_model
@small
@limited
def find_load_limit(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None,
    load: Load,
    *,
    equilibrium: Equilibrium | None = None,
    up_to: float = 10.0,
    time_limit: float = TIME_LIMIT,
) -> LoadLimit | None:
    """Load factor that makes a robot lose stability at fixed joint values; None if it withstands `up_to`.

    Folds are roots of a bordered determinant. Bifurcations are roots of the smallest eigenvalue on the branch, which
    continues.

    Args:
        rotations, translations: (n,) rad and m; translations None for home.
        load: forces and moments.
        equilibrium: stable, unloaded equilibrium at the start; by default that of `forward_kinematics`.
        up_to: largest load factor to search.
        time_limit: maximum run time, s.

    Raises:
        InputError: joint values as in `forward_kinematics`; an equilibrium that is loaded, unstable, or elsewhere.
        SolveError: no stable equilibrium without load; or the branch is lost without a fold or bifurcation close by.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> push = tubeopt.Load((0.0, 0.0, -0.1))
        >>> tubeopt.find_load_limit(robot, [0.0, 0.0, 0.0], None, push, up_to=2.0) is None
        True
    """
    alpha, translation = joint_values(robot, rotations, translations)
    shift = tuple(translation.tolist())
    check_load(robot, load, shift)
    positive("up_to", up_to)
    first = equilibrium if equilibrium is not None else forward_kinematics(robot, alpha, shift)
    if first.load is not None or not first.stable:
        raise InputError("equilibrium is loaded or unstable; it must be unloaded and stable")
    if not np.allclose(np.concatenate([first.rotations, first.translations]), [*alpha, *shift], rtol=0, atol=1e-9):
        raise InputError("equilibrium is at other joint values; they must be the same")
    result = find_loss(first, load, up_to)
    if result is None:
        return None
    loss, scale = result

    before = to_equilibrium(loss.point, "the load before")
    left = loss.point
    if loss.kind == "bifurcation":
        # The branch continues: the robot leaves it just beyond.
        left = _restart(left, replace(left.member, factor=loss.t * (1 + PAST)))
    landed = None if loss.kind == "flutter" else loss.landed or fall(left, loss.direction)
    if landed is None:
        return LoadLimit(
            factor=loss.t * scale,
            kind=loss.kind,
            before=before,
            after=None,
            tip_jump=float("nan"),
            energy_released=float("nan"),
        )
    after = to_equilibrium(landed, "the load before")
    return LoadLimit(
        factor=loss.t * scale,
        kind=loss.kind,
        before=before,
        after=after,
        tip_jump=float(np.linalg.norm(after.tip_position - to_equilibrium(left, "the load before").tip_position)),
        energy_released=left.state.potential - landed.state.potential,
    )


class ScaledLoss(NamedTuple):
    """End of the branch under a load that grows from 0 in stages."""

    loss: Loss
    """End of the branch, with t the factor on the load of the last stage."""
    scale: float
    """Load of the last stage as a factor on the load."""


def find_loss(first: Equilibrium, load: Load, up_to: float) -> ScaledLoss | None:
    """End of the branch that begins at a stable, unloaded equilibrium; None up to `up_to` times the load."""
    point, reached = None, 0.0
    while reached < up_to:
        scale = min(up_to, LOAD_STAGE * reached if reached else 1.0)
        stage_load = load.scaled(scale)
        if point is None:
            point = point_of(first, stage_load)
        else:
            point = _restart(point, point.member.under(point, stage_load, reached / scale))
        family = Family.growing(point.member)
        while (point := reach(family, point)).t < 1.0:
            loss = branch_end(family, point, 1.0)
            if loss is None:
                over = across(family, point, min(1.0, point.t + PAST))
                if over is None:
                    raise SolveError(
                        f"the branch is lost at {point.t * scale:.6g} times the load, "
                        "but no fold or bifurcation is found there",
                        to_equilibrium(point, "the load before"),
                    )
                if over.member.distance(point, over.state) <= MIN_JUMP:
                    point = over  # ends of tubes change their order without a snap
                    continue
                loss = Loss(point, "ends", point.softest, step_to(family, point.t, over) or over)
            return ScaledLoss(loss, scale)
        reached = scale
    return None


def _restart(point: AnyPoint, member: Member[Any]) -> AnyPoint:
    """Equilibrium of the same robot on another mesh, or at a slightly larger load, close to a point."""
    failure = "no equilibrium on the mesh of a larger load, or just beyond the loss of stability"
    return replace(point.onto(member, failure), t=member.factor)

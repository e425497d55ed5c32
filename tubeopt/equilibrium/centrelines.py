"""Centrelines and lengths of eccentric tubes; a segmented robot as a chain of separate segments."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..block.transcription.buffered import section_function
from ..errors import SolveError
from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.eccentric import SegmentedEccentricRobot
from ..robots.robot import joint_values
from ..typing import Array
from .kinematics import forward_kinematics, point_of
from .result import Equilibrium


def tube_centrelines(equilibrium: Equilibrium) -> Array:
    """(n, m, 3) centreline of every tube, m, at the m arc lengths of the arm.

    It is p + R (d cos gamma, d sin gamma, 0).

    NaN beyond a tube's own end, and everywhere for a tube that does not reach past the plate.
    """
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    lines = equilibrium.position + np.einsum("mab,nb->nma", equilibrium.frame[:, :, :2], assembly.across)
    lines[equilibrium.arc_length > assembly.end[:, None] + LENGTH_ROUND_OFF] = np.nan
    return np.asarray(lines)


def tube_lengths(equilibrium: Equilibrium) -> Array:
    """(n,) arc lengths of the tubes' own centrelines from the plate to their ends, m: int g ds.

    Tubes on the inside of a bend are shorter than the arm, tubes on the outside longer. The sheath ends the three tubes
    of a segment in one plane, so they slide against one another behind the plate. The integral uses the collocation
    points and is as accurate as the rotations there. A straight arm has g = 1.

    Raises:
        SolveError: the equilibrium is a fold, which cannot be solved again at its own collocation points.
    """
    assembly = equilibrium.robot.assembly(equilibrium.translations)
    ends = np.maximum(assembly.end, 0.0)
    if not assembly.eccentric:
        return ends
    point = point_of(equilibrium)
    problem, count = point.member.problem, len(point.member.problem.weight)
    if not count:
        return ends
    moment = section_function("moment", count, assembly.n_tubes, True)
    offsets = (assembly.offset, assembly.offset_angle)
    stretch = moment(point.state.theta, problem.stiffness, problem.moment, *offsets)[1]
    present = problem.arc_length[:, None] < ends
    return np.asarray(ends + problem.weight @ ((stretch - 1) * present))


@dataclass(frozen=True, eq=False)
class SegmentChain:
    """Segmented eccentric robot as a chain of segments, each solved alone with its tubes on the centreline."""

    robot: SegmentedEccentricRobot
    rotations: Array
    """(3 k,) joint rotations, rad."""
    translations: Array
    """(3 k,) joint translations, m."""
    segments: tuple[Equilibrium, ...]
    """Equilibrium of every segment in front of the plate in its own frame, base to tip."""
    start: Array
    """(len(segments),) arc lengths of the starts of the curved segments, m."""
    arc_length: Array
    """(m,) arc lengths of the points, m."""
    position: Array
    """(m, 3) points of the chained centreline, m."""
    tip_position: Array
    """(3,) tip in the plate frame, m."""
    tip_rotation: Array
    """(3, 3) frame of the tip in the plate frame."""

    def full_model(self) -> Equilibrium:
        """The coupled equilibrium of the whole robot on the chain's branch, followed from the same tubes at d = 0.

        Raises:
            SolveError: the branch ends on the path, or the whole robot at d = 0 converges to another branch.
        """
        centred = replace(self.robot, offset=0.0)
        guess = forward_kinematics(centred, self.rotations, self.translations)
        apart = self.deviation(guess)[0]
        if apart > 1e-6:
            raise SolveError(f"the equivalent robot at d = 0 is on another branch, {1e3 * apart:.3g} mm away")
        return forward_kinematics(self.robot, self.rotations, self.translations, start=guess)

    def deviation(self, equilibrium: Equilibrium) -> tuple[float, float]:
        """Distance of the chain's tip from the tip of `equilibrium`, in m and as a fraction of the arm's length.

        With long transmissions a robot has several stable equilibria: compare with the one of `full_model`.
        """
        distance = float(np.linalg.norm(self.tip_position - equilibrium.tip_position))
        length = float(equilibrium.arc_length[-1])
        return distance, distance / length if length else 0.0


def chained_approximation(
    robot: SegmentedEccentricRobot, rotations: ArrayLike, translations: ArrayLike | None = None
) -> SegmentChain:
    """The robot as a chain of concentric three-tube arms: the fast approximation of the thesis (3.4.2).

    In every segment the three tubes lie on the centreline (d = 0), with the straight tubes of the inner segments that
    stiffen it. The torsion of a segment's tubes behind the plate and through outer segments is linear and included.
    Only the offset is neglected, with the stretch g of tubes beside a bend: without overlap of curved parts nothing
    else couples the segments.

    Args:
        rotations, translations: (3 k,) rad and m, ordered as `robot.tubes`; translations default to home.

    Raises:
        InputError: wrong number of joint values, or joint values that `robot` does not allow.
        SolveError: no stable equilibrium was found for a segment.
    """
    alpha, shift = joint_values(robot, rotations, translations)
    bundle = robot.assembly(shift)
    transition, end = bundle.transition[::3], bundle.end[::3]
    segments, starts, lines, lengths = [], [], [np.zeros((1, 3))], [np.zeros(1)]
    position, frame, reached = np.zeros(3), np.eye(3), 0.0
    for k in reversed(range(len(robot.segments))):
        if end[k] <= LENGTH_ROUND_OFF:
            continue
        start = max(float(transition[k]), 0.0)
        position = position + frame[:, 2] * (start - reached)
        segment = _segment(robot, k, alpha[3 * k : 3 * k + 3], min(float(shift[3 * k]), 0.0))
        segments.append(segment)
        starts.append(start)
        lines.append(position + segment.position @ frame.T)
        lengths.append(start + segment.arc_length)
        position = lines[-1][-1]
        frame = frame @ segment.tip_rotation
        reached = float(end[k])
    return SegmentChain(
        robot=robot,
        rotations=alpha,
        translations=shift,
        segments=tuple(segments),
        start=np.array(starts),
        arc_length=np.concatenate(lengths),
        position=np.concatenate(lines),
        tip_position=position,
        tip_rotation=frame,
    )


def _segment(robot: SegmentedEccentricRobot, k: int, rotations: Array, advance: float) -> Equilibrium:
    """Robot of segment `k` alone, advanced by `advance` <= 0, with the straight tubes of the inner segments in it.

    Its tubes' straight parts, with rotation and torsion unchanged along them, lie behind its own plate.
    """
    segment = robot.segments[k]
    inner = tuple(replace(tube, straight_length=segment.length, curved_length=0.0) for tube in robot.segments[:k])
    alone = SegmentedEccentricRobot((*inner, segment), offset=0.0)
    turned = np.concatenate([np.zeros(3 * k), rotations])
    shifts = np.repeat([advance + segment.curved_length] * k + [advance], 3)
    return forward_kinematics(alone, turned, shifts)

"""Correction for the clearance between tubes: inner tubes leave the end of an outer one off its axis and tilted.

Let y be the lateral displacement of the inner tubes in the outer one, |y| <= delta, and rho the difference of the
curvatures that both would have alone. Both bend, so the energy beyond that of tubes on one centreline is, with bending
stiffnesses k_i and k_o,

    1/2 int k_i k_o / (k_i + k_o) |y'' - rho|^2 ds,     |y| <= delta,     no moment where the outer tube ends.

Far inside, contact with the wall transmits the moment. Towards the end the inner tubes cross from one wall to the other
over a length l: y'' = rho x / l and rho l^2 / 6 = 2 delta, so

    l = sqrt(12 delta / rho)     and the tilt is     rho l / 2 = sqrt(3 delta rho),

if the direction of rho changes little over l. Shorter overlaps leave the inner tubes free: the tilt is rho times their
length. The common centreline stays, so that the inner tubes have the fraction k_o / (k_i + k_o) of tilt and of delta.

Bound: the moment M, over k_i k_o / (k_i + k_o), is linear between contacts with the walls, which bend its graph towards
themselves. Its extremes are at contacts, where y'' = M + rho points away from the wall. So |M| <= max |rho| =: R and
|y''| <= 2 R, and with Landau's inequality the tilt is at most 2 sqrt(2 delta R). This is a proof for tubes that are
bent in one plane without external forces.

The same effects are treated by Ha, Fagogenis and Dupont, "Modeling tube clearance and bounding the effect of friction
in concentric tube robot kinematics", IEEE Transactions on Robotics 35(2), 2019.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..arguments import typed
from ..block.transcription.buffered import section_function
from ..display import Displayed
from ..errors import InputError
from ..robots.assembly import Assembly
from ..robots.concentric import ConcentricRobot, clearances
from ..robots.robot import drawn_clearance
from ..typing import Array
from .result import Equilibrium

SHORTEST = 1e-9
"""Length (m) of the arm beyond the end of a tube below which it is ignored."""


@dataclass(frozen=True, eq=False)
class Leaving(Displayed):
    """End of a tube in front of the plate, where inner tubes continue beyond it."""

    tube: int
    """Number of the tube that ends, from 0."""
    arc_length: float
    """Position of its end, m."""
    clearance: float
    """Radial clearance delta, m."""
    mismatch: float
    """Difference rho of the curvatures that both would have alone, 1/m."""
    contact: float
    """Length over which the inner tubes cross from one wall to the other, m."""
    turn: Array
    """(3,) rotation vector of the arm beyond, rad."""
    shift: Array
    """(3,) displacement of the arm beyond, m."""
    most_turn: float
    """Estimate of the largest rotation, rad; a bound for tubes bent in one plane without external forces."""
    most_shift: float
    """Estimate of the largest displacement, m; a bound for the same tubes."""


@dataclass(frozen=True, eq=False)
class ClearanceCorrection(Displayed):
    """Arm with the tilts by the clearance of its tubes, to first order."""

    equilibrium: Equilibrium
    """Equilibrium of tubes on one centreline."""
    leavings: tuple[Leaving, ...]
    """Ends of tubes inside others, from base to tip."""
    position: Array
    """(M, 3) corrected points of the arm, m."""
    turn: Array
    """(3, 3) rotation of the tip frame by the clearance."""
    radius: Array
    """(M,) estimated largest displacement of points by the clearance, m.

    A first-order bound for tubes that are bent in one plane.
    """

    @property
    def tip_position(self) -> Array:
        """(3,) corrected position of the tip, m."""
        return np.asarray(self.position[-1])

    @property
    def tip_rotation(self) -> Array:
        """(3, 3) corrected orientation of the tip."""
        return np.asarray(self.turn @ self.equilibrium.tip_rotation)

    @property
    def tip_radius(self) -> float:
        """Estimated largest displacement of the tip by the clearance, m."""
        return float(self.radius[-1])


@typed
def clearance_correction(
    equilibrium: Equilibrium, clearance: Sequence[float] | float | None = None
) -> ClearanceCorrection:
    """Correction of a concentric robot's tip for the radial clearance between its tubes.

    Where a tube ends inside others that continue, these are assumed to stay in place.

    Args:
        clearance: (n - 1,) m, radial clearance of every tube in the next one, or one number for all. By default that of
            the robot's file, else that of its diameters.

    Raises:
        InputError: an eccentric robot, or clearances that are negative, not finite, or for another number of tubes.

    Examples:
        >>> import numpy as np
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> pose = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0])
        >>> tilted = tubeopt.clearance_correction(pose, 20e-6)
        >>> bool(np.linalg.norm(tilted.tip_position - pose.tip_position) < tilted.tip_radius)
        True
    """
    e, robot = equilibrium, equilibrium.robot
    if not isinstance(robot, ConcentricRobot):
        raise InputError("robot is eccentric; clearance between tubes is defined for concentric robots only")
    inputs = clearance if clearance is not None else robot.clearance or drawn_clearance(robot.tubes)
    delta = clearances(inputs, robot.n_tubes)
    outer_tubes = sorted(range(1, robot.n_tubes), key=lambda o: e.tube_end[o])
    leavings = tuple(leaving for o in outer_tubes if (leaving := _leaving(e, o, delta[o - 1])) is not None)
    position, turn, radius = e.position.copy(), np.zeros(3), np.zeros(len(e.position))
    for leaving in leavings:
        lever = e.position - e.position[int(np.searchsorted(e.arc_length, leaving.arc_length))]
        beyond = (e.arc_length > leaving.arc_length)[:, None]
        position += beyond * (np.cross(leaving.turn, lever) + leaving.shift)
        radius += beyond[:, 0] * (leaving.most_turn * np.linalg.norm(lever, axis=1) + leaving.most_shift)
        turn = turn + leaving.turn
    return ClearanceCorrection(e, leavings, position, _rotation(turn), radius)


def _leaving(e: Equilibrium, outer: int, delta: float) -> Leaving | None:
    """End of an outer tube with clearance `delta`.

    None if it is behind the plate, where no inner tube continues, or where both have the same curvature.
    """
    end = float(e.tube_end[outer])
    if end <= 0 or e.tube_end[:outer].max() - end < SHORTEST:
        return None
    assembly = e.robot.assembly(e.translations)
    before = e.arc_length <= end
    mismatch, stiffness = _mismatch(assembly, e, outer, np.append(e.arc_length[before], end))
    rho_end, rho_max = mismatch[-1], float(np.linalg.norm(mismatch, axis=1).max())
    rho = float(np.linalg.norm(rho_end))
    if rho * end < 1e-12:
        return None
    contact = min(np.sqrt(12 * delta / rho), end)
    tilt = min(np.sqrt(3 * delta * rho), rho * end)
    inner_fraction = stiffness[1] / stiffness.sum()
    frame = e.frame[int(np.searchsorted(e.arc_length, end))]
    axis = frame[:, :2] @ rho_end / rho
    sideways = np.cross(axis, frame[:, 2])
    # Landau's inequality over the best length, or over a shorter overlap.
    length = min(np.sqrt(2 * delta / rho_max), end)
    max_tilt = 2 * delta / length + rho_max * length if delta else 0.0
    return Leaving(
        tube=outer,
        arc_length=end,
        clearance=delta,
        mismatch=rho,
        contact=float(contact),
        turn=inner_fraction * tilt * axis,
        shift=inner_fraction * delta * sideways,
        most_turn=float(inner_fraction * max_tilt),
        most_shift=inner_fraction * delta,
    )


def _mismatch(assembly: Assembly, e: Equilibrium, outer: int, at: Array) -> tuple[Array, Array]:
    """(X, 2) mismatch rho (1/m) in the arm's frame up to the end of the outer tube, and stiffnesses (2,), N m^2.

    rho is the difference of the curvatures that the inner tubes and the outer one would have alone. The stiffnesses are
    those of the inner tubes and of the outer one at its end.
    """
    inside = np.minimum(at, at[-1] - SHORTEST)
    angle = np.column_stack([np.interp(inside, e.arc_length, row) for row in e.rotation])
    sections = assembly.cross_sections(inside, inside)
    stiffness = sections.stiffness
    angle += sections.phase - sections.twist_angle

    def curvature(tubes: slice) -> Array:
        part = angle[:, tubes], stiffness[:, tubes], sections.moment[:, tubes]
        return section_function("curvature", len(at), part[0].shape[1], False)(*part)[0].copy()

    last = stiffness[-1]
    return curvature(slice(outer)) - curvature(slice(outer, outer + 1)), np.array([last[:outer].sum(), last[outer]])


def _rotation(turn: Array) -> Array:
    """(3, 3) rotation matrix of a rotation vector."""
    from scipy.spatial.transform import Rotation  # takes as long to load as thousands of solves

    return np.asarray(Rotation.from_rotvec(turn).as_matrix())

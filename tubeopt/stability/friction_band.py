"""How far friction can hold an arm from where it would be without, whatever its history: bounds without a path.

Every state with friction obeys grad E + P' lam = 0 with |lam| <= D. To first order around the equilibrium without
friction a place p moves by -J H^-1 P' lam, so by at most |J H^-1 P'| D along each axis. A bound that is none of first
order follows where the energy is convex at these joint values, H >= mu > 0 (the snap-free certificate): then
|x - x0| <= |P' lam| / mu, and with m_i = kb_i kappa_i, K = sum kb_i

    |P' lam|^2 <= D' |P P'| D
    |p - p0| <= int |u - u0| (s_p - s) ds <= sum_i int (|m_i| / K) |theta_i - theta_i0| (s_p - s) ds
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..arguments import typed
from ..block.transcription.buffered import section_function
from ..block.transcription.contact import make_contact
from ..block.transcription.linear import poses_at_points
from ..block.transcription.reduced import ReducedProblem
from ..block.transcription.whole_arm import evaluate_arm
from ..display import Displayed
from ..equilibrium.friction import Held, check_rubbing, shaken
from ..equilibrium.result import Equilibrium, refuse_load
from ..robots.friction import Friction
from ..solvers.parallel.blas import small
from ..typing import Array
from .certificate import convexity


@dataclass(frozen=True, eq=False)
class FrictionBand(Displayed):
    """Where friction can hold an arm at M points along it."""

    equilibrium: Equilibrium
    """Without friction."""
    friction: Friction
    """As given."""
    certificate: float
    """Of convexity at these translations; without tubes made of pieces that of freedom from snaps."""
    first_order: Array
    """(M, 3) half widths along the axes of the plate, m, true for small friction only."""
    guaranteed: Array
    """(M,) radius around the equilibrium that no state at these joint values leaves, m; inf where the certificate is
    not positive."""

    @property
    def tip_half_widths(self) -> Array:
        """(3,) of the tip, m, to first order."""
        return np.asarray(self.first_order[-1])

    @property
    def tip_radius(self) -> float:
        """That of the tip, m, guaranteed."""
        return float(self.guaranteed[-1])


@typed
@small
def friction_band(equilibrium: Equilibrium, friction: Friction) -> FrictionBand:
    """How far friction can hold a concentric robot from an equilibrium without friction, whatever its history.

    Raises:
        InputError: an equilibrium under load or friction, a friction for another robot, an eccentric robot.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> pose = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0])
        >>> band = tubeopt.friction_band(pose, tubeopt.Friction(torque=0.001))
        >>> bool(band.tip_radius > 0)
        True
    """
    robot = equilibrium.robot
    check_rubbing(robot, friction)
    refuse_load(equilibrium)
    assembly = robot.assembly(equilibrium.translations)
    held = shaken(make_contact(assembly, friction, everywhere=True), equilibrium)
    contact, state = held.contact, held.found.state
    response = scipy.linalg.solve(state.hessian, contact.rows.T, assume_a="sym")
    slopes = _place_slopes(equilibrium, held)
    first = np.abs(slopes @ response[: contact.problem.size]) @ contact.capacity
    certificate = convexity(robot, equilibrium.translations)
    push = contact.capacity @ np.abs(contact.rows @ contact.rows.T) @ contact.capacity
    guaranteed = np.full(len(equilibrium.arc_length), np.inf)
    if certificate > 0:
        guaranteed = _levers(equilibrium, contact.problem) * (np.sqrt(push) / certificate)
    return FrictionBand(equilibrium, friction, certificate, first, guaranteed)


def _place_slopes(equilibrium: Equilibrium, held: Held) -> Array:
    """(M, 3, U) change of the points along the arm with z: a curvature changed by du turns all beyond by R du ds."""
    problem, e = held.contact.problem, equilibrium
    n, count = problem.assembly.n_tubes, len(problem.weight)
    theta = held.found.state.elastic.theta + problem.phase
    bent = section_function("curvature_slope", count, n, False)(theta, problem.stiffness, problem.moment)[0]
    frames, places = _poses(held)
    turn = np.einsum("nab,nib->nia", frames[:, :, :2], bent.reshape(count, n, 2)) * problem.weight[:, None, None]
    ahead = (e.arc_length[:, None] > problem.arc_length)[..., None] * (e.position[:, None] - places)
    point, tube = problem.point, problem.tube
    moved = np.cross(turn[point, tube], ahead[:, point])
    return np.asarray(moved.swapaxes(1, 2) @ problem.factor)


def _poses(held: Held) -> tuple[Array, Array]:
    """Frames (N, 3, 3) and positions (N, 3) at the collocation points."""
    problem = held.contact.problem
    arm = evaluate_arm(problem, held.rotations, held.found.state.torsion, held.profile)
    shape = arm.frame, arm.position, arm.curvature
    frames, places = poses_at_points(problem.mesh.tableau, problem.mesh.length, shape)
    chosen = problem.mesh.collocated
    return frames[chosen].reshape(-1, 3, 3), places[chosen].reshape(-1, 3)


def _levers(equilibrium: Equilibrium, problem: ReducedProblem) -> Array:
    """(M,) how far a point moves at most per unit of |z|."""
    pull = problem.moment / np.maximum(problem.stiffness.sum(1), 1e-300)[:, None]
    point, tube = problem.point, problem.tube
    reach = np.maximum(equilibrium.arc_length[:, None] - problem.arc_length, 0.0)
    weights = (np.abs(pull) * problem.weight[:, None])[point, tube] * reach[:, point]
    compliance = np.abs(problem.factor @ problem.factor.T)
    return np.asarray(np.sqrt(np.einsum("ma,ab,mb->m", weights, compliance, weights)))

"""How far friction can hold an arm from where it would be without, whatever its history: bounds without a path.

Every state with friction obeys grad E + P' lam = 0 with |lam| <= D, E the potential energy of torsion and bending under
the load, if any. To first order around the equilibrium without friction a place p moves by -J H^-1 P' lam, so by at
most |J H^-1 P'| D along each axis. A bound that is none of first order follows where the energy is convex at these
joint values, H >= mu > 0 (the snap-free certificate, under a force on the tip that for all forces of its size): then
|x - x0| <= |P' lam| / mu, and with m_i = kb_i kappa_i, K = sum kb_i, u = u_natural(theta) + w

    |P' lam|^2 <= D' |P P'| D
    |p - p0| <= int |u - u0| (s_p - s) ds <= int (sum_i (|m_i| / K) |theta_i - theta_i0| + |w - w0|) (s_p - s) ds
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..arguments import typed
from ..block.transcription.contact import make_contact
from ..block.transcription.loaded import LoadedProblem, LoadedState
from ..block.transcription.loaded_arm import integration_to
from ..block.transcription.orientation import tangent_slopes
from ..display import Displayed
from ..equilibrium.friction import check_rubbing, shaken
from ..equilibrium.problem import check_load, loading_of
from ..equilibrium.result import Equilibrium, refuse_friction
from ..robots.friction import Friction
from ..robots.load import Load
from ..solvers.parallel.blas import small
from ..typing import Array
from .certificate import convexity, snap_free_certificate


@dataclass(frozen=True, eq=False)
class FrictionBand(Displayed):
    """Region of equilibria that friction allows for an arm, at M points along it."""

    equilibrium: Equilibrium
    """Equilibrium without friction."""
    friction: Friction
    """The friction."""
    certificate: float
    """Certificate of convexity at these translations; under a tip force, that for all forces of its size. -inf under
    other loads, and under a force with tubes made of pieces.
    """
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
        """Guaranteed largest displacement of the tip by friction, m."""
        return float(self.guaranteed[-1])


@typed
@small
def friction_band(equilibrium: Equilibrium, friction: Friction) -> FrictionBand:
    """Largest displacement that friction allows from an equilibrium without friction, for any history; concentric
    robots.

    Raises:
        InputError: an equilibrium under friction, or under a load without an energy; a friction for another robot, an
            eccentric robot.

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
    refuse_friction(equilibrium)
    shift, load = tuple(equilibrium.translations.tolist()), equilibrium.load or Load()
    check_load(robot, load, shift)
    load.require_energy("there is no least energy around which friction could be bounded")
    assembly, loading = loading_of(robot, shift, load)
    held = shaken(make_contact(assembly, friction, loading), equilibrium)
    contact, state, problem = held.contact, held.found.state, held.contact.loaded
    assert problem is not None
    assert isinstance(state.elastic, LoadedState)
    response = scipy.linalg.solve(state.hessian, contact.rows.T, assume_a="sym")
    slopes = _place_slopes(equilibrium.arc_length, problem, state.elastic)
    first = np.abs(slopes @ response[: problem.size]) @ contact.capacity
    certificate = _convexity(equilibrium, load)
    push = contact.capacity @ np.abs(contact.rows @ contact.rows.T) @ contact.capacity
    guaranteed = np.full(len(equilibrium.arc_length), np.inf)
    if certificate > 0:
        guaranteed = _levers(equilibrium, problem) * (np.sqrt(push) / certificate)
    return FrictionBand(equilibrium, friction, certificate, first, guaranteed)


def _convexity(equilibrium: Equilibrium, load: Load) -> float:
    """Lower bound of the second variation of the energy at any shape and rotations, relative to its elastic part."""
    robot, shift = equilibrium.robot, equilibrium.translations
    if not load.tip_force_only:
        return -np.inf
    force = float(np.linalg.norm(load.force))
    return snap_free_certificate(robot, shift, max_force=force) if force else convexity(robot, shift)


def _place_slopes(arc_length: Array, problem: LoadedProblem, state: LoadedState) -> Array:
    """(M, 3, X) change of the points along the arm with torsion and bending."""
    weights, along = np.array([integration_to(problem, s) for s in arc_length.tolist()]), state.orientation
    moved = (tangent_slopes(along.stage) @ along.stage_slope).reshape(len(along.stage), -1)
    return np.asarray((weights @ moved).reshape(len(weights), 3, -1) @ state.turned)


def _levers(equilibrium: Equilibrium, loaded: LoadedProblem) -> Array:
    """(M,) how far a point moves at most per unit of |(z, q)|."""
    problem = loaded.torsion
    pull = problem.moment / np.maximum(problem.stiffness.sum(1), 1e-300)[:, None]
    point, tube = problem.point, problem.tube
    reach = np.maximum(equilibrium.arc_length[:, None] - problem.arc_length, 0.0)
    weights = (np.abs(pull) * problem.weight[:, None])[point, tube] * reach[:, point]
    compliance = np.abs(problem.factor @ problem.factor.T)
    squares = np.einsum("ma,ab,mb->m", weights, compliance, weights)
    if equilibrium.load is not None:  # without one w is 0, whatever rubs
        squares += ((reach * problem.weight * loaded.softness) ** 2).sum(1)
    return np.asarray(np.sqrt(squares))

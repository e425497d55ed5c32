"""Bound on the displacement of an arm by any tip force up to a size, for every shape and direction.

Where the certificate mu under forces of at most F is positive, the potential energy of every such force is convex, and
more: with T the elastic form of `certificate` in rotations and bending, whose second variation is at least mu T
everywhere, the equilibrium x_F under a force and the one without, x_0, are apart by D = x_F - x_0 with

    mu T(D) <= F . dp_L(D) <= F g(L),    |p_F(s) - p_0(s)| <= g(s) = int_0^s phi,    phi' = sum A_i |y_i| + |r|,

since the gradient of the potential energy vanishes at x_F and is minus that of the work at x_0, and tangents turn by no
more than curvatures differ, at most A_i |y_i| by tube i and |r| by bending. g(s) is at most kappa(s) T(D)^(1/2) with

    kappa(s)^2 = int_0^s (s - x)^2 / K dx + sum_i (|beta_i| m_i(0)^2 + int_0^s m_i^2 dx) / kt_i,
    m_i(x) = int_x^s (s - t) A_i dt,

so that the arm moves by at most F kappa(L) kappa(s) / mu.

Under a dead load whose force on every cross-section is at most G, a further tip force of at most F makes it at most
F + G. With mu the certificate under forces of at most F + G, all of this holds with x_0 the equilibrium under the load
and x_F that with the further force: the work that differs is that of the further force alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..errors import InputError, finite_array, triple
from ..files.field_metadata import unit
from ..robots.load import ZERO, Load, Stretch, masses
from ..robots.robot import Robot, shifts
from ..typing import Array
from .certificate import ArmSections, arm_sections, snap_free_certificate

GAUSS = np.polynomial.legendre.leggauss(3)
"""Exact for the polynomials of degree 4 that are integrated on every section."""

BOX = 2e-3
"""Length (m) of the boxes of translations that cover a path: longer boxes give a weaker bound."""

MAX_BOXES = 16
"""Maximum number of boxes; on longer paths boxes are longer."""


@typed
def deflection_bound(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    max_force: float,
    arc_length: ArrayLike | None = None,
) -> Array:
    """(S,) upper bounds on the displacement of points of the arm, m, by any dead tip force up to `max_force`.

    For all rotations, relative to the unloaded robot. Infinite where the certificate under that force is not positive.

    Args:
        translations: (n,) m; default home.
        max_force: N.
        arc_length: (S,) m from the plate; by default the tip alone.

    Raises:
        InputError: as `snap_free_certificate` under a force; a point that is not on the arm.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/crl_ctr.yaml")
        >>> bool(tubeopt.deflection_bound(robot, [-0.02, 0, 0], max_force=0.001)[0] < 0.3e-3)
        True
    """
    shift = shifts(robot, translations)
    certificate = snap_free_certificate(robot, shift, max_force=max_force)
    length = robot.assembly(shift).total_length
    single = arc_length is not None and np.ndim(np.asarray(arc_length, dtype=object)) == 0
    inputs: Any = [length] if arc_length is None else [arc_length] if single else arc_length
    points = finite_array("arc_length", inputs, 1)
    if not np.isfinite(points).all() or points.min(initial=0.0) < 0 or points.max(initial=0.0) > length * (1 + 1e-12):
        raise InputError(f"arc_length is {points.tolist()} m; points must lie on the arm, between 0 and {length:g} m")
    return _moved(arm_sections(robot, shift), certificate, max_force, points)


def _moved(bundle: ArmSections, margin: float, force: float, points: Array) -> Array:
    """(S,) bounds F kappa(L) kappa(s) / mu on the deflection of points at s, m; largest at the tip."""
    if not force or not bundle.total_length:
        return np.zeros(len(points))
    if margin <= 0:
        return np.full(len(points), np.inf)
    return force * _kappa(bundle, bundle.total_length) * np.array([_kappa(bundle, s) for s in points]) / margin


def _kappa(bundle: ArmSections, s: float) -> float:
    """Quantity kappa(s) in the bound on the deflection at s, m / sqrt(J)."""
    slope = bundle.natural_moment / bundle.stiffness[:, None]
    section_start = np.minimum(bundle.start, s)
    section_end = np.minimum(bundle.start + bundle.length, s)
    # From s to the plate: m(a) = m(b) + A int_a^b (s - t) dt on a section [a, b].
    m = np.zeros(len(bundle.torsional))
    total = 0.0
    for k in reversed(range(len(section_start))):
        a, b = section_start[k], section_end[k]
        x = (a + b) / 2 + (b - a) / 2 * GAUSS[0]
        m_x = m + slope[k] * (((s - x) ** 2 - (s - b) ** 2) / 2)[:, None]
        total += (b - a) / 2 * float(GAUSS[1] @ ((s - x) ** 2 / bundle.stiffness[k] + m_x**2 @ (1 / bundle.torsional)))
        m = m + slope[k] * ((s - a) ** 2 - (s - b) ** 2) / 2
    return float(np.sqrt(total + bundle.transmission @ (m**2 / bundle.torsional)))


@dataclass(frozen=True)
class ForceBound(Displayed):
    """Bounds for all rotations and all dead tip forces up to a size, on a path of translations."""

    max_force: Annotated[
        float, unit("mN"), "largest force on the tip, in any direction, that margin and clearance include"
    ]
    margin: float
    """Lower bound on the margin; above 0 there is one equilibrium for every force, and no snap or buckling."""
    deflection: Annotated[float, unit("mm"), "bound on the displacement of the arm by such a force"]
    """Upper bound for every point of the arm; infinite where the margin is not above 0."""


def under_any_force(robot: Robot, translations: ArrayLike, max_force: float, load: Load | None = None) -> ForceBound:
    """Bounds for all tip forces up to `max_force` N added to a dead load, on a path of translations (T, n), m.

    The path is straight between its rows. It is covered by boxes of translations; each has one bound.

    Raises:
        InputError: as `snap_free_certificate` under a force, and `max_section_force`.
    """
    path = np.atleast_2d(np.asarray(translations, dtype=float))
    total_force = max_force + (0.0 if load is None else max_section_force(robot, path, load))
    first, bounds = snap_free_certificate(robot, path[0], max_force=total_force), []
    for near, far in _boxes(path):
        bundle, margin = arm_sections(robot, near, far), first
        if not np.array_equal(near, far):
            margin = 1 - bundle.softening(total_force, pairs=True) if bundle.total_length else 1.0
        tip = np.array([bundle.total_length])
        bounds.append((margin, float(_moved(bundle, margin, max_force, tip)[0])))
    margins, deflections = np.array(bounds).T
    return ForceBound(max_force, float(margins.min()), float(deflections.max()))


def _boxes(path: Array) -> list[tuple[Array, Array]]:
    """Lower and upper corners (n,) of boxes of translations that cover a path (T, n); a path at rest
    gives one point.
    """
    if (path == path[0]).all():
        return [(path[0], path[0])]
    along = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).max(1))])
    edges = np.linspace(0, along[-1], min(MAX_BOXES, math.ceil(along[-1] / BOX)) + 1)
    corners = np.stack([np.interp(edges, along, column) for column in path.T], axis=1)
    contents = [
        np.concatenate([corners[k : k + 2], path[(along >= a) & (along <= b)]])
        for k, (a, b) in enumerate(pairwise(edges))
    ]
    return [(rows.min(0), rows.max(0)) for rows in contents]


def max_section_force(robot: Robot, path: Array, load: Load) -> float:
    """Upper bound on the force on any cross-section under a dead load, N, on a path of translations (T, n).

    Raises:
        InputError: a load with a moment, a follower load, or a distributed load that is a function, which samples
            cannot bound.
    """
    load.require_energy("nothing bounds the margin under further forces")
    if callable(load.distributed):
        raise InputError(
            "distributed is a function; with max_force it must be a force (3,) or "
            "stretches, because samples of a function are no bound"
        )
    ends = np.maximum(robot.assembly(path.max(0)).end, 0.0)
    length, distributed = float(ends.max()), load.distributed or ZERO
    forces = [load.force, *(point.force for point in load.points)]
    for part in distributed:
        if isinstance(part, Stretch):
            forces.append(triple("force", np.multiply(max(0.0, min(part.end, length) - part.start), part.force)))
    uniform = 0.0 if isinstance(distributed[0], Stretch) else length * float(np.linalg.norm(distributed))
    weight = np.linalg.norm(load.gravity or ZERO) * masses(robot.tubes, load)
    return float(np.linalg.norm(forces, axis=1).sum() + weight @ ends) + uniform

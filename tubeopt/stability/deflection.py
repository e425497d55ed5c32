"""How far any force on the tip can move a robot that no such force can snap: a bound for every shape and direction.

Where the certificate mu under forces of at most F is positive, the potential energy of every such force is convex, and
more: with T the elastic form of `loaded_certificate` in rotations and bending, whose second variation is at least mu T
everywhere, the equilibrium x_F under a force and the one without, x_0, are apart by D = x_F - x_0 with

    mu T(D) <= F . dp_L(D) <= F g(L),    |p_F(s) - p_0(s)| <= g(s) = int_0^s phi,    phi' = sum A_i |y_i| + |r|,

since the gradient of the potential energy vanishes at x_F and is minus that of the work at x_0, and tangents turn by no
more than curvatures differ, at most A_i |y_i| by tube i and |r| by bending. g(s) is at most kappa(s) T(D)^(1/2) with

    kappa(s)^2 = int_0^s (s - x)^2 / K dx + sum_i (|beta_i| m_i(0)^2 + int_0^s m_i^2 dx) / kt_i,
    m_i(x) = int_x^s (s - t) A_i dt,

so that the arm moves by at most F kappa(L) kappa(s) / mu.

A robot that bears a dead load already, of which no cross-section bears more than G, bears at most F + G with a further
force of at most F on the tip. With mu the certificate under forces of at most F + G, all of this holds with x_0 the
equilibrium under the load, x_F that with the further force: the work that differs is that of the further force alone.
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
from .certificate import Bundle, bundle_of, snap_free_certificate

GAUSS = np.polynomial.legendre.leggauss(3)
"""Exact for the polynomials of degree 4 that are integrated on every section."""

BOX, MOST_BOXES = 2e-3, 16
"""Length, m, of the boxes in which a path of translations is taken, and most of them."""


@typed
def deflection_bound(
    robot: Robot,
    translations: ArrayLike | None = None,
    *,
    max_force: float,
    arc_length: ArrayLike | None = None,
) -> Array:
    """(S,) how far points of the arm at most move, m, whatever pushes on the tip with up to `max_force`.

    For all rotations and for all forces that keep their direction, in any direction, put on the unloaded robot;
    infinite where the certificate under that force is not positive.

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
    places = finite_array("arc_length", inputs, 1)
    if not np.isfinite(places).all() or places.min(initial=0.0) < 0 or places.max(initial=0.0) > length * (1 + 1e-12):
        raise InputError(f"arc_length is {places.tolist()} m; points must lie on the arm, between 0 and {length:g} m")
    return _moved(bundle_of(robot, shift), certificate, max_force, places)


def _moved(bundle: Bundle, margin: float, force: float, places: Array) -> Array:
    """(S,) bounds of the deflection of points, m; the tip's is the largest."""
    if not force or not bundle.total_length:
        return np.zeros(len(places))
    if margin <= 0:
        return np.full(len(places), np.inf)
    return force * _reach(bundle, bundle.total_length) * np.array([_reach(bundle, s) for s in places]) / margin


def _reach(bundle: Bundle, s: float) -> float:
    """kappa(s), m / sqrt(J)."""
    slope = bundle.pull / bundle.stiffness[:, None]
    # Up to s, sections from the tip to the plate; m grows by what each adds.
    begin = np.minimum(bundle.start, s)
    end = np.minimum(bundle.start + bundle.length, s)
    ahead = np.zeros(len(bundle.torsional))
    total = 0.0
    for k in reversed(range(len(begin))):
        a, b = begin[k], end[k]
        x = (a + b) / 2 + (b - a) / 2 * GAUSS[0]
        inside = ((s - x) ** 2 - (s - b) ** 2) / 2
        moment = ahead + slope[k] * inside[:, None]
        each = (s - x) ** 2 / bundle.stiffness[k] + moment**2 @ (1 / bundle.torsional)
        total += (b - a) / 2 * float(GAUSS[1] @ each)
        ahead = ahead + slope[k] * ((s - a) ** 2 - (s - b) ** 2) / 2
    return float(np.sqrt(total + bundle.transmission @ (ahead**2 / bundle.torsional)))


@dataclass(frozen=True)
class ForceBound(Displayed):
    """What holds for all rotations, on a path of translations, and for all tip forces up to a size that keep their
    direction, beside a load where there is one."""

    max_force: Annotated[
        float, unit("mN"), "largest force on the tip, in any direction, that margin and clearance include"
    ]
    margin: float
    """No stable equilibrium has less; above 0 there is one for every force, and nothing snaps or buckles."""
    deflection: Annotated[float, unit("mm"), "bound on the displacement of the arm by such a force"]
    """Of any point; infinite where the margin is not above 0."""


def under_any_force(robot: Robot, translations: ArrayLike, max_force: float, load: Load | None = None) -> ForceBound:
    """What holds on a path of translations (T, n), straight in between, whatever pushes on the tip with up to
    `max_force`, beside a dead load.
    The path is taken in boxes of translations, for each of which one bound holds.

    Raises:
        InputError: as `snap_free_certificate` under a force, and `most_borne`.
    """
    path = np.atleast_2d(np.asarray(translations, dtype=float))
    whole = max_force + (0.0 if load is None else most_borne(robot, path, load))
    first, result = snap_free_certificate(robot, path[0], max_force=whole), []
    for near, far in _boxes(path):
        bundle, margin = bundle_of(robot, near, far), first
        if not np.array_equal(near, far):
            margin = 1 - bundle.softened(whole, pairs=True) if bundle.total_length else 1.0
        tip = np.array([bundle.total_length])
        result.append((margin, float(_moved(bundle, margin, max_force, tip)[0])))
    least, most = np.array(result).T
    return ForceBound(max_force, float(least.min()), float(most.max()))


def _boxes(path: Array) -> list[tuple[Array, Array]]:
    """Least and greatest translations (n,) in each box of a path (T, n); of one that rests one box without size."""
    if (path == path[0]).all():
        return [(path[0], path[0])]
    along = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(path, axis=0)).max(1))])
    edges = np.linspace(0, along[-1], min(MOST_BOXES, math.ceil(along[-1] / BOX)) + 1)
    corners = np.stack([np.interp(edges, along, column) for column in path.T], axis=1)
    each = [
        np.concatenate([corners[k : k + 2], path[(along >= a) & (along <= b)]])
        for k, (a, b) in enumerate(pairwise(edges))
    ]
    return [(inside.min(0), inside.max(0)) for inside in each]


def most_borne(robot: Robot, path: Array, load: Load) -> float:
    """Bound of the force on any cross-section under a dead load, N, with translations on a path (T, n).

    Raises:
        InputError: a load with a moment, one that turns with the tip, or one per length that is a function: no number
            of its values bounds it.
    """
    load.require_energy("nothing bounds the margin under further forces")
    if callable(load.distributed):
        raise InputError(
            "distributed is a function; with max_force it must be a force (3,) or "
            "stretches, because samples of a function are no bound"
        )
    ends = np.maximum(robot.assembly(path.max(0)).end, 0.0)
    length, along = float(ends.max()), load.distributed or ZERO
    pushed = [load.force, *(point.force for point in load.points)]
    for part in along:
        if isinstance(part, Stretch):
            pushed.append(triple("force", np.multiply(max(0.0, min(part.end, length) - part.start), part.force)))
    spread = 0.0 if isinstance(along[0], Stretch) else length * float(np.linalg.norm(along))
    weight = np.linalg.norm(load.gravity or ZERO) * masses(robot.tubes, load)
    return float(np.linalg.norm(pushed, axis=1).sum() + weight @ ends) + spread

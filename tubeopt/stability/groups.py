"""Tubes that act on one another, apart from the others: what makes a search over all tip angles a search over few.

Two tubes act on each other where both are curved. A tube that is straight in a section only shares the stiffness of
the section, and its torque t is constant there: on the centreline it does not notice the others at all. Off the
centreline they change its length, theta' = g t / kt, and so the transmission to its own curved part,

    alpha_i = theta_i - t_i (|beta_i| + int g_i ds) / kt_i,

with the integral over everything between the plate and where its group begins. A tube is curved to its end, so that
a group lies beyond all those that it passes through: the equations are block triangular, from the base to the tip.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import scipy

from ..block.transcription.green import reach
from ..block.transcription.reduced import ReducedProblem
from ..robots.assembly import Assembly
from ..typing import Index
from .shooting import Bundle, gain_of, sections_of


@dataclass(frozen=True, eq=False)
class Group:
    """Tubes that act on one another, and what is integrated to shoot them.

    Attributes:
        tubes: (k,) which of the n tubes.
        bundle: these, and behind them a straight tube for each place that has none of them. Each place has the
            stiffness of all tubes there. The transmissions are those of the robot on the centreline.
        seat: (n,) tube of the bundle at whose place each tube of the robot lies.
    """

    tubes: Index
    bundle: Bundle
    seat: Index


@lru_cache(maxsize=32)
def groups_of(problem: ReducedProblem) -> list[Group]:
    """Groups of tubes, base to tip.

    On the centreline a single tube is none: its torsion is 0. Off it a single curved one still bends the others.
    """
    assembly = problem.assembly
    curved = assembly.curved
    together = (curved[:, :, None] & curved[:, None, :]).any(0)
    label = scipy.sparse.csgraph.connected_components(together, directed=False)[1]
    groups = [np.flatnonzero(label == k) for k in range(label.max(initial=-1) + 1)]
    least = 1 if assembly.eccentric else 2
    sections = [np.flatnonzero(curved[:, tubes].any(1)) for tubes in groups]
    order = sorted((where[0], k) for k, where in enumerate(sections) if len(where) and len(groups[k]) >= least)
    return [_group(problem, groups[k], sections[k]) for _, k in order]


def _group(problem: ReducedProblem, tubes: Index, sections: Index) -> Group:
    assembly, mesh = problem.assembly, problem.mesh
    place = _places(assembly)
    others = [int(np.argmax(place == p)) for p in np.setdiff1d(place, place[tubes])]
    members = np.concatenate([tubes, np.array(others, dtype=np.intp)])
    seat = np.array([int(np.argmax(place[members] == p)) for p in place])
    # Between two curved pieces of a tube a straight one only hands on the torque, but that it does.
    pieces = np.flatnonzero((mesh.section >= sections[0]) & (mesh.section <= sections[-1]))
    every = [part[pieces] for part in sections_of(problem)]
    torsion, stiffness, moment, *phase = (part[..., members] for part in every)
    stiffness[..., len(tubes) :] = moment[..., len(tubes) :] = 0.0
    for i in np.setdiff1d(np.arange(assembly.n_tubes), tubes):
        stiffness[..., seat[i]] += every[1][..., i]
    bundle = Bundle(
        length=mesh.length[pieces],
        bent=mesh.collocated[pieces],
        gain=gain_of(problem)[np.ix_(pieces, members)],
        sections=(torsion, stiffness, moment, *phase),
        transmission=reach(mesh, problem.here)[pieces[0], members],
        place=tuple(part[members] for part in assembly.place),
    )
    return Group(tubes, bundle, seat)


def _places(assembly: Assembly) -> Index:
    """(n,) number of the place beside the centreline at which each tube lies."""
    spot = assembly.offset * np.exp(1j * assembly.offset_angle)
    rounded = np.round(np.stack([spot.real, spot.imag], axis=1), 12)
    return np.asarray(np.unique(rounded + 0.0, axis=0, return_inverse=True)[1]).ravel()

"""Tubes off the centreline that are curved together: what their margin is computed from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...robots.assembly import Assembly
from ...typing import Array, Index


@dataclass(frozen=True, eq=False)
class Block:
    """k tubes off the centreline that are curved together, at the p points where they are.

    tubes (k,), points (p,); compliance (k, p, p): Gamma of each, weights included; up_to (p, N), beyond (N, p):
    integrals from the base to these points, and over them from every point to the tip.
    """

    tubes: Index
    points: Index
    compliance: Array
    up_to: Array
    beyond: Array


def _curved_groups(assembly: Assembly) -> list[Index]:
    """Tubes that are curved together, in groups that do not act on one another but from base to tip."""
    groups: list[set[int]] = []
    for row in assembly.curved:
        mine = set(np.flatnonzero(row).tolist())
        if mine:
            groups = [g for g in groups if not g & mine] + [mine.union(*(g for g in groups if g & mine))]
    acts = [_present(assembly, group) for group in groups]
    for k, group in enumerate(groups):
        if any(acts[k] & other and acts[j] & group for j, other in enumerate(groups) if j != k):
            return [np.array(sorted(set().union(*groups)), dtype=np.intp)]
    return [np.array(sorted(group), dtype=np.intp) for group in groups]


def _present(assembly: Assembly, group: set[int]) -> set[int]:
    """Tubes that run where some of a group are curved."""
    there = assembly.curved[:, sorted(group)].any(1)
    return set(np.flatnonzero(assembly.present[there].any(0)).tolist())


def blocks_of(assembly: Assembly, green: Array, section: Index, integrals: tuple[Array, ...]) -> list[Block]:
    """Blocks of an assembly whose N points lie on sections `section`, with min(s, r) (N, N), and P, W, weights."""
    up_to, beyond, weight = integrals
    blocks = []
    for tubes in _curved_groups(assembly):
        points = np.flatnonzero(assembly.curved[section][:, tubes].any(1))
        chosen = green[np.ix_(points, points)]
        length = assembly.transmission[tubes][:, None, None] + chosen
        compliance = length * weight[points] / assembly.torsional_stiffness[tubes][:, None, None]
        blocks.append(Block(tubes, points, compliance, up_to[points], beyond[:, points]))
    return blocks

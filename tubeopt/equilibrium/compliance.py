"""What a small wrench does to an equilibrium, and what its load puts on the plate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..block.transcription.loaded import base_wrench, compliance
from ..block.transcription.loaded_arm import compliance_along
from ..errors import InputError, finite
from ..robots.load import Load, PointLoad
from ..robots.order import SAME_END, twisted_tube
from ..typing import Array
from .answer import point_of
from .loaded import Loaded, LoadedPoint
from .result import Equilibrium


def compliance_of(equilibrium: Equilibrium) -> Array:
    """(6, 6) change of the tip by a small dead wrench there; see `Equilibrium.compliance`."""
    point = point_of(equilibrium, Load())
    return compliance(point.member.problem, point.state)


def compliance_at(equilibrium: Equilibrium, arc_length: float, tube: int | None) -> Array:
    """(6, 6) change of a place of the arm by a small dead wrench there; see `Equilibrium.compliance_at`."""
    if equilibrium.load is not None and not equilibrium.load.has_energy:
        raise InputError("the load has a moment or turns with the tip; compliance is then available at the tip only")
    point = point_of(equilibrium, Load())
    assembly, length = point.member.problem.torsion.assembly, float(equilibrium.arc_length[-1])
    if not 0 <= finite("arc_length", arc_length) <= length * (1 + 1e-12):
        raise InputError(f"arc_length is {arc_length:g} m; it must be on the arm, between 0 and {length:g} m")
    here = np.flatnonzero(assembly.end >= arc_length - SAME_END)
    chosen = int(twisted_tube(assembly.end, arc_length)) if tube is None else tube
    if chosen not in here:
        raise InputError(f"tube is {tube}; tubes {', '.join(map(str, here))} are at {arc_length:g} m")
    # Where a wrench acts the curvature jumps: elements end there.
    load = equilibrium.load or Load()
    cut = replace(load, points=(*load.points, PointLoad(min(arc_length, length))))
    there = Loaded.of(equilibrium.robot, point.member.rotations, point.member.translations, cut)
    failure = "the equilibrium is a fold (margin 0), where the compliance is infinite"
    found: LoadedPoint = point.onto(there, failure)
    return compliance_along(there.problem, found.state, min(arc_length, length), chosen)


def base_wrench_of(equilibrium: Equilibrium) -> Array:
    """(6,) what the load puts on the plate; see `Equilibrium.base_wrench`."""
    if equilibrium.load is None:
        return np.zeros(6)
    point = point_of(equilibrium)
    return base_wrench(point.member.problem, point.state)

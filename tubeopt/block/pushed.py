"""A load on the arm of a block: what of it a program can hold, and the bending that it begins with."""

from __future__ import annotations

import numpy as np
import scipy

from ..errors import InputError
from ..robots.assembly import Assembly
from ..robots.load import Load, masses
from ..robots.robot import is_general
from ..typing import Array
from .near import Near
from .transcription.buffered import section_function
from .transcription.burdened import Push


def push_of(near: Near, bundle: Assembly, load: Load | None) -> Push | None:
    """The load on a block near an equilibrium, None where nothing pushes."""
    if load is None:
        return None
    if not isinstance(load, Load):
        raise InputError(f"load is {load!r}; it must be a Load")
    if bundle.eccentric:
        raise InputError("load is given for tubes beside one another; only concentric robots can be loaded")
    along = (0.0, 0.0, 0.0) if load.distributed is None else load.distributed
    if load.points or callable(along) or any(not isinstance(part, float) for part in along):
        raise InputError(
            "load has points, stretches or a function along the arm; a block bears force and moment at the tip, "
            "weight, and a constant force per length"
        )
    gravity = np.array(load.gravity or (0.0, 0.0, 0.0))
    return Push(
        force=np.array(load.force),
        moment=np.array(load.moment),
        turning=load.frame == "tip",
        along=np.array(along, dtype=float),
        weight=masses(near.robot.tubes, load)[:, None] * gravity,
        tip_tube=int(np.argmax(bundle.end)),
        typical=float(sum(tube.bending_stiffness for tube in near.robot.tubes)),
    )


def torsion_under_load(near: Near, start: Array, inside: Array) -> tuple[Array, Array, Array]:
    """theta, w (n, P) at arc lengths (P,) and theta (n, N) at arc lengths (N,) of an equilibrium, off its points."""
    s = near.arc_length
    theta, w = near.rotation - near.robot.assembly(near.translations).wound(s).T, near.torsion
    if is_general(near.robot):
        # Without the natural twist, which ends where a tube does, and as it would be at the stiffness of the tube.
        w = np.gradient(theta, s, axis=1)
    between = scipy.interpolate.CubicHermiteSpline(s, theta, w, axis=1)(np.clip(inside, s[0], s[-1]))
    at_start = [np.array([np.interp(start, s, row) for row in table]) for table in (theta, w)]
    return at_start[0], at_start[1], between


def bending_of(near: Near, start: Array, inside: Array) -> tuple[Array, Array]:
    """Bending moments (2, P) and (2, N), N m, that a load makes, at arc lengths (P,) and (N,)."""
    if near.load is None:
        return np.zeros((2, len(start))), np.zeros((2, len(inside)))
    assembly = near.robot.assembly(near.translations)
    if assembly.general:
        here = assembly.cross_sections(near.point, near.point)
        kb, moment = here.stiffness, here.moment
        theta = near.point_rotation - assembly.wound(near.point) + here.phase
    else:
        section = np.searchsorted(assembly.start, near.point, side="right") - 1
        kb, theta = assembly.bending_stiffness * assembly.present[section], near.point_rotation
        moment = kb * assembly.curvature * assembly.curved[section]
    unloaded = section_function("curvature", len(kb), kb.shape[1], False)(theta, kb, moment)[0]
    known = (near.point_curvature - unloaded) * kb.sum(1)[:, None]
    return tuple(np.array([np.interp(s, near.point, row) for row in known.T]) for s in (start, inside))  # type: ignore[return-value]

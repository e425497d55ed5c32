"""Steps of the shape with their derivatives, for problems in which the shape must meet demands."""

from __future__ import annotations

import threading
from functools import lru_cache

import casadi as ca

from ..mechanics.shape import magnus_step
from .buffered import Buffered


@lru_cache(maxsize=1)
def _step_function() -> ca.Function:
    """(u (6), h) -> pose after one Magnus step from the identity (12), its derivative (12, 7) with respect to both."""
    u, h = ca.SX.sym("u", 6), ca.SX.sym("h")
    rotation, position = magnus_step(ca.DM.eye(3), ca.DM.zeros(3), ca.reshape(u, 2, 3), h)
    pose = ca.vertcat(ca.vec(rotation), position)
    slope = ca.densify(ca.jacobian(pose, ca.vertcat(u, h)))
    return ca.Function("step", [u, h], [ca.densify(pose), slope], {"cse": True})


@lru_cache(maxsize=64)
def _mapped(count: int, thread: int) -> Buffered:
    return Buffered(_step_function().map(count))


def shape_steps(count: int) -> Buffered:
    """`count` Magnus steps: (u (count, 6), h (count, 1)) -> poses (count, 12), slopes (7 count, 12), of this thread.

    u are the curvatures at the three GAUSS_POINTS of a step, x before y; poses are R by columns, then p.
    """
    return _mapped(count, threading.get_ident())

"""A load and what it does to a robot, as a person reads it and as JSON."""

from __future__ import annotations

import numpy as np

from ..equilibrium.result import Equilibrium
from ..files.units import TO_MILLI, TO_MM
from ..robots.load import Load
from .formatting import row
from .quantities import Quantity, within


def load_in_words(load: Load) -> str:
    """What pushes, in a line."""
    at_tip = []
    if any(load.force):
        at_tip.append(f"{row(np.array(load.force) * TO_MILLI, '.6g')} mN at the tip")
    if any(load.moment):
        at_tip.append(f"{row(np.array(load.moment) * TO_MILLI, '.6g')} mN m at the tip")
    parts = [*at_tip, *(["turning with the tip"] if load.frame == "tip" and at_tip else [])]
    for part in load.points:
        for value, unit in ((part.force, "mN"), (part.moment, "mN m")):
            if any(value):
                parts.append(f"{row(np.array(value) * TO_MILLI, '.6g')} {unit} at {part.at * TO_MM:.6g} mm")
    parts += ["a load along the arm"] if load.distributed is not None else []
    parts += [f"gravity {row(load.gravity, '.6g')} m/s^2"] if load.gravity is not None else []
    return "; ".join(parts) or "none"


def _softness(e: Equilibrium) -> str:
    # m/N are mm/mN.
    softness = np.linalg.svd(e.compliance[:3, :3], compute_uv=False)
    return f"by {softness[-1]:.4g} to {softness[0]:.4g} mm/mN"


def _on_the_plate(e: Equilibrium) -> str:
    wrench = e.base_wrench * TO_MILLI
    return f"{row(wrench[:3], '.4f')} mN, {row(wrench[3:], '.4f')} mN m"


LOADED: tuple[Quantity[Equilibrium], ...] = within(
    (
        Quantity[Equilibrium]("load", "what pushes, in words; absent without load",
                              lambda e: load_in_words(e.load or Load()), label="load", words="{load}", optional=True),
        Quantity("potential_mJ", "elastic energy less the work of the load", optional=True),
        Quantity("compliance",
                 "6 x 6 compliance: translation (m) and rotation (rad) of the tip per force (N) and moment (N m) there",
                 label="a force at the tip moves it", words=_softness, optional=True),
        Quantity("base_force_mN", "force of the load on the plate", lambda e: e.base_wrench[:3],
                 label="on the plate", words=_on_the_plate, optional=True),
        Quantity("base_moment_mN_m", "moment of the load on the plate", lambda e: e.base_wrench[3:], optional=True),
    ),
    lambda e: None if e.load is None else e,
)  # fmt: skip
"""What a load does to an equilibrium; nothing without one."""

"""A load and what it does to a robot, as a person reads it and as JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..equilibrium.result import Equilibrium
from ..robots.load import Load
from .words import MILLI, row


def load_in_words(load: Load) -> str:
    """What pushes, in a line."""
    where = "turning with the tip" if load.frame == "tip" else ""
    parts = []
    if any(load.force):
        parts.append(f"{row(np.array(load.force) * MILLI, '.6g')} mN at the tip")
    if any(load.moment):
        parts.append(f"{row(np.array(load.moment) * MILLI, '.6g')} mN m at the tip")
    parts += [where] if where and parts else []
    parts += [f"{row(np.array(p.force) * MILLI, '.6g')} mN at {p.at * MILLI:.6g} mm" for p in load.points]
    parts += ["a load along the arm"] if load.distributed is not None else []
    parts += [f"gravity {row(load.gravity, '.6g')} m/s^2"] if load.gravity is not None else []
    return "; ".join(parts) or "none"


def load_rows(e: Equilibrium) -> list[tuple[str, str]]:
    """Rows of a table on a load, none without one."""
    if e.load is None:
        return []
    stiffest, *_, softest = sorted(np.linalg.svd(e.compliance[:3, :3], compute_uv=False))
    wrench = e.base_wrench * MILLI
    return [
        ("load", load_in_words(e.load)),
        ("a force at the tip moves it", f"by {stiffest:.4g} to {softest:.4g} mm/mN"),
        ("on the plate", f"{row(wrench[:3], '.4f')} mN, {row(wrench[3:], '.4f')} mN m"),
    ]


def load_record(e: Equilibrium) -> dict[str, Any] | None:
    """A load and what it does as JSON."""
    if e.load is None:
        return None
    return {
        "load": load_in_words(e.load),
        "potential_mJ": e.potential * MILLI if e.load.has_energy else None,
        "compliance": e.compliance.tolist(),
        "base_wrench_mN_mN_m": (e.base_wrench * MILLI).tolist(),
    }

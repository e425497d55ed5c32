"""The report on every kind of answer: importing this module registers them all."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from . import (
    certify_report,
    design_report,
    equilibrium_report,
    fabrication_report,
    heat_report,
    inverse_report,
    map_report,
    mold_report,
    plan_report,
    robot_report,
    snap_report,
    sweep_report,
    validation_report,
    workspace_report,
)
from .report import report

MODULES = (
    equilibrium_report,
    inverse_report,
    snap_report,
    certify_report,
    map_report,
    validation_report,
    workspace_report,
    design_report,
    plan_report,
    mold_report,
    heat_report,
    fabrication_report,
    robot_report,
    sweep_report,
)
"""Where what is said about answers is written down."""


def to_dict(answer: object) -> Mapping[str, Any]:
    """What `--json` says about an answer of any kind: plain numbers, text, lists and mappings with units in the keys.

    Raises:
        TypeError: nothing is said about such an object.
    """
    return report(answer).record()


__all__ = ["MODULES", "report", "to_dict"]

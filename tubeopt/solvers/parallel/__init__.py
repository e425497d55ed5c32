"""Many independent computations on the cores of this machine, or on a cluster."""

from __future__ import annotations

from .common import common_data
from .executors import Failure, Outcome, each, executor

__all__ = ["Failure", "Outcome", "common_data", "each", "executor"]

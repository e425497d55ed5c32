"""Stability: every equilibrium, the branch that is followed, the exact snap, and the certificate against it."""

from .equilibria import find_equilibria
from .following import Path, follow
from .snapping import Snap, find_snap

__all__ = ["Path", "Snap", "find_equilibria", "find_snap", "follow"]

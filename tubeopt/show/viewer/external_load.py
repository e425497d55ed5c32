"""A load on the robot under somebody's hands: a force on the tip, gravity, and how much of them the robot bears."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...constants import GRAVITY
from ...equilibrium.kinematics import forward_kinematics
from ...equilibrium.result import Equilibrium
from ...errors import SolveError
from ...files.units import TO_MILLI, TO_MM
from ...robots.load import Load
from ...stability.following import push
from ...stability.load_limit import LoadLimit, find_load_limit
from .session import Session, moved_to

ARROW = 5.0
"""Length of the arrow of a force, over how far it moves the tip where that is softest, to first order."""

UP_TO = 10.0
"""Largest factor on a load that is looked at for its limit."""

DIRECTIONS: dict[str, tuple[float, float, float] | None] = {
    "none": None,
    "along +x": (GRAVITY, 0.0, 0.0),
    "along -x": (-GRAVITY, 0.0, 0.0),
    "along +y": (0.0, GRAVITY, 0.0),
    "along -y": (0.0, -GRAVITY, 0.0),
    "along +z": (0.0, 0.0, GRAVITY),
    "along -z": (0.0, 0.0, -GRAVITY),
}
"""Choices of gravity, m/s^2."""


def push_on(session: Session, load: Load) -> Session:
    """The session after its load has slowly become another one, with the snaps on the way.

    Raises:
        InputError: a load that the robot cannot bear: tubes of unknown weight, or beside one another.
        SolveError: the branch was lost; the robot stays as it was.
    """
    here = session.equilibrium
    if (here.load or Load()) == load:
        return session
    path = push(here, load)
    there = path.equilibria[-1]
    return moved_to(session, bare(there) if load == Load() else there, path.snaps)


def bare(equilibrium: Equilibrium) -> Equilibrium:
    """An equilibrium under no force as one without load."""
    guess = replace(equilibrium, load=None)
    return forward_kinematics(equilibrium.robot, equilibrium.rotations, equilibrium.translations, start=guess)


def without_load(equilibrium: Equilibrium) -> Equilibrium | None:
    """Where the robot goes when the load is taken off; None where it snaps on the way."""
    if equilibrium.load is None:
        return equilibrium
    path = push(equilibrium, Load())
    return None if path.snaps else bare(path.equilibria[-1])


def newtons_per_metre(equilibrium: Equilibrium) -> float:
    """Force on the tip that an arrow of one metre stands for."""
    softest = float(np.linalg.norm(equilibrium.compliance[:3, :3], 2))
    return 1 / (ARROW * softest)


def head_of(equilibrium: Equilibrium, scale: float) -> np.ndarray:
    """(3,) where the head of the arrow is, m."""
    force = np.zeros(3) if equilibrium.load is None else np.array(equilibrium.load.force)
    return np.asarray(equilibrium.tip_position + force / scale)


def bearing_of(equilibrium: Equilibrium) -> tuple[float, LoadLimit | None] | None:
    """How far the load of an equilibrium moves the tip, m, and where a multiple of it ends the branch, None where the
    robot bears UP_TO times as much; None where the equilibrium is not that into which an unloaded one grows.

    Raises:
        SolveError: the branch is lost without a fold or bifurcation close by.
    """
    load, rest = equilibrium.load, without_load(equilibrium)
    if load is None or rest is None:
        return None
    joints = equilibrium.rotations, equilibrium.translations
    limit = find_load_limit(equilibrium.robot, *joints, load, equilibrium=rest, up_to=UP_TO)
    return float(np.linalg.norm(equilibrium.tip_position - rest.tip_position)), limit


def bearing_words(equilibrium: Equilibrium) -> str:
    """The same in a sentence; empty without load."""
    load = equilibrium.load
    if load is None:
        return ""
    force = float(np.linalg.norm(load.force)) * TO_MILLI
    weight = " and weight" if load.gravity is not None else ""
    what = f"{force:.2f} mN{weight}"
    try:
        found = bearing_of(equilibrium)
    except SolveError as error:
        return f"{what}: {error}"
    if found is None:
        return f"{what}: taken off, the robot snaps"
    moved, limit = found
    bears = f"withstands more than {UP_TO:g} times as much"
    if limit is not None:
        end = "snaps" if limit.kind == "fold" else "buckles"
        bears = f"{end} at {limit.factor:.4f} times as much"
    return f"{what}: tip moved by {moved * TO_MM:.4f} mm, {bears}"

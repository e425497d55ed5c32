"""How hard ways between joint values are searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..errors import Settings


@dataclass(frozen=True)
class Steps(Settings):
    """How close points of a motion are that are checked, and what they leave for what lies between them.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `halvings`), another number that is not
            positive.
    """

    turn: float = 0.15
    """Largest change of a tip rotation, rad."""
    joint: float = 0.35
    """Of a joint rotation, rad."""
    shift: float = 0.02
    """Of a translation, as a share of the longest tube."""
    halvings: int = 4
    """At most, where little is to spare."""
    clearance_slope: float = 3e-4
    """Clearance, m, that must be to spare per distance from an end, in units of the joints' scales: at the end itself
    none, and before steps grow long, as much as anywhere."""
    margin_slope: float = 0.02
    """The same of the margin."""
    windows: int = 12
    """Stretches between points along an arm that are looked at once more."""
    window_points: int = 9
    """In each."""

    _none: ClassVar[tuple[str, ...]] = ("halvings",)


@dataclass(frozen=True)
class Detours(Settings):
    """Ways by translations at which the robot cannot snap; when their time is over, chance has its turn."""

    samples: int = 160
    """Translations among which such are searched for."""
    most: int = 24
    """Ways that are tried, the shortest first."""
    seconds: float = 6.0
    """At most, s."""
    share: float = 0.3
    """Of the time that is left, at most."""


@dataclass(frozen=True)
class Walls(Settings):
    """What keeps start and goal apart: sections between them that every way crosses."""

    seconds: float = 5.0
    """At most, s."""
    share: float = 0.15
    """Of the time that is left, at most."""
    levels: int = 9
    """Between start and goal, at which sections are looked at."""
    screened: int = 48
    """Random states by which a section is screened: most have one that is allowed."""
    states: int = 20_000
    """On a grid at most; larger sections are not decided."""
    doubt: float = 2e-3
    """Margin that states must lack to count as not allowed: more than the integration is off."""


@dataclass(frozen=True)
class Trees(Settings):
    """The search of RRT-Connect, by long motions and then by short ones."""

    motion: float = 1.2
    """Longest that is tried at once, in units of the joints' scales."""
    long_share: float = 0.5
    """Of the time that is left, for long motions; short ones have the rest."""
    reason_share: float = 0.3
    """The same where something stands against a way."""


@dataclass(frozen=True)
class Pockets(Settings):
    """Whether start or goal lie in a closed pocket."""

    share: float = 0.3
    """Of the time that long motions leave."""
    states: int = 60
    """From which a pocket counts as open."""
    apart: float = 0.02
    """Distance of states that are two, in units of the joints' scales."""
    motions: int = 1500
    """In a row that do not lead on, from which it counts as closed."""


@dataclass(frozen=True)
class PathSearch(Settings):
    """How hard a way between joint values is searched for."""

    steps: Steps = Steps()
    """How closely motions are checked."""
    detours: Detours = Detours()
    """How long ways by certified translations are tried."""
    walls: Walls = Walls()
    """How long, and how finely, one looks for what keeps start and goal apart."""
    trees: Trees = Trees()
    """How RRT-Connect searches."""
    pockets: Pockets = Pockets()
    """How long one looks whether an end is closed off."""


DEFAULT_WAY = PathSearch()

"""How hard ways between joint values are searched for: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..errors import Settings


@dataclass(frozen=True)
class Steps(Settings):
    """Spacing of the checked points of a motion, and reserves for the error between them.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `halvings`), another number that is not
            positive.
    """

    turn: float = 0.15
    """Largest change of a tip rotation, rad."""
    joint: float = 0.35
    """Largest step of a joint rotation, rad."""
    shift: float = 0.02
    """Largest step of a translation, as a fraction of the longest tube."""
    halvings: int = 4
    """Maximum number of bisections where the reserve is small."""
    clearance_slope: float = 3e-4
    """Required reserve of the clearance, m, per distance from an end in units of the joint scales, up to that of full
    steps. No reserve is needed at the end itself.
    """
    margin_slope: float = 0.02
    """Required reserve of the margin, per distance from an end."""
    windows: int = 12
    """Number of intervals along an arm that are checked with finer points."""
    window_points: int = 9
    """Number of finer points per interval."""

    _none: ClassVar[tuple[str, ...]] = ("halvings",)


@dataclass(frozen=True)
class Detours(Settings):
    """Settings of paths through translations that exclude snaps; random search follows."""

    samples: int = 160
    """Translations among which such are searched for."""
    most: int = 24
    """Maximum number of paths tried, shortest first."""
    seconds: float = 6.0
    """Maximum duration, s."""
    share: float = 0.3
    """Maximum fraction of the remaining time."""


@dataclass(frozen=True)
class Walls(Settings):
    """Settings of the search for obstructions: sections that every path between start and goal crosses."""

    seconds: float = 5.0
    """Maximum duration, s."""
    share: float = 0.15
    """Maximum fraction of the remaining time."""
    levels: int = 9
    """Number of checked sections between start and goal."""
    screened: int = 48
    """Number of random states that screen a section; most sections have an allowed one."""
    states: int = 20_000
    """Maximum number of grid states; larger sections are not decided."""
    doubt: float = 2e-3
    """Margin that states must lack to count as not allowed: more than the integration is off."""


@dataclass(frozen=True)
class Trees(Settings):
    """The search of RRT-Connect, by long motions and then by short ones."""

    motion: float = 1.2
    """Longest that is tried at once, in units of the joints' scales."""
    long_share: float = 0.5
    """Fraction of the remaining time for long motions; short ones get the rest."""
    reason_share: float = 0.3
    """Fraction of the remaining time for long motions if an obstruction is known."""


@dataclass(frozen=True)
class Pockets(Settings):
    """Settings of the test whether start or goal lie in a closed region."""

    share: float = 0.3
    """Fraction of the time that long motions leave."""
    states: int = 60
    """Number of states at which a region counts as open."""
    apart: float = 0.02
    """Distance of states that are two, in units of the joints' scales."""
    motions: int = 1500
    """Number of successive failed motions at which a region counts as closed."""


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

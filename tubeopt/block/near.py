"""What a block asks of the solved equilibrium that it begins from: it knows how one is used, not how one is found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, Self, TypeVar

from ..robots.load import Load
from ..robots.robot import Robot
from ..typing import Array
from .transcription.arm import ArmShape, CollocationPoints, Profile
from .transcription.reduced import ReducedProblem


class Near(Protocol):
    """A solved equilibrium; `tubeopt.Equilibrium` is one."""

    @property
    def robot(self) -> Robot:
        """Whose it is."""

    @property
    def rotations(self) -> Array:
        """(n,) rad."""

    @property
    def translations(self) -> Array:
        """(n,) m."""

    @property
    def tip_position(self) -> Array:
        """(3,) m."""

    @property
    def arm(self) -> ArmShape:
        """The whole arm."""

    @property
    def points(self) -> CollocationPoints:
        """Where it is known best."""

    @property
    def load(self) -> Load | None:
        """What pushes."""

    @property
    def margin(self) -> float:
        """Its stability margin."""

    def collocated(self) -> tuple[ReducedProblem, Profile]:
        """The collocated problem that it solves, and the torsion along its arm."""

    def at(
        self,
        robot: Robot,
        rotations: Array,
        translations: Array,
        rotation_at: Callable[[Array], Array] | None = None,
        *,
        load: Load | None = None,
        curvature_at: Callable[[Array], Array] | None = None,
    ) -> Self:
        """An equilibrium of a robot at joint values, from rotations (n, P) of its tubes at arc lengths (P,), and under
        `load` from curvatures (2, P), or cold."""

    def verified(self) -> Self:
        """The same, verified by adaptive re-integration."""


N = TypeVar("N", bound=Near)

"""What takes longer to know than a shape: certificate, S-curve and stability map, each computed when the hand rests."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

import numpy as np

from ...equilibrium.result import Equilibrium
from ...errors import InputError, SolveError
from ...robots.robot import Robot
from ...stability import Branch, StabilityMap, snap_free_certificate, stability_map, trace_branch
from .external_load import bearing_words
from .panel import Panel
from .plots import map_plot, s_curve_plot
from .session import Session
from .worker import Job

MAP_SAMPLES = 13
"""Points per axis of the small stability map."""

WIDEST = 2 * np.pi
"""S-curves are traced no farther than a turn from home, where limits are wider."""


CURVES = 16
"""S-curves that are remembered, for all tabs: a robot often comes back to where it was."""

Place = tuple[Robot, tuple[float, ...]]
"""A robot and its translations, m."""

Way = tuple[Place, int, tuple[float, ...]]
"""A place, a tube that turns, and the rotations of the others, rad."""


class _InterruptedError(Exception):
    """Something more urgent is to be done."""


class Insights:
    """Remembers each answer with the question that it belongs to, and shows it while that is the question.

    Args:
        session: what is shown now.
        waiting: whether something more urgent is to be done.
    """

    def __init__(self, panel: Panel, session: Callable[[], Session], waiting: Callable[[], bool]) -> None:
        self._panel, self._session, self._waiting = panel, session, waiting
        self.tube = 0
        self._certificate: tuple[object, float] | None = None
        self._curve: tuple[object, Branch | None] | None = None
        self._map: tuple[object, StabilityMap | None] | None = None
        self._map_wanted = False
        self._borne: Equilibrium | None = None

    @property
    def chores(self) -> list[tuple[float, Job]]:
        """What to do when it has been quiet for so many seconds."""
        return [(0.03, self._certify), (0.1, self._bear), (0.35, self._trace), (0.6, self._chart)]

    @property
    def certificate(self) -> float | None:
        """The certificate at the present translations, None where it is not known yet."""
        return self._certificate[1] if self._certificate and self._certificate[0] == self._at() else None

    def want_map(self, on: bool) -> None:
        """Show a stability map, or none."""
        self._map_wanted, self._map = on, None
        self._panel.plot("map", "computing the stability map …" if on else "", text=on)

    def plot(self) -> None:
        """Mark the present place in the plots that hold at it."""
        here = self._session().equilibrium
        if here.load is not None:
            return
        if self._curve and self._curve[1] is not None and self._curve[0] == self._way():
            self._panel.plot("curve", s_curve_plot(self._curve[1], here, self.tube))
        if self._map and self._map[1] is not None and self._map[0] == self._at():
            self._panel.plot("map", map_plot(self._map[1], here))

    def _at(self) -> Place:
        """What certificate and map depend on."""
        session = self._session()
        return session.robot, tuple(session.equilibrium.translations.tolist())

    def _way(self) -> Way:
        """What the S-curve depends on."""
        here = self._session().equilibrium
        return self._at(), self.tube, tuple(np.delete(here.rotations, self.tube).tolist())

    def _certify(self) -> None:
        if self.certificate is None:
            session = self._session()
            value = snap_free_certificate(session.robot, session.equilibrium.translations)
            self._certificate = self._at(), value
            self._panel.show(session, value, None)

    def _bear(self) -> None:
        """What the load does, and how much of it the robot bears."""
        here = self._session().equilibrium
        if self._panel.push is not None and self._borne is not here:
            self._borne = here
            self._panel.push.tell(bearing_words(here))

    def _trace(self) -> None:
        key = self._way()
        if self._session().equilibrium.load is not None:
            self._curve = None
            self._panel.plot("curve", "S-curves and maps are for no load", text=True)
            return
        if self._curve and self._curve[0] == key:
            return
        try:
            self._curve = key, _s_curve(*key)
        except (InputError, SolveError) as error:
            self._curve = key, None
            self._panel.plot("curve", f"no S-curve here: {error}", text=True)
        self.plot()

    def _chart(self) -> None:
        key = self._at()
        if not self._map_wanted or (self._map and self._map[0] == key):
            return

        def urgent(done: int, of: int) -> None:
            if self._waiting():
                raise _InterruptedError

        session = self._session()
        shift = session.equilibrium.translations
        try:
            # Directions as few as they can be, and even: half of the ways tell of the other.
            chart = stability_map(session.robot, shift, samples=MAP_SAMPLES, directions=2, workers=1, progress=urgent)
        except _InterruptedError:
            return
        except (InputError, SolveError) as error:
            self._map = key, None
            self._panel.plot("map", f"no stability map: {error}", text=True)
            return
        self._map = key, chart
        self.plot()


@lru_cache(maxsize=CURVES)
def _s_curve(place: Place, tube: int, others: tuple[float, ...]) -> Branch:
    """The branch along a turn of one tube, from one limit to the other; raises as `trace_branch` does."""
    robot, shift = place
    ends = np.clip(robot.limits.rotations[tube], -WIDEST, WIDEST)
    start, end = (np.insert(np.array(others), tube, angle) for angle in ends)
    return trace_branch(robot, start, end, np.array(shift))

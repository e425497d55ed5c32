"""A trajectory under somebody's hands: played, paused, scrubbed, and what was recorded played again."""

from __future__ import annotations

import time
from collections.abc import Callable

from ...errors import InputError
from .panel import Panel
from .playback import Playback, Waypoints, make_playback, play_to, recorded
from .session import Session

TICK = 0.04
"""Time between pictures of a trajectory, s."""

OTHER_TUBES = "the trajectory is of other tubes than these: go back to those, or load it again"


class Player:
    """Plays a trajectory with the robot of a tab.

    Args:
        panel: shows the time.   session: where the robot is.   change: does something to it.   do: has a job done.
    """

    def __init__(
        self,
        panel: Panel,
        session: Callable[[], Session],
        change: Callable[[Callable[[Session], Session]], None],
        do: Callable[[Callable[[], object]], None],
    ) -> None:
        self._panel, self._session, self._change, self._do = panel, session, change, do
        self.playback: Playback | None = None
        self._time = 0.0
        self._playing: float | None = None

    def take(self, waypoints: Waypoints) -> Playback:
        """Make a trajectory ready; raises as `make_playback` does."""
        self.playback = make_playback(self._session().robot, waypoints)
        self._panel.tick("swept", on=False)
        self._panel.offer_playback(self.playback.duration)
        self._time = 0.0
        return self.playback

    def offer(self, waypoints: Waypoints) -> str:
        """Make a trajectory ready and go to its beginning; what it is, in words. Raises as `take` does."""
        followed = self.take(waypoints).path
        self.to(0.0)
        return f"{len(followed.equilibria)} waypoints, {len(followed.snaps)} snaps on the path"

    def replay(self) -> str:
        """Play what the session has recorded; in words, what that is. Raises as `recorded` and `take` do."""
        words = self.offer(recorded(self._session()))
        self.toggle()
        return words

    def pause(self) -> None:
        """Play no more."""
        self._playing = None

    def toggle(self) -> None:
        """Play, or pause; raises InputError where there is nothing to be played."""
        if self.playback is None:
            raise InputError("there is no trajectory to be played")
        if self._playing is not None:
            self._playing = None
            return
        if self._time >= self.playback.duration:
            self._time = 0.0
        self.to(self._time)
        self._playing = time.monotonic() - self._time
        self._do(self._tick)

    def _tick(self) -> None:
        if self._playing is None or self.playback is None:
            return
        began = time.monotonic()
        now = began - self._playing
        self.to(now, log=True)
        if now >= self.playback.duration:
            self._playing = None
            return
        time.sleep(max(0.0, TICK - (time.monotonic() - began)))
        self._do(self._tick)

    def to(self, seconds: float, *, log: bool = False) -> None:
        """Go to a time, s; `log`: as a motion, whose snaps are told. Raises InputError where tubes are others now."""
        playback = self.playback
        if playback is None:
            return
        if self._session().robot != playback.path.equilibria[0].robot:
            self._playing = None
            raise InputError(OTHER_TUBES)
        since = self._time if log else None
        self._time = min(max(seconds, 0.0), playback.duration)
        self._change(lambda session: play_to(session, playback, self._time, since=since))
        self._panel.at_time(self._time)

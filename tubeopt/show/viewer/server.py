"""The viewer as a page: one tab for each browser, its player, and the server of all tabs."""

from __future__ import annotations

import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import resources
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from ...bodies.frames import Plane
from ...errors import InputError, SolveError
from ...robots.file import load_robot
from ...workspaces import workspace
from ..surfaces import Part
from .host import LOCAL, Added, address_of, page_title, quiet_server, saved
from .insights import Insights, Worker, torsion_plot
from .overlays import COLOUR, OPACITY, Beside, cut_parts, cut_words, session_beside, swept_volume
from .panel import ForceArrow, Panel
from .scene import Mark, Scene, animate, ghost_parts, look_from
from .session import Session, other_equilibria
from .teleoperation import PATH, Hand, Hands, pull
from .view import Given, Playback, View, Waypoints, load_bodies, load_waypoints, make_playback, play_to, recorded
from .words import Verb, Wishes, others_words

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
        """Stop the playback."""
        self._playing = None

    def toggle(self) -> None:
        """Play, or pause; raises InputError where there is nothing to be played."""
        if self.playback is None:
            raise InputError("there is no trajectory to be played")
        if self._playing is not None:
            self._playing = None
            return
        # At its end, the same button plays it again from the beginning.
        if self._time >= self.playback.duration:
            self._time = 0.0
        self.to(self._time)
        # The instant at which time 0 of the trajectory was: the clock less the time reached.
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
        # Each tick is a job of its own, so that what the hand does comes in between.
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
        # Only a motion has a history; a leap of the slider passes no snap.
        since = self._time if log else None
        self._time = min(max(seconds, 0.0), playback.duration)
        self._change(lambda session: play_to(session, playback, self._time, since=since))
        self._panel.at_time(self._time)


CLOUD = 4000
"""Samples of the workspace layer."""

UNDONE = 200
"""Changes that can be taken back."""

ADVISED = "this tab has a robot of its own"


class Tab(Wishes):
    """State of one client of the server."""

    def __init__(self, client: Any, view: View, hands: Hands) -> None:
        self._client, self._view, self._hands = client, view, hands
        self._hand, self._word = Hand(), hands.admit(self.drive)
        self.session = view.session()
        self.scene = Scene(client.scene)
        self._trail = True
        self._obstacles = view.obstacles
        self._plane: Plane | None = None
        self._beside: Beside | None = None
        self._given = Given()
        self._stale = False
        self._past: deque[Session] = deque(maxlen=UNDONE)
        self._held: int | str | None = None
        self.panel = Panel(client.gui, self, view)
        self._say = self.panel.say
        self._target = Mark(client.scene, "target", lambda place, done: self.lead(place, done=done))
        self._arrow = ForceArrow(client.scene, self.scene, self.panel.push, view)
        self._insights = Insights(self.panel, lambda: self.session, lambda: self._worker.waiting)
        self._player = Player(self.panel, lambda: self.session, self._change, self._do)
        self._worker = Worker(
            self._insights.chores, lambda error: self._say(f"something went wrong: {error}", bad=True)
        )
        self._do(self._begin)

    # --- what the page asks for --------------------------------------------------------------------------------------

    def change(self, verb: Verb, *, held: int | str | None = None, key: str | None = None, pause: bool = True) -> None:
        def go() -> None:
            if isinstance(held, int) and held < self.session.robot.n_tubes:
                # The S-curve is that of the tube that was moved last.
                self._insights.tube = held
            self._change(verb, held)

        name = held if isinstance(held, str) else None
        (self._by_hand if pause else self._do)(go, key=key or name)

    def undo(self) -> None:
        def go() -> None:
            if not self._past:
                self._say("nothing was changed")
                return
            # Taken back without a snap on the way: it is where the robot was, not how it came from here.
            earlier = self._past.pop()
            # `_change` remembers the state before it; taken back twice, it would only alternate between two.
            self._change(lambda session: replace(earlier, last=()))
            self._past.pop()

        self._by_hand(go)

    def lead(self, target: np.ndarray, *, done: bool) -> None:
        def led(session: Session) -> tuple[Session, str]:
            return pull(session, target, min_margin=self.panel.least_margin, obstacles=self._obstacles)

        # While the target is dragged, all steps together are one change for undo.
        self.change(led, held=None if done else "lead")

    def drive(self, velocity: np.ndarray) -> None:
        """Move the tip with a velocity (3,), a share of the greatest, for as long as messages keep coming."""

        def driven(session: Session) -> tuple[Session, str]:
            return self._hand.lead(session, velocity, self.panel.least_margin, self._obstacles)

        self.change(driven, held="drive" if velocity.any() else None, key="drive")

    def ghosts(self) -> None:
        self._do(self._toggle_ghosts)

    def show(self, layer: str, on: bool) -> None:
        self._do(lambda: self._show(layer, on))

    def cut(self, plane: Plane | None) -> None:
        def go() -> None:
            self._plane = plane
            if "obstacles" in self.scene.contents:  # which may be none before the plane
                self._show("obstacles", True)

        self._do(go, key="cut")

    def load(self, what: str, name: str, content: bytes) -> None:
        self._do(lambda: self._load(what, name, content))

    def play(self) -> None:
        self._do(self._player.toggle)

    def scrub(self, seconds: float) -> None:
        self._by_hand(lambda: self._player.to(seconds), key="scrub")

    def save(self, what: str) -> None:
        self._do(lambda: self._save(what))

    def replay(self) -> None:
        self._do(lambda: self._say(self._player.replay()))

    def look(self, side: str) -> None:
        def go() -> None:
            # A camera that was turned over keeps its roll otherwise.
            self._client.camera.up_direction = (0.0, 0.0, 1.0)
            look_from(self._client.camera, self.session.equilibrium, side)

        self._do(go)

    def close(self) -> None:
        """The tab is gone."""
        self._hands.dismiss(self._word)
        self._worker.close()
        self._given.close()

    # --- in the worker -----------------------------------------------------------------------------------------------

    def _do(self, job: Callable[[], object], *, key: str | None = None) -> None:
        def go() -> None:
            try:
                job()
            except (InputError, SolveError) as error:
                self._say(str(error), bad=True)
            finally:
                # What waited did not show the change that left it to be shown.
                if self._stale and not self._worker.waiting:
                    self._refresh()

        self._worker.post(go, key=key)

    def _by_hand(self, job: Callable[[], object], *, key: str | None = None) -> None:
        """Have something done to the robot; a trajectory that is being played pauses for it."""

        def go() -> None:
            self._player.pause()
            job()

        self._do(go, key=key)

    def _begin(self) -> None:
        self.scene.set_stage(self.session.equilibrium)
        if self._obstacles:
            self._show("obstacles", True)
        failed = ""
        if self._view.waypoints is not None:
            self._say("following the trajectory …")
            try:
                self._player.take(self._view.waypoints)
            except (InputError, SolveError) as error:
                failed = f"the trajectory cannot be followed: {error}"
        self._say(failed or ADVISED, bad=bool(failed))
        self._refresh()

    def _change(self, verb: Verb, held: int | str | None = None) -> None:
        """Change the session; say why where that cannot be, or in which words the verb tells what stopped it, and show
        what came of it unless more is to come. What the hand does with the same thing `held` is one change."""
        before, earlier, self._held = self.session, self._held, held
        try:
            changed = verb(before)
        except (InputError, SolveError) as error:
            self._say(str(error), bad=True)
            self.panel.sync(self.session, refused=True)
            return
        self.session, said = changed if isinstance(changed, tuple) else (changed, "")
        moved = self.session is not before
        if moved:
            # A slider that is dragged makes dozens of changes; undo takes back the whole.
            if held is None or held != earlier:
                self._past.append(before)
            self.scene.clear("ghosts")
        if moved and self.session.last:
            animate(self._client, self.scene, self.session.last)
        if self.session.robot is not before.robot:
            self.scene.set_stage(self.session.equilibrium)
            self.panel.tick("workspace", "swept", on=False)  # which are of other tubes
        self._say(said, bad=bool(said))
        self._stale = True
        # Pictures of states in between are skipped where more changes wait: the hand is followed without delay.
        if not self._worker.waiting:
            self._refresh(None if said else held)

    def _refresh(self, held: int | str | None = None) -> None:
        """Show the session; the slider that is being dragged is left to the hand."""
        self._stale = False
        equilibrium = self.session.equilibrium
        # All in one picture: otherwise arm, trail and target would be seen one after the other.
        with self._client.atomic():
            self.scene.show(equilibrium)
            if self._beside is not None and self._beside.visible and (words := self._beside.follow(self.session)):
                self._say(words, bad=True)
            # A target that is dragged belongs to the hand; following the tip, it would slip away.
            if self._held != "lead":
                self._target.follow(equilibrium.tip_position)
            self._arrow.show(equilibrium, held=self._held == "push")
            self.scene.show_trail(self.session, self._trail)
            self.panel.show(self.session, self._insights.certificate, torsion_plot(equilibrium))
            self._insights.plot()
        self.panel.sync(self.session, held)

    def _toggle_ghosts(self) -> None:
        if self.scene.has("ghosts"):
            self.scene.clear("ghosts")
            self._say("")
            return
        others = other_equilibria(self.session)
        self.scene.layer("ghosts", ghost_parts(others))
        self._say(others_words(others))

    def _show(self, layer: str, on: bool) -> None:
        if layer == "trail":
            self._trail = on
            self.scene.show_trail(self.session, on)
        elif layer == "map":
            self._insights.want_map(on)
        elif layer == "target":
            self._target.put(self.session.equilibrium.tip_position, self.session.robot, on)
        elif layer == "hand":
            self.panel.lend(self._word if on else None)
        elif layer == "force":
            self._arrow.mark(self.session.equilibrium, on)
        elif layer == "beside":
            if self._beside is None:
                self._say("no other robot was loaded", bad=on)
                return
            self._beside.visible = on
            self._refresh()
        elif not on:
            self.scene.clear(layer)
        elif layer == "obstacles":
            if not self._obstacles:
                raise InputError("no obstacles were loaded")
            reach = max(tube.length for tube in self.session.robot.tubes)
            parts = cut_parts(self._obstacles, reach, self._plane)
            self.scene.layer("obstacles", parts)
            self._say(cut_words(parts, self._plane))
        elif layer == "workspace":
            self._say(f"solving {CLOUD} configurations …")
            found = workspace(self.session.robot, CLOUD)
            self.scene.show_cloud(found)
            self._say(f"{len(found) - len(found.failures)} tips, coloured by their margin (green 1, red 0)")
        elif layer == "swept":
            self._sweep()

    def _sweep(self) -> None:
        if self._player.playback is None:
            raise InputError("there is no trajectory for a swept volume")
        self._say("joining shapes …")
        swept = swept_volume(self._player.playback)
        self.scene.layer("swept", [Part("volume", swept.surface, COLOUR, OPACITY)])
        self._say(f"the arm sweeps {swept.volume * 1e6:.2f} cm3 (hulls between {swept.shapes} shapes; snaps left out)")

    def _load(self, what: str, name: str, content: bytes) -> None:
        takers = {"trajectory": self._take_trajectory, "obstacles": self._take_obstacles, "beside": self._take_beside}
        try:
            self._say(f"{name}: {takers[what](self._given.keep(name, content))}")
        except (InputError, SolveError) as error:
            self._say(self._given.words(error), bad=True)

    def _take_trajectory(self, path: Path) -> str:
        return self._player.offer(load_waypoints(path, self.session.robot))

    def _take_obstacles(self, path: Path) -> str:
        self._obstacles, words = load_bodies(path)
        self._show("obstacles", True)
        self.panel.tick("obstacles")
        return f"{words}; the tip avoids them when you drag it"

    def _take_beside(self, path: Path) -> str:
        session = session_beside(load_robot(path), self.session)
        if self._beside is not None:
            self._beside.remove()
        self._beside = Beside(self._client.scene, session, self.session)
        self.panel.tick("beside")
        return "stands beside, at the same joint values"

    def _save(self, what: str) -> None:
        if what == "picture":
            self._say("taking the picture …")
        try:
            self._say(saved(what, self.session, self.scene, self._client, trail=self._trail, out=self._view.out))
        except (RuntimeError, OSError) as error:
            raise InputError(str(error)) from None


PORT = 8080


def serve(
    view: View,
    *,
    host: str = LOCAL,
    port: int = PORT,
    ready: Callable[[str], object] | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Serve a view until `stop` is set, or until Ctrl-C or SIGTERM where this is the main thread.

    Args:
        host: address to listen on. Any but 127.0.0.1 lets others move the robot, and read what is shown.
        port: 0 takes any that is free.
        ready: called with the address of the page once it is served.

    Raises:
        InputError: the address or port cannot be had, viser is not installed, joint values that are not allowed.
        SolveError: no stable equilibrium to begin with.
    """
    first = view.session()
    over = stop or threading.Event()
    tabs: dict[int, Tab] = {}
    lock = threading.Lock()
    hands = Hands()
    added = Added(head(), PATH, hands.attend)
    with _signals(over), quiet_server(host, port, page_title(first), added) as server:
        look_from(server.initial_camera, first.equilibrium)
        # Red, green, blue: x, y, z of the plate, 5 cm long.
        server.scene.world_axes.visible = True
        # Sharing would publish the page over viser's relay.
        server.gui.configure_theme(show_share_button=False, show_logo=False)

        def came(client: Any) -> None:
            tab = Tab(client, view, hands)
            with lock:
                # A browser may be gone before its tab is made: then nobody would close it.
                if client.client_id in server.get_clients():
                    tabs[client.client_id] = tab
                    return
            tab.close()

        def left(client: Any) -> None:
            with lock:
                tab = tabs.pop(client.client_id, None)
            if tab is not None:
                tab.close()

        server.on_client_connect(came)
        server.on_client_disconnect(left)
        if ready is not None:
            ready(address_of(host, server.get_port()))
        try:
            over.wait()
        finally:
            with lock:
                for tab in tabs.values():
                    tab.close()


def head() -> str:
    """Style and scripts of the page besides those of viser."""
    files = resources.files(__package__)
    style, script = (files.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "hand.js"))
    return f"<style>{style}</style><script>{script}</script>"


@contextmanager
def _signals(over: threading.Event) -> Iterator[None]:
    """End quietly on Ctrl-C and SIGTERM; elsewhere than in the main thread signals are not ours."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        over.set()

    # Handlers only set an event: clean-up in a handler could wait for a lock that this thread holds.
    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

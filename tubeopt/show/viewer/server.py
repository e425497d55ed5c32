"""Server of the viewer: a tab for each browser, with its player."""

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
from .host import LOCAL, AddedHandler, address_of, page_title, quiet_server, saved
from .insights import Insights, Worker, torsion_plot
from .overlays import COLOUR, OPACITY, ComparedRobot, comparison_session, cut_parts, cut_text, swept_volume
from .page_text import Change, Commands, ghost_text
from .panel import ForceArrow, Panel
from .scene import Mark, ViewerScene, animate, ghost_parts, look_from
from .session import Session, other_equilibria
from .teleoperation import PATH, Channel, TipServo, drag_tip
from .view import (
    LoadedFiles,
    Playback,
    View,
    ViewerWaypoints,
    load_bodies,
    load_waypoints,
    make_playback,
    play_to,
    recorded,
)

TICK = 0.04
"""Time between pictures during playback, s."""

OTHER_TUBES = "the trajectory is of other tubes than these: go back to those, or load it again"


class Player:
    """Player of trajectories for the robot of a tab.

    Args:
        panel: panel that shows the time.
        session: returns the current session.
        change: changes the session.
        do: queues a job for the worker of the tab.
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

    def take(self, waypoints: ViewerWaypoints) -> Playback:
        """Set the trajectory of the player; raises as `make_playback` does."""
        self.playback = make_playback(self._session().robot, waypoints)
        self._panel.tick("swept", on=False)
        self._panel.offer_playback(self.playback.duration)
        self._time = 0.0
        return self.playback

    def start(self, waypoints: ViewerWaypoints) -> str:
        """Description of a trajectory that is loaded and shown at its start; raises as `take` does."""
        path = self.take(waypoints).path
        self.to(0.0)
        return f"{len(path.equilibria)} waypoints, {len(path.snaps)} snaps on the path"

    def replay(self) -> str:
        """Description of the recorded motion, which is played; raises as `recorded` and `take` do."""
        description = self.start(recorded(self._session()))
        self.toggle()
        return description

    def pause(self) -> None:
        """Pause the playback at the current time."""
        self._playing = None

    def toggle(self) -> None:
        """Play, or pause; raises InputError without a trajectory."""
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
        """Show the state at the present time of the playback, and queue the next call."""
        if self._playing is None or self.playback is None:
            return
        start_time = time.monotonic()
        now = start_time - self._playing
        self.to(now, log=True)
        if now >= self.playback.duration:
            self._playing = None
            return
        # Each tick is a job of its own, so that commands of the user come in between.
        time.sleep(max(0.0, TICK - (time.monotonic() - start_time)))
        self._do(self._tick)

    def to(self, seconds: float, *, log: bool = False) -> None:
        """Go to a time, s; raises InputError if the robot has other tubes now.

        log: True for a motion, whose snaps are logged.
        """
        playback = self.playback
        if playback is None:
            return
        if self._session().robot != playback.path.equilibria[0].robot:
            self._playing = None
            raise InputError(OTHER_TUBES)
        # Only a motion has a history; a jump of the slider passes no snap.
        since = self._time if log else None
        self._time = min(max(seconds, 0.0), playback.duration)
        self._change(lambda session: play_to(session, playback, self._time, since=since))
        self._panel.at_time(self._time)


CLOUD = 4000
"""Samples of the workspace layer."""

MAX_UNDO = 200
"""Number of changes that can be undone."""

GREETING = "this tab has a robot of its own"


class Tab(Commands):
    """State of one client of the server."""

    def __init__(self, client: Any, view: View, channel: Channel) -> None:
        self._client, self._view, self._channel = client, view, channel
        self._servo, self._token = TipServo(), channel.register(self.drive)
        self.session = view.session()
        self.scene = ViewerScene(client.scene)
        self._trail = True
        self._obstacles = view.obstacles
        self._plane: Plane | None = None
        self._comparison: ComparedRobot | None = None
        self._files = LoadedFiles()
        self._stale = False
        self._past: deque[Session] = deque(maxlen=MAX_UNDO)
        self._dragged: int | str | None = None
        self.panel = Panel(client.gui, self, view)
        self._say = self.panel.say
        self._target = Mark(client.scene, "target", lambda target, released: self.move_tip(target, released=released))
        self._arrow = ForceArrow(client.scene, self.scene, self.panel.push, view)
        self._insights = Insights(self.panel, lambda: self.session, lambda: self._worker.waiting)
        self._player = Player(self.panel, lambda: self.session, self._change, self._do)
        self._worker = Worker(
            self._insights.chores, lambda error: self._say(f"something went wrong: {error}", bad=True)
        )
        self._do(self._begin)

    # --- commands of the page ----------------------------------------------------------------------------------------

    def change(
        self, change: Change, *, dragged: int | str | None = None, key: str | None = None, pause: bool = True
    ) -> None:
        def go() -> None:
            if isinstance(dragged, int) and dragged < self.session.robot.n_tubes:
                # The S-curve is that of the tube that was moved last.
                self._insights.tube = dragged
            self._change(change, dragged)

        name = dragged if isinstance(dragged, str) else None
        (self._do_paused if pause else self._do)(go, key=key or name)

    def undo(self) -> None:
        def go() -> None:
            if not self._past:
                self._say("nothing was changed")
                return
            # Without a snap: the robot is put back, it does not move there.
            earlier = self._past.pop()
            # `_change` stores the state before it; with it, a second undo would be a redo.
            self._change(lambda session: replace(earlier, last=()))
            self._past.pop()

        self._do_paused(go)

    def move_tip(self, target: np.ndarray, *, released: bool) -> None:
        def moved(session: Session) -> tuple[Session, str]:
            return drag_tip(session, target, min_margin=self.panel.min_margin, obstacles=self._obstacles)

        # While the target is dragged, all steps together are one change for undo.
        self.change(moved, dragged=None if released else "target")

    def drive(self, velocity: np.ndarray) -> None:
        """Move the tip with a velocity (3,) over the largest speed, as long as messages arrive."""

        def driven(session: Session) -> tuple[Session, str]:
            return self._servo.move(session, velocity, self.panel.min_margin, self._obstacles)

        self.change(driven, dragged="drive" if velocity.any() else None, key="drive")

    def ghosts(self) -> None:
        self._do(self._toggle_ghosts)

    def show(self, layer: str, on: bool) -> None:
        self._do(lambda: self._show(layer, on))

    def cut(self, plane: Plane | None) -> None:
        def go() -> None:
            self._plane = plane
            if "obstacles" in self.scene.contents:
                self._show("obstacles", True)

        self._do(go, key="cut")

    def load(self, what: str, name: str, content: bytes) -> None:
        self._do(lambda: self._load(what, name, content))

    def play(self) -> None:
        self._do(self._player.toggle)

    def scrub(self, seconds: float) -> None:
        self._do_paused(lambda: self._player.to(seconds), key="scrub")

    def save(self, what: str) -> None:
        self._do(lambda: self._save(what))

    def replay(self) -> None:
        self._do(lambda: self._say(self._player.replay()))

    def look(self, side: str) -> None:
        def go() -> None:
            # Otherwise, a camera that was turned over keeps its roll.
            self._client.camera.up_direction = (0.0, 0.0, 1.0)
            look_from(self._client.camera, self.session.equilibrium, side)

        self._do(go)

    def close(self) -> None:
        """Stop the worker and remove the files of a closed tab."""
        self._channel.remove(self._token)
        self._worker.close()
        self._files.close()

    # --- in the worker -----------------------------------------------------------------------------------------------

    def _do(self, job: Callable[[], object], *, key: str | None = None) -> None:
        def go() -> None:
            try:
                job()
            except (InputError, SolveError) as error:
                self._say(str(error), bad=True)
            finally:
                # The last job of the queue shows the changes that earlier ones left to it.
                if self._stale and not self._worker.waiting:
                    self._refresh()

        self._worker.post(go, key=key)

    def _do_paused(self, job: Callable[[], object], *, key: str | None = None) -> None:
        """Queue a job on the robot that first pauses the playback."""

        def go() -> None:
            self._player.pause()
            job()

        self._do(go, key=key)

    def _begin(self) -> None:
        """Show the initial robot, obstacles and trajectory."""
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
        self._say(failed or GREETING, bad=bool(failed))
        self._refresh()

    def _change(self, change: Change, dragged: int | str | None = None) -> None:
        """Change the session, report errors or an early stop, and show the result unless more jobs wait.

        All changes with the same `dragged` control are one step of undo.
        """
        before, last_dragged, self._dragged = self.session, self._dragged, dragged
        try:
            changed = change(before)
        except (InputError, SolveError) as error:
            self._say(str(error), bad=True)
            self.panel.sync(self.session, refused=True)
            return
        self.session, reason = changed if isinstance(changed, tuple) else (changed, "")
        moved = self.session is not before
        if moved:
            # A dragged slider makes dozens of changes; undo reverts all of them.
            if dragged is None or dragged != last_dragged:
                self._past.append(before)
            self.scene.clear("ghosts")
        if moved and self.session.last:
            animate(self._client, self.scene, self.session.last)
        if self.session.robot is not before.robot:
            self.scene.set_stage(self.session.equilibrium)
            self.panel.tick("workspace", "swept", on=False)  # they were of the previous tubes
        self._say(reason, bad=bool(reason))
        self._stale = True
        # Intermediate states are not drawn while more changes wait, so that the robot follows the user without delay.
        if not self._worker.waiting:
            self._refresh(None if reason else dragged)

    def _refresh(self, dragged: int | str | None = None) -> None:
        """Show the session; the slider of the dragged joint is not moved."""
        self._stale = False
        equilibrium = self.session.equilibrium
        # In one picture: otherwise arm, trail and target would change one after the other.
        with self._client.atomic():
            self.scene.show(equilibrium)
            if (
                self._comparison is not None
                and self._comparison.visible
                and (error := self._comparison.follow(self.session))
            ):
                self._say(error, bad=True)
            # A dragged target stays below the pointer and does not follow the tip.
            if self._dragged != "target":
                self._target.follow(equilibrium.tip_position)
            self._arrow.show(equilibrium, dragged=self._dragged == "push")
            self.scene.show_trail(self.session, self._trail)
            self.panel.show(self.session, self._insights.certificate, torsion_plot(equilibrium))
            self._insights.plot()
        self.panel.sync(self.session, dragged)

    def _toggle_ghosts(self) -> None:
        if self.scene.has("ghosts"):
            self.scene.clear("ghosts")
            self._say("")
            return
        ghosts = other_equilibria(self.session)
        self.scene.layer("ghosts", ghost_parts(ghosts))
        self._say(ghost_text(ghosts))

    def _show(self, layer: str, on: bool) -> None:
        """Show or hide a layer."""
        if layer == "trail":
            self._trail = on
            self.scene.show_trail(self.session, on)
        elif layer == "map":
            self._insights.show_map(on)
        elif layer == "target":
            self._target.put(self.session.equilibrium.tip_position, self.session.robot, on)
        elif layer == "hand":
            self.panel.show_keys(self._token if on else None)
        elif layer == "force":
            self._arrow.mark(self.session.equilibrium, on)
        elif layer == "beside":
            if self._comparison is None:
                self._say("no other robot was loaded", bad=on)
                return
            self._comparison.visible = on
            self._refresh()
        elif not on:
            self.scene.clear(layer)
        elif layer == "obstacles":
            if not self._obstacles:
                raise InputError("no obstacles were loaded")
            reach = max(tube.length for tube in self.session.robot.tubes)
            parts = cut_parts(self._obstacles, reach, self._plane)
            self.scene.layer("obstacles", parts)
            self._say(cut_text(parts, self._plane))
        elif layer == "workspace":
            self._say(f"solving {CLOUD} configurations …")
            cloud = workspace(self.session.robot, CLOUD)
            self.scene.show_cloud(cloud)
            self._say(f"{len(cloud) - len(cloud.failures)} tips, coloured by their margin (green 1, red 0)")
        elif layer == "swept":
            self._sweep()

    def _sweep(self) -> None:
        """Show the volume swept by the trajectory."""
        if self._player.playback is None:
            raise InputError("there is no trajectory for a swept volume")
        self._say("joining shapes …")
        swept = swept_volume(self._player.playback)
        self.scene.layer("swept", [Part("volume", swept.surface, COLOUR, OPACITY)])
        self._say(f"the arm sweeps {swept.volume * 1e6:.2f} cm3 (hulls between {swept.shapes} shapes; snaps left out)")

    def _load(self, what: str, name: str, content: bytes) -> None:
        """Load a file, and describe it or report its errors."""
        load = {"trajectory": self._load_trajectory, "obstacles": self._load_obstacles, "beside": self._load_comparison}
        try:
            self._say(f"{name}: {load[what](self._files.keep(name, content))}")
        except (InputError, SolveError) as error:
            self._say(self._files.message(error), bad=True)

    def _load_trajectory(self, path: Path) -> str:
        return self._player.start(load_waypoints(path, self.session.robot))

    def _load_obstacles(self, path: Path) -> str:
        self._obstacles, description = load_bodies(path)
        self._show("obstacles", True)
        self.panel.tick("obstacles")
        return f"{description}; the tip avoids them when you drag it"

    def _load_comparison(self, path: Path) -> str:
        session = comparison_session(load_robot(path), self.session)
        if self._comparison is not None:
            self._comparison.remove()
        self._comparison = ComparedRobot(self._client.scene, session, self.session)
        self.panel.tick("beside")
        return "stands beside, at the same joint values"

    def _save(self, what: str) -> None:
        """Send an export to the browser."""
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
    """Serve a view until `stop` is set, or in the main thread until Ctrl-C or SIGTERM.

    Args:
        host: address to listen on. With any but 127.0.0.1, other computers can read the page and move the robot.
        port: port to listen on; 0 selects a free one.
        ready: called with the address of the page once it is served.
        stop: event that ends the server.

    Raises:
        InputError: address or port is not available, viser is not installed, or joint values are not allowed.
        SolveError: there is no stable equilibrium at the start.
    """
    first = view.session()
    stop = stop or threading.Event()
    tabs: dict[int, Tab] = {}
    lock = threading.Lock()
    channel = Channel()
    added = AddedHandler(head(), PATH, channel.receive)
    with _signals(stop), quiet_server(host, port, page_title(first), added) as server:
        look_from(server.initial_camera, first.equilibrium)
        # Red, green, blue: x, y, z of the plate, 5 cm long.
        server.scene.world_axes.visible = True
        # Sharing would publish the page over viser's relay.
        server.gui.configure_theme(show_share_button=False, show_logo=False)

        def connected(client: Any) -> None:
            tab = Tab(client, view, channel)
            with lock:
                # A browser may disconnect before its tab is made: then nobody would close it.
                if client.client_id in server.get_clients():
                    tabs[client.client_id] = tab
                    return
            tab.close()

        def disconnected(client: Any) -> None:
            with lock:
                tab = tabs.pop(client.client_id, None)
            if tab is not None:
                tab.close()

        server.on_client_connect(connected)
        server.on_client_disconnect(disconnected)
        if ready is not None:
            ready(address_of(host, server.get_port()))
        try:
            stop.wait()
        finally:
            with lock:
                for tab in tabs.values():
                    tab.close()


def head() -> str:
    """Styles and scripts that are added to the page of viser."""
    files = resources.files(__package__)
    style, script = (files.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "hand.js"))
    return f"<style>{style}</style><script>{script}</script>"


@contextmanager
def _signals(stop: threading.Event) -> Iterator[None]:
    """Context that sets `stop` on Ctrl-C and SIGTERM; only the main thread may handle signals."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: FrameType | None) -> None:
        stop.set()

    # Handlers only set an event: clean-up in a handler could wait for a lock that this thread holds.
    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

"""One tab of the viewer: its session, what is done with it, and what is shown of it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ...bodies.plane import Plane
from ...errors import InputError, SolveError
from ...inverse.mirror import mirror_rotations
from ...robots.file import load_robot
from ...robots.load import Load
from ...workspaces import workspace
from .beside import Beside, session_beside
from .cut import cut_parts, cut_words
from .designs import Knob, with_knob
from .export import saved
from .given import Given, load_bodies
from .hand import Hand, Hands
from .insights import Insights
from .mark import ForceArrow, Mark
from .panel import Panel
from .playback import load_waypoints
from .player import Player
from .plots import torsion_plot
from .pushing import push_on
from .scene import Scene, animate, ghost_parts, look_from, swept_part
from .servo import pull
from .session import Session, clear_trail, go_home, move, move_joint, other_equilibria, record, redesign
from .swept import swept_volume
from .view import View
from .wishes import MIRROR, Wishes
from .words import others_words
from .worker import Worker

CLOUD = 4000
"""Samples of the workspace layer."""

UNDONE = 200
"""Changes that can be taken back."""

ADVISED = "this tab has a robot of its own"


class Tab(Wishes):
    """What belongs to one client of the server. Public methods return at once; the worker does what they ask for."""

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
        self._pulling = self._pushing = self._driving = False
        self._stale = False
        self._past: deque[Session] = deque(maxlen=UNDONE)
        self._mark: int | str | None = None
        self.panel = Panel(client.gui, self, view)
        self._say = self.panel.say
        self._target = Mark(
            self.scene, "target", lambda place, done: self.lead(place, self.panel.least_margin, done=done)
        )
        self._arrow = ForceArrow(self.scene, self.panel.push, view, self)
        self._insights = Insights(self.panel, lambda: self.session, lambda: self._worker.waiting)
        self._player = Player(self.panel, lambda: self.session, self._change, self._do)
        self._worker = Worker(
            self._insights.chores, lambda error: self._say(f"something went wrong: {error}", bad=True)
        )
        self._do(self._begin)

    # --- what the page asks for --------------------------------------------------------------------------------------

    def slide(self, joint: int, value: float) -> None:
        def go() -> None:
            if joint < self.session.robot.n_tubes:
                self._insights.tube = joint
            self._change(lambda session: move_joint(session, joint, value), dragged=joint)

        self._by_hand(go)

    def go_to(self, rotations: Sequence[float], translations: Sequence[float]) -> None:
        self._by_hand(lambda: self._change(lambda session: move(session, rotations, translations)))

    def mirror(self, direction: float, separation: float) -> None:
        rotations = mirror_rotations(direction, separation)
        self._by_hand(
            lambda: self._change(lambda s: move(s, rotations, s.equilibrium.translations), dragged=MIRROR), key="mirror"
        )

    def home(self) -> None:
        self._by_hand(lambda: self._change(go_home))

    def undo(self) -> None:
        def go() -> None:
            if not self._past:
                self._say("nothing was changed")
                return
            # Taken back without a snap on the way: it is where the robot was, not how it came from here.
            earlier = self._past.pop()
            self._change(lambda session: replace(earlier, last=()))
            self._past.pop()

        self._by_hand(go)

    def lead(self, target: np.ndarray, margin: float, *, done: bool) -> None:
        def go() -> None:
            self._pulling = not done
            self._change(lambda session: pull(session, target, min_margin=margin, obstacles=self._obstacles).told)

        self._by_hand(go, key=None if done else "lead")

    def drive(self, velocity: np.ndarray) -> None:
        def go() -> None:
            self._driving = bool(velocity.any())
            self._change(lambda s: self._hand.lead(s, velocity, self.panel.least_margin, self._obstacles))

        self._by_hand(go, key="drive")

    def push(self, force: np.ndarray, gravity: tuple[float, float, float] | None, *, done: bool) -> None:
        def go() -> None:
            self._pushing = not done
            self._change(lambda session: push_on(session, Load(tuple(force.tolist()), gravity=gravity)))

        self._by_hand(go, key=None if done else "push")

    def turn(self, knob: Knob, value: float) -> None:
        self._by_hand(lambda: self._change(lambda s: redesign(s, with_knob(s.robot, knob, value))), key=knob.label)

    def reset_design(self) -> None:
        self._by_hand(lambda: self._change(lambda session: redesign(session, self._view.robot)))

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

    def forget_trail(self) -> None:
        self._do(lambda: self._change(clear_trail))

    def record(self, on: bool) -> None:
        self._do(lambda: self._change(lambda session: record(session, on)))

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
        if self._view.waypoints is not None:
            self._say("following the trajectory …")
            try:
                self._player.take(self._view.waypoints)
            except (InputError, SolveError) as error:
                self._say(f"the trajectory cannot be followed: {error}", bad=True)
                self._refresh()
                return
        self._say(ADVISED)
        self._refresh()

    def _change(self, verb: Callable[[Session], Session | tuple[Session, str]], *, dragged: int | None = None) -> None:
        """Change the session; say why where that cannot be, or in which words the verb tells what stopped it, and show
        what came of it unless more is to come."""
        before = self.session
        try:
            changed = verb(before)
        except (InputError, SolveError) as error:
            self._say(str(error), bad=True)
            self.panel.sync(self.session, refused=True)
            return
        self.session, said = changed if isinstance(changed, tuple) else (changed, "")
        moved = self.session is not before
        if moved:
            # What one hand does without letting go is one change.
            hands = {"lead": self._pulling, "push": self._pushing, "drive": self._driving}
            held = next((name for name, on in hands.items() if on), None)
            mark = dragged if dragged is not None else held
            if mark is None or mark != self._mark:
                self._past.append(before)
            self._mark = mark
            self.scene.clear("ghosts")
        if moved and self.session.last:
            animate(self._client, self.scene, self.session.last)
        if self.session.robot is not before.robot:
            self.scene.set_stage(self.session.equilibrium)
            self.panel.tick("workspace", "swept", on=False)  # which are of other tubes
        self._say(said, bad=bool(said))
        self._stale = True
        if not self._worker.waiting:
            self._refresh(None if said else dragged)

    def _refresh(self, dragged: int | None = None) -> None:
        """Show the session; the slider that is being dragged is left to the hand."""
        self._stale = False
        equilibrium = self.session.equilibrium
        with self._client.atomic():
            self.scene.show(equilibrium)
            if self._beside is not None and self._beside.visible and (words := self._beside.follow(self.session)):
                self._say(words, bad=True)
            if not self._pulling:
                self._target.follow(equilibrium.tip_position)
            self._arrow.show(equilibrium, held=self._pushing)
            self.scene.show_trail(self.session, self._trail)
            self.panel.show(self.session, self._insights.certificate, torsion_plot(equilibrium))
            self._insights.plot()
        self.panel.sync(self.session, dragged)

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
                self._say("no obstacles were loaded", bad=True)
                return
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
            self._say("there is no trajectory whose swept volume could be shown", bad=True)
            return
        self._say("joining shapes …")
        swept = swept_volume(self._player.playback)
        self.scene.layer("swept", [swept_part(swept.surface)])
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
        return f"{words}, of which the tip keeps clear when it is led"

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
            words = saved(what, self.session, self.scene, self._client, trail=self._trail, out=self._view.out)
        except (InputError, SolveError, RuntimeError, OSError) as error:
            self._say(str(error), bad=True)
            return
        self._say(words)

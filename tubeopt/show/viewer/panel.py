"""Panel of controls next to the scene: joints, targets, loads, designs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from html import escape
from typing import Any, NamedTuple

import numpy as np

from ...bodies.frames import Plane
from ...equilibrium.result import Equilibrium
from ...errors import InputError, finite
from ...files.units import TO_MILLI, TO_MM, parse_number
from ...inverse.mirror import mirror_rotations
from ...robots.concentric import ConcentricRobot
from ...robots.eccentric import BundleRobot, EccentricRobot, SegmentedEccentricRobot
from ...robots.load import Load
from ...robots.robot import Robot
from ...robots.tubes import Tube
from ...typing import Array
from .overlays import ACROSS
from .page_text import Commands, keys_text, legend, log_text, message_text, readout, typed
from .scene import Mark, ViewerScene
from .session import (
    DIRECTIONS,
    Session,
    clear_trail,
    go_home,
    head_of,
    move,
    move_joint,
    newtons_per_metre,
    push_on,
    record,
    redesign,
    space_of,
)
from .teleoperation import KEYS
from .view import BODIES, YAML, View

FIELDS = (
    ("curvature", "curvature", "1/m", 1.0, 0.1),
    ("curved length", "curved_length", "mm", TO_MM, 1.0),
    ("straight length", "straight_length", "mm", TO_MM, 1.0),
)
"""Shown properties of a tube: name, field, unit, factor to SI, and step of the slider."""


@dataclass(frozen=True)
class Knob:
    """Slider for one dimension of a tube, or of the equal tubes of a segment."""

    label: str
    index: int
    """Index of the tube in `parts`."""
    field: str
    """Name of the field of `Tube`."""
    factor: float
    """Factor from SI to the unit of the label and of the limits."""
    low: float
    high: float
    step: float

    def shown(self, robot: Robot) -> float:
        """Value of the dimension, in the unit of the label."""
        return float(getattr(parts(robot)[self.index], self.field)) * self.factor


def parts(robot: Robot) -> tuple[Tube, ...]:
    """Tubes that can be changed independently: all, the one of an eccentric robot, or one per segment."""
    if isinstance(robot, EccentricRobot):
        return (robot.tube,)
    if isinstance(robot, SegmentedEccentricRobot):
        return robot.segments
    return robot.tubes


def knobs(robot: Robot) -> tuple[Knob, ...]:
    """Curvature and lengths of every tube, each from 0 to twice its value."""
    name = {EccentricRobot: "all tubes", SegmentedEccentricRobot: "segment"}.get(type(robot), "tube")
    out = []
    for k, tube in enumerate(parts(robot)):
        for label, field, unit, factor, step in FIELDS:
            value = getattr(tube, field) * factor
            high = max(2 * abs(value), 10 * step)
            if tube.general and field == "curved_length":
                continue  # it is the sum of the pieces
            # Pieces keep their direction of bending only if they stay curved.
            low = step if tube.general and field == "curvature" else min(0.0, 2 * value)
            owner = name if name == "all tubes" else f"{name} {k + 1}"
            out.append(Knob(f"{owner}: {label} ({unit})", k, field, factor, low, high, step))
    return tuple(out)


def with_knob(robot: Robot, knob: Knob, value: float) -> Robot:
    """Robot with one dimension changed to `value`, in the knob's unit.

    Raises:
        InputError: a value out of the knob's range, or tubes that no longer fit together.
    """
    number = finite(knob.label, value)
    if not knob.low - 1e-9 <= number <= knob.high + 1e-9:
        raise InputError(f"{knob.label} is {number:g}; it must be from {knob.low:g} to {knob.high:g}")
    changed: dict[str, Any] = {knob.field: number / knob.factor}
    tubes = list(parts(robot))
    tubes[knob.index] = replace(tubes[knob.index], **changed)
    if isinstance(robot, EccentricRobot):
        return replace(robot, tube=tubes[0])
    if isinstance(robot, SegmentedEccentricRobot):
        return replace(robot, segments=tuple(tubes))
    if isinstance(robot, ConcentricRobot | BundleRobot):
        return replace(robot, tubes=tuple(tubes))
    raise InputError(f"the tubes of a {type(robot).__name__} cannot be changed here")


GIVEN_GRAVITY = "as given"

EFFECT = '<div data-testid="load-limit" style="font:12px sans-serif;padding:2px 10px 6px">{}</div>'


class PushPanel:
    """Widgets of a load.

    Args:
        gui: `gui` of a client of a viser server.
        tab: receives the commands.
        numbers: reads number boxes; returns None, after a message, if one has no number.
        button: makes a button.
        check: makes a check box.
        initial: load at the start, if any; its gravity is among the choices.
    """

    def __init__(
        self,
        gui: Any,
        tab: Commands,
        numbers: Callable[[list[Any]], Array | None],
        button: Callable[..., Any],
        check: Callable[..., Any],
        initial: Load | None = None,
    ) -> None:
        gravity = None if initial is None else initial.gravity
        self._tab, self._choices = tab, DIRECTIONS if gravity is None else {**DIRECTIONS, GIVEN_GRAVITY: gravity}
        self._effect = gui.add_html(EFFECT.format(""))
        self._shown: tuple[float, ...] = (0.0, 0.0, 0.0)
        hint = "Drag the arrows at the head of the force on the tip."
        check("drag a force", False, partial(tab.show, "force"), hint=hint)
        self._boxes = [gui.add_text(f"force {axis} (mN)", "0") for axis in "xyz"]
        self._gravity = gui.add_dropdown("gravity", tuple(self._choices))
        self._gravity.value = GIVEN_GRAVITY if gravity else "none"

        def put_on() -> None:
            force = numbers(self._boxes)
            if force is not None:
                self.push(force / TO_MILLI, released=True)

        def take_off() -> None:
            self._gravity.value = "none"
            self.push(np.zeros(3), released=True)

        button("Put the load on", put_on)
        button("Take the load off", take_off)

    def push(self, force: Array, *, released: bool) -> None:
        """Apply a force (3,) at the tip, N, with the selected gravity; released: True at the end of a drag."""
        load = Load(tuple(force.tolist()), gravity=self._choices[self._gravity.value])
        self._tab.change(lambda session: push_on(session, load), dragged=None if released else "push")

    def show(self, load: Load | None) -> None:
        """Write the force into the boxes if it differs from the last one written, since the user may be typing."""
        force = (0.0, 0.0, 0.0) if load is None else load.force
        if force != self._shown:
            self._shown = force
            for box, value in zip(self._boxes, force, strict=True):
                box.value = typed(value * TO_MILLI, 4)

    def report(self, effect: str) -> None:
        """Show the effect of the load, as text."""
        self._effect.content = EFFECT.format(escape(effect))


class ForceArrow:
    """Arrow of a force on the tip of a robot; the user can drag it if it has `controls`."""

    def __init__(self, api: Any, scene: ViewerScene, controls: PushPanel | None, view: View) -> None:
        self._scene, self._controls, self._view = scene, controls, view
        self._head = Mark(api, "head", self._drawn)
        self._tip = np.zeros(3)

    def mark(self, equilibrium: Equilibrium, on: bool) -> None:
        """Show or hide the marks at the head of the arrow."""
        if self._controls is not None:
            self._head.put(head_of(equilibrium, self._newtons_per_metre), equilibrium.robot, on)

    def show(self, equilibrium: Equilibrium, *, dragged: bool) -> None:
        """Draw the force; the marks follow its head, unless they are being dragged."""
        self._tip = equilibrium.tip_position
        if equilibrium.load is None and not self._head.visible:
            self._scene.show_force(self._tip, self._tip)
            return
        head = head_of(equilibrium, self._newtons_per_metre)
        self._scene.show_force(self._tip, head)
        if not dragged:
            self._head.follow(head)

    def _drawn(self, head: Array, released: bool) -> None:
        assert self._controls is not None
        self._controls.push(self._newtons_per_metre * (head - self._tip), released=released)

    @cached_property
    def _newtons_per_metre(self) -> float:
        """Force per length of its arrow, N/m, by the compliance of the robot at the start."""
        return newtons_per_metre(self._view.session().equilibrium)


STEP = 0.1
"""Step of the sliders of joints, deg or mm."""

EXACT = 6
"""Decimals in the boxes for exact values, deg or mm."""

MIRROR = "mirror"
"""Name of the dragged control for the sliders of direction and separation."""

MAX_TURN = 720.0
"""Largest rotation of a slider, deg, also if the limits are wider."""

OBLIQUE = "a direction"
"""Name of planes that are not across an axis."""

PAD = '<div style="font:12px sans-serif;padding:0 10px 6px;opacity:.75">{}</div>'


class Panel:
    """Widgets of one client, made by its `gui` of viser; `tab` receives the commands."""

    def __init__(self, gui: Any, tab: Commands, view: View) -> None:
        self._gui, self._tab, self._view = gui, tab, view
        self._shown: dict[int, float] = {}
        self._shown_targets: dict[int, str] = {}
        self._user_set: set[int] = set()
        self._layers: dict[str, Any] = {}
        robot = view.robot
        gui.set_panel_label(robot.name or "robot")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(390)
        self._readout = gui.add_html("")
        self._message = gui.add_html(message_text(""))
        self._keys = gui.add_html("")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Joints"):
            self._sliders = [self._slider(k, name) for k, name in enumerate(space_of(robot).names)]
            self._button("Home", lambda: tab.change(go_home))
            self._button("Undo", tab.undo)
            self._button("All equilibria", tab.ghosts)
            self._mirror = self._mirror_sliders() if isinstance(robot, EccentricRobot) else []
            self._boxes = self._exact()
        with tabs.add_tab("Tip"):
            self._margin, self._targets = self._tip_controls(view.min_margin)
        self.push: PushPanel | None = None
        if not (robot.fixed_sections and robot.assembly(robot.home_translations).eccentric):
            with tabs.add_tab("Load"):
                self.push = PushPanel(gui, tab, self._numbers, self._button, self._check, view.load)
        with tabs.add_tab("Play"):
            self._time = self._play_controls()
        with tabs.add_tab("Design"):
            self._knobs = self._design_controls()
        with tabs.add_tab("Layers"):
            self._layer_controls()
        with tabs.add_tab("Save"):
            self._save_controls()
        with gui.add_folder("What happened"):
            self._log = gui.add_html(log_text(()))
        plots = gui.add_panel()
        with plots.add_tab("Plots"):
            self._plots = {name: gui.add_html("") for name in ("torsion", "curve", "map")}
        plots.dock_left()
        plots.set_width(340)

    # --- output ------------------------------------------------------------------------------------------------------

    @property
    def min_margin(self) -> float:
        """Smallest margin during motions of the tip."""
        return float(self._margin.value)

    def say(self, text: str, *, bad: bool = False) -> None:
        """Show a message below the readout."""
        self._message.content = message_text(text, bad=bad)

    def show_keys(self, token: str | None) -> None:
        """Let the script of the page move the tip by its token; None: no longer."""
        self._keys.content = "" if token is None else keys_text(token, KEYS)

    def show(self, session: Session, certificate: float | None, torsion: str | None) -> None:
        """Show readout, log, load, and the plot of torsion unless it is None."""
        self._readout.content = readout(session, certificate)
        self._log.content = log_text(session.log)
        if torsion is not None:
            self.plot("torsion", torsion)
        if self.push is not None:
            self.push.show(session.equilibrium.load)

    def plot(self, name: str, content: str, *, text: bool = False) -> None:
        """Show a plot, "torsion", "curve" or "map", or the reason why there is none; text: `content` is no HTML."""
        self._plots[name].content = PAD.format(escape(content)) if text else content

    def sync(self, session: Session, dragged: int | str | None = None, *, refused: bool = False) -> None:
        """Set sliders and boxes to the state of the robot, except the slider of the `dragged` joint.

        Refused values stay in the boxes, so that the user can correct them.
        """
        factor, low, high = _slider_range(session.robot)
        for k, (slider, value) in enumerate(zip(self._sliders, session.q * factor, strict=True)):
            shown = min(low[k], round(value, 1)), max(high[k], round(value, 1))
            if (slider.min, slider.max) != shown:
                slider.min, slider.max = shown
            if k != dragged or not self._is_users(slider):
                self._put(slider, round(float(value), 1))
        if self._mirror:
            self._sync_mirror(np.degrees(session.equilibrium.rotations), dragged=dragged == MIRROR)
        # All tubes, also those that share a joint: exact values may differ within a joint.
        values = [*np.degrees(session.equilibrium.rotations), *(session.equilibrium.translations * TO_MM)]
        for box, value in zip(self._boxes, values, strict=True):
            if not refused:
                box.value = typed(value, EXACT)
        for knob, slider in self._knobs:
            self._put(slider, round(knob.shown(session.robot), 4))
        for box, value in zip(self._targets, session.equilibrium.tip_position * TO_MM, strict=True):
            if box.value == self._shown_targets.get(id(box), "0"):  # nobody has typed a target
                box.value = self._shown_targets[id(box)] = typed(value, 3)

    def _sync_mirror(self, rotations: np.ndarray, *, dragged: bool) -> None:
        """Set the sliders of direction and separation, if the rotations satisfy the mirror law."""
        direction, ahead, behind = rotations
        separation = (ahead - behind) / 2
        # Mirror law (thesis, eq. 3.51): the other tubes turn by +d and -d from the middle one.
        if abs(ahead + behind - 2 * direction) < STEP and -STEP / 2 < separation < self._mirror[1].max + STEP / 2:
            for slider, value in zip(self._mirror, (direction, max(separation, 0.0)), strict=True):
                if not dragged or not self._is_users(slider):
                    self._put(slider, round(float(value), 1))

    def tick(self, *layers: str, on: bool = True) -> None:
        """Set the check boxes of layers; viser then calls their handlers as for a click."""
        for layer in layers:
            self._layers[layer].value = on

    def offer_playback(self, duration: float) -> None:
        """Enable the controls for a trajectory of a duration, s."""
        self._time.max = max(round(duration, 3), 0.01)
        self._time.disabled = False
        self.at_time(0.0)

    def at_time(self, seconds: float) -> None:
        """Set the slider of the time, s."""
        self._put(self._time, round(seconds, 3))

    def _put(self, widget: Any, value: float) -> None:
        """Set a widget unless it has the value already, so that no user event is sent."""
        if self._shown.get(id(widget)) != value:
            self._user_set.discard(id(widget))
            self._shown[id(widget)] = value
            widget.value = value

    def _is_users(self, widget: Any) -> bool:
        """True if a widget still has the value that the user gave: a trajectory may have changed it."""
        return id(widget) in self._user_set

    def _from_user(self, event: Any) -> bool:
        """True for an event from the user; False if the program set the value."""
        # viser reports values set by the program too; taken for commands, they would move the robot in a loop.
        difference = abs(event.target.value - self._shown.get(id(event.target), np.inf))
        if event.client is None or not difference > 1e-6:
            return False
        self._shown[id(event.target)] = event.target.value
        self._user_set.add(id(event.target))
        return True

    # --- widgets -----------------------------------------------------------------------------------------------------

    def _slider(self, joint: int, name: str) -> Any:
        factor, low, high = (float(each[joint]) for each in _slider_range(self._view.robot))
        unit = "deg" if joint < self._view.robot.n_tubes else "mm"
        slider = self._gui.add_slider(
            f"{name} ({unit})", low, max(high, low + STEP), STEP, min(max(0.0, low), high), marks=()
        )
        change = self._tab.change
        return self._when_moved(slider, lambda at: change(lambda s: move_joint(s, joint, at / factor), dragged=joint))

    def _when_moved(self, widget: Any, act: Callable[[float], None]) -> Any:
        """Register `act` to be called with the value of a slider when the user moves it."""

        async def moved(event: Any) -> None:
            if self._from_user(event):
                act(float(event.target.value))

        widget.on_update(moved)
        return widget

    def _button(self, label: str, act: Callable[[], object]) -> None:
        async def pressed(_: Any) -> None:
            act()

        self._gui.add_button(label).on_click(pressed)

    def _mirror_sliders(self) -> list[Any]:
        with self._gui.add_folder("Direction and separation"):
            direction = self._gui.add_slider("direction (deg)", -360.0, 360.0, STEP, 0.0, marks=())
            separation = self._gui.add_slider("separation (deg)", 0.0, 120.0, STEP, 0.0, marks=())

        def go(_: float) -> None:
            rotations = mirror_rotations(float(np.radians(direction.value)), float(np.radians(separation.value)))
            self._tab.change(lambda session: move(session, rotations, session.equilibrium.translations), dragged=MIRROR)

        return [self._when_moved(slider, go) for slider in (direction, separation)]

    def _exact(self) -> list[Any]:
        """Number boxes for the joint values of every tube; a button moves the robot there on a straight path."""
        robot = self._view.robot
        n = robot.n_tubes
        labels = [f"rotation {i + 1} (deg)" for i in range(n)] + [f"translation {i + 1} (mm)" for i in range(n)]
        with self._gui.add_folder("Exact values", expand_by_default=False):
            boxes = [self._gui.add_text(label, "0") for label in labels]

            def go() -> None:
                values = self._numbers(boxes)
                if values is not None:
                    self._tab.change(lambda session: move(session, np.radians(values[:n]), values[n:] / TO_MM))

            self._button("Move there", go)
        return boxes

    def _numbers(self, boxes: Sequence[Any]) -> np.ndarray | None:
        """Numbers in text boxes; None and a message if one is no number."""
        numbers = [parse_number(box.value) for box in boxes]
        for box, number in zip(boxes, numbers, strict=True):
            if isinstance(number, str) or not number.is_finite():
                self.say(f"{box.label} is {box.value!r}; it must be a number", bad=True)
                return None
        return np.array([float(number) for number in numbers])

    def _tip_controls(self, min_margin: float) -> tuple[Any, list[Any]]:
        """Slider of the smallest margin, and boxes of the target."""
        margin = self._gui.add_slider("least margin", 0.0, 0.9, 0.01, min(max(min_margin, 0.0), 0.9), marks=())
        self._check(
            "drag the tip", False, partial(self._tab.show, "target"), hint="Drag the arrows at the tip to move it."
        )
        self._check("move the tip by keys, gamepad or 3-D mouse", False, partial(self._tab.show, "hand"))
        boxes = [self._gui.add_text(f"target {axis} (mm)", "0") for axis in "xyz"]

        def go() -> None:
            values = self._numbers(boxes)
            if values is not None:
                self._tab.move_tip(values / TO_MM, released=True)

        self._button("Move the tip there", go)
        return margin, boxes

    def _play_controls(self) -> Any:
        time = self._gui.add_slider("time (s)", 0.0, 1.0, 0.001, 0.0, marks=(), disabled=True)
        self._when_moved(time, self._tab.scrub)
        self._button("Play / pause", self._tab.play)
        self._upload("Load a trajectory (CSV)", "trajectory", "text/csv")
        change = self._tab.change
        self._check("record what the robot passes", False, lambda on: change(lambda s: record(s, on), pause=False))
        self._button("Replay the recording", self._tab.replay)
        return time

    def _upload(self, label: str, what: str, mime_type: str) -> None:
        button = self._gui.add_upload_button(label, mime_type=mime_type)

        async def loaded(event: Any) -> None:
            self._tab.load(what, event.target.value.name, event.target.value.content)

        button.on_upload(loaded)

    def _check(self, label: str, value: bool, act: Callable[[bool], None], **options: Any) -> Any:
        box = self._gui.add_checkbox(label, value, **options)

        async def changed(event: Any) -> None:
            act(bool(event.target.value))

        box.on_update(changed)
        return box

    def _design_controls(self) -> list[tuple[Knob, Any]]:
        change, robot, out = self._tab.change, self._view.robot, []
        for knob in knobs(robot):
            value = knob.shown(robot)
            slider = self._gui.add_slider(knob.label, knob.low, knob.high, knob.step, value, marks=())
            self._shown[id(slider)] = round(value, 4)

            # The default binds the knob of this round; a closure would see the last one.
            def change_value(value: float, knob: Knob = knob) -> None:
                change(lambda session: redesign(session, with_knob(session.robot, knob, value)), key=knob.label)

            out.append((knob, self._when_moved(slider, change_value)))
        self._check("stability map", False, partial(self._tab.show, "map"))
        self._button("Back to the robot as loaded", lambda: change(lambda session: redesign(session, robot)))
        self._button("Save robot as YAML", partial(self._tab.save, "robot"))
        return out

    def _layer_controls(self) -> None:
        layers = [
            ("trail of the tip", "trail", True),
            ("workspace, by margin", "workspace", False),
            ("obstacles", "obstacles", bool(self._view.obstacles)),
            ("volume swept by the trajectory", "swept", False),
            ("the robot beside", "beside", False),
        ]
        for label, layer, on in layers:
            self._layers[layer] = self._check(label, on, partial(self._tab.show, layer))
        self._button("Forget the trail", lambda: self._tab.change(clear_trail, pause=False))
        self._upload("Load bodies (YAML, mesh, image)", "obstacles", BODIES)
        self._cut_controls()
        self._upload("Put another robot beside (YAML)", "beside", YAML)
        theme = partial(self._gui.configure_theme, show_share_button=False, show_logo=False)
        self._check("dark", False, lambda on: theme(dark_mode=on))
        for label, side in (
            ("From x", "side"),
            ("From y", "front"),
            ("From above", "above"),
            ("As it began", "corner"),
        ):
            self._button(label, partial(self._tab.look, side))
        self._gui.add_html(legend())

    def _cut_controls(self) -> None:
        """Controls of a plane that cuts the bodies."""
        reach = round(1.5 * TO_MM * max(tube.length for tube in self._view.robot.tubes))
        across = self._gui.add_dropdown("cut bodies across", ("nothing", *ACROSS, OBLIQUE))
        oblique = self._gui.add_vector3(OBLIQUE, (1.0, 1.0, 0.0), step=0.05, visible=False)
        at = self._gui.add_slider("cut at (mm)", -reach, reach, 0.5, 0.0, marks=())

        async def changed(_: Any) -> None:
            oblique.visible = across.value == OBLIQUE
            normal = np.array(ACROSS.get(across.value, oblique.value if oblique.visible else (0, 0, 0)), dtype=float)
            length = float(np.linalg.norm(normal))
            # The point of the plane nearest to the origin: the distance along the unit normal.
            self._tab.cut(Plane(float(at.value) / TO_MM * normal / length, normal) if length else None)

        across.on_update(changed)
        oblique.on_update(changed)
        at.on_update(changed)

    def _save_controls(self) -> None:
        for label, what in (
            ("Picture (PNG)", "picture"),
            ("Joint values (YAML)", "joints"),
            ("Robot (YAML)", "robot"),
            ("Recorded trajectory (CSV)", "recording"),
            ("Page for a colleague (HTML)", "page"),
        ):
            self._button(label, partial(self._tab.save, what))


class SliderRange(NamedTuple):
    """Ranges of the sliders of all joints (m,), deg or mm."""

    factor: np.ndarray
    """Factors from SI to deg or mm."""
    low: np.ndarray
    high: np.ndarray


def _slider_range(robot: Robot) -> SliderRange:
    """Ranges of the sliders, in whole steps; rotations up to `MAX_TURN`."""
    space = space_of(robot)
    turns = np.arange(len(space.lower)) < robot.n_tubes
    # Rotations may be unlimited, and a slider needs ends.
    factor, bound = np.where(turns, np.degrees(1.0), TO_MM), np.where(turns, MAX_TURN, np.inf)
    low, high = (np.round(np.clip(ends * factor, -bound, bound), 1) for ends in (space.lower, space.upper))
    return SliderRange(factor, low, high)

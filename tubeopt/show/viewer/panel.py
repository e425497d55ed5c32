"""The panel of controls beside the scene: joints, targets, loads, designs."""

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
from ...robots.eccentric import EccentricRobot, SegmentedEccentricRobot
from ...robots.load import Load
from ...robots.robot import Robot
from ...robots.tubes import Tube
from ...typing import Array
from .overlays import ACROSS
from .scene import Mark, Scene
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
from .words import Wishes, hand_words, legend, log_words, message_words, readout, typed

FIELDS = (
    ("curvature", "curvature", "1/m", 1.0, 0.1),
    ("curved length", "curved_length", "mm", TO_MM, 1.0),
    ("straight length", "straight_length", "mm", TO_MM, 1.0),
)
"""Shown properties of a tube: name, field, unit, factor to SI, and step of the slider."""


@dataclass(frozen=True)
class Knob:
    """One dimension of one tube (or of the equal tubes of a segment), from `low` to `high` by `step`."""

    label: str
    place: int
    """Index in `parts`."""
    field: str
    """Field of `Tube`."""
    factor: float
    """Factor from SI to the unit of the label and of the limits."""
    low: float
    high: float
    step: float

    def shown(self, robot: Robot) -> float:
        """Its value, in the unit of the label."""
        return float(getattr(parts(robot)[self.place], self.field)) * self.factor


def parts(robot: Robot) -> tuple[Tube, ...]:
    """The tubes that can be chosen on their own: all, the one that all three are, or one per segment."""
    if isinstance(robot, EccentricRobot):
        return (robot.tube,)
    if isinstance(robot, SegmentedEccentricRobot):
        return robot.segments
    return robot.tubes


def knobs(robot: Robot) -> tuple[Knob, ...]:
    """Curvature and lengths of every tube, each from nothing to twice what it is."""
    name = {EccentricRobot: "all tubes", SegmentedEccentricRobot: "segment"}.get(type(robot), "tube")
    out = []
    for k, tube in enumerate(parts(robot)):
        for label, field, unit, factor, step in FIELDS:
            value = getattr(tube, field) * factor
            most = max(2 * abs(value), 10 * step)
            if tube.general and field == "curved_length":
                continue  # it is the sum of the pieces
            # Pieces that were bent straight would not know which way to bend.
            low = step if tube.general and field == "curvature" else min(0.0, 2 * value)
            which = name if name == "all tubes" else f"{name} {k + 1}"
            out.append(Knob(f"{which}: {label} ({unit})", k, field, factor, low, most, step))
    return tuple(out)


def with_knob(robot: Robot, knob: Knob, value: float) -> Robot:
    """The robot with one dimension changed to `value`, in the knob's unit.

    Raises:
        InputError: a value out of the knob's range, or tubes that no longer fit together.
    """
    number = finite(knob.label, value)
    if not knob.low - 1e-9 <= number <= knob.high + 1e-9:
        raise InputError(f"{knob.label} is {number:g}; it must be from {knob.low:g} to {knob.high:g}")
    changed: dict[str, Any] = {knob.field: number / knob.factor}
    tubes = list(parts(robot))
    tubes[knob.place] = replace(tubes[knob.place], **changed)
    if isinstance(robot, EccentricRobot):
        return replace(robot, tube=tubes[0])
    if isinstance(robot, SegmentedEccentricRobot):
        return replace(robot, segments=tuple(tubes))
    if isinstance(robot, ConcentricRobot):
        return replace(robot, tubes=tuple(tubes))
    raise InputError(f"the tubes of a {type(robot).__name__} cannot be changed here")


GIVEN = "as given"

WORDS = '<div data-testid="load-limit" style="font:12px sans-serif;padding:2px 10px 6px">{}</div>'


class PushPanel:
    """The widgets of a load.

    Args:
        gui: `gui` of a client of a viser server.
        tab: told of what is wanted.
        numbers: reads number boxes; None, with a sentence, where one holds no number.
        make: makes a button, and a box to be ticked.
        given: that acts from the beginning, if any: its gravity is among the choices.
    """

    def __init__(
        self,
        gui: Any,
        tab: Wishes,
        numbers: Callable[[list[Any]], Array | None],
        make: tuple[Callable[..., Any], Callable[..., Any]],
        given: Load | None = None,
    ) -> None:
        own = None if given is None else given.gravity
        self._tab, self._choices = tab, DIRECTIONS if own is None else {**DIRECTIONS, GIVEN: own}
        self._words = gui.add_html(WORDS.format(""))
        self._shown: tuple[float, ...] = (0.0, 0.0, 0.0)
        button, check = make
        hint = "Drag the arrows at the head of the force on the tip."
        check("drag a force", False, partial(tab.show, "force"), hint=hint)
        self._boxes = [gui.add_text(f"force {axis} (mN)", "0") for axis in "xyz"]
        self._gravity = gui.add_dropdown("gravity", tuple(self._choices))
        self._gravity.value = GIVEN if own else "none"

        def put_on() -> None:
            force = numbers(self._boxes)
            if force is not None:
                self.push(force / TO_MILLI, done=True)

        def take_off() -> None:
            self._gravity.value = "none"
            self.push(np.zeros(3), done=True)

        button("Put the load on", put_on)
        button("Take the load off", take_off)

    def push(self, force: Array, *, done: bool) -> None:
        """Let a force act on the tip, N, with the gravity that is chosen; `done` where the hand has let go of it."""
        load = Load(tuple(force.tolist()), gravity=self._choices[self._gravity.value])
        self._tab.change(lambda session: push_on(session, load), held=None if done else "push")

    def show(self, load: Load | None) -> None:
        """The force that acts, in the boxes, unless it is what they were last told."""
        force = (0.0, 0.0, 0.0) if load is None else load.force
        if force != self._shown:
            self._shown = force
            for box, value in zip(self._boxes, force, strict=True):
                box.value = typed(value * TO_MILLI, 4)

    def tell(self, words: str) -> None:
        """Show the effect of the load in a sentence."""
        self._words.content = WORDS.format(escape(words))


class ForceArrow:
    """Force on the tip of a robot as an arrow, which can be dragged if there are `controls`."""

    def __init__(self, api: Any, scene: Scene, controls: PushPanel | None, view: View) -> None:
        self._scene, self._controls, self._view = scene, controls, view
        self._head = Mark(api, "head", self._drawn)
        self._tip = np.zeros(3)

    def mark(self, equilibrium: Equilibrium, on: bool) -> None:
        """Put marks at the head of the arrow, or take them away."""
        if self._controls is not None:
            self._head.put(head_of(equilibrium, self._newtons_per_metre), equilibrium.robot, on)

    def show(self, equilibrium: Equilibrium, *, held: bool) -> None:
        """Draw the force that acts; the marks go to its head, unless the hand has them."""
        self._tip = equilibrium.tip_position
        if equilibrium.load is None and not self._head.there:
            self._scene.show_force(self._tip, self._tip)
            return
        head = head_of(equilibrium, self._newtons_per_metre)
        self._scene.show_force(self._tip, head)
        if not held:
            self._head.follow(head)

    def _drawn(self, head: Array, done: bool) -> None:
        assert self._controls is not None
        self._controls.push(self._newtons_per_metre * (head - self._tip), done=done)

    @cached_property
    def _newtons_per_metre(self) -> float:
        """Force per length of its arrow, N/m, by the compliance of the robot at the start."""
        return newtons_per_metre(self._view.session().equilibrium)


STEP = 0.1
"""Step of the sliders of joints, deg or mm."""

EXACT = 6
"""Digits behind the point in the boxes for exact values, deg or mm."""

MIRROR = "mirror"
"""Stands for the joint that is dragged where it is the direction or the separation."""

LONGEST_TURN = 720.0
"""Sliders reach no farther (deg) where limits do."""

OBLIQUE = "a direction"
"""Name of planes that are not across an axis."""

PAD = '<div style="font:12px sans-serif;padding:0 10px 6px;opacity:.75">{}</div>'


class Panel:
    """The widgets of one client, made by its `gui` of viser; `tab` is told of everything that is wanted."""

    def __init__(self, gui: Any, tab: Wishes, view: View) -> None:
        self._gui, self._tab, self._view = gui, tab, view
        self._shown: dict[int, float] = {}
        self._aimed: dict[int, str] = {}
        self._in_hand: set[int] = set()
        self._layers: dict[str, Any] = {}
        robot = view.robot
        gui.set_panel_label(robot.name or "robot")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(390)
        self._readout = gui.add_html("")
        self._message = gui.add_html(message_words(""))
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
            self._margin, self._targets = self._lead_controls(view.min_margin)
        self.push: PushPanel | None = None
        if not robot.assembly(robot.home_translations).eccentric:
            with tabs.add_tab("Load"):
                self.push = PushPanel(gui, tab, self._numbers, (self._button, self._check), view.load)
        with tabs.add_tab("Play"):
            self._time = self._play_controls()
        with tabs.add_tab("Design"):
            self._knobs = self._design_controls()
        with tabs.add_tab("Layers"):
            self._layer_controls()
        with tabs.add_tab("Save"):
            self._save_controls()
        with gui.add_folder("What happened"):
            self._log = gui.add_html(log_words(()))
        plots = gui.add_panel()
        with plots.add_tab("Plots"):
            self._plots = {name: gui.add_html("") for name in ("torsion", "curve", "map")}
        plots.dock_left()
        plots.set_width(340)

    # --- shown -------------------------------------------------------------------------------------------------------

    @property
    def least_margin(self) -> float:
        """Smallest margin during motions of the tip."""
        return float(self._margin.value)

    def say(self, text: str, *, bad: bool = False) -> None:
        """One sentence below the readout."""
        self._message.content = message_words(text, bad=bad)

    def lend(self, word: str | None) -> None:
        """Let the script of the page move the tip, or no longer (None)."""
        self._keys.content = "" if word is None else hand_words(word, KEYS)

    def show(self, session: Session, certificate: float | None, torsion: str | None) -> None:
        """The readout and the log; with the plot of torsion where it is given."""
        self._readout.content = readout(session, certificate)
        self._log.content = log_words(session.log)
        if torsion is not None:
            self.plot("torsion", torsion)
        if self.push is not None:
            self.push.show(session.equilibrium.load)

    def plot(self, name: str, content: str, *, text: bool = False) -> None:
        """A plot of "torsion", the "curve" or the "map", or why there is none."""
        self._plots[name].content = PAD.format(escape(content)) if text else content

    def sync(self, session: Session, dragged: int | str | None = None, *, refused: bool = False) -> None:
        """Bring sliders and boxes to where the robot is; not the slider of the joint that is being `dragged`.

        What was refused stays in the boxes, to be corrected there.
        """
        factor, low, high = _slider_range(session.robot)
        for k, (slider, value) in enumerate(zip(self._sliders, session.q * factor, strict=True)):
            shown = min(low[k], round(value, 1)), max(high[k], round(value, 1))
            if (slider.min, slider.max) != shown:
                slider.min, slider.max = shown
            if k != dragged or not self._held(slider):
                self._put(slider, round(float(value), 1))
        if self._mirror:
            self._sync_mirror(np.degrees(session.equilibrium.rotations), dragged=dragged == MIRROR)
        # All tubes, also those that share a joint: exact values may break what sliders keep.
        values = [*np.degrees(session.equilibrium.rotations), *(session.equilibrium.translations * TO_MM)]
        for box, value in zip(self._boxes, values, strict=True):
            if not refused:
                box.value = typed(value, EXACT)
        for knob, slider in self._knobs:
            self._put(slider, round(knob.shown(session.robot), 4))
        for box, value in zip(self._targets, session.equilibrium.tip_position * TO_MM, strict=True):
            if box.value == self._aimed.get(id(box), "0"):  # nobody has typed a target
                box.value = self._aimed[id(box)] = typed(value, 3)

    def _sync_mirror(self, rotations: np.ndarray, *, dragged: bool) -> None:
        """Direction and separation where the tubes keep the mirror law; elsewhere there are none to be shown."""
        direction, ahead, behind = rotations
        separation = (ahead - behind) / 2
        # Mirror law (thesis, eq. 3.51): the other tubes turn by +d and -d from the middle one.
        if abs(ahead + behind - 2 * direction) < STEP and -STEP / 2 < separation < self._mirror[1].max + STEP / 2:
            for slider, value in zip(self._mirror, (direction, max(separation, 0.0)), strict=True):
                if not dragged or not self._held(slider):
                    self._put(slider, round(float(value), 1))

    def tick(self, *layers: str, on: bool = True) -> None:
        """Layers are shown, or no more, as a click would have it."""
        for layer in layers:
            self._layers[layer].value = on

    def offer_playback(self, duration: float) -> None:
        """There is a trajectory of this length, s."""
        self._time.max = max(round(duration, 3), 0.01)
        self._time.disabled = False
        self.at_time(0.0)

    def at_time(self, seconds: float) -> None:
        """The time of the trajectory that is shown."""
        self._put(self._time, round(seconds, 3))

    def _put(self, widget: Any, value: float) -> None:
        """Set a widget without taking it for a wish of the user; what shows it already is left to the hand."""
        if self._shown.get(id(widget)) != value:
            self._in_hand.discard(id(widget))
            self._shown[id(widget)] = value
            widget.value = value

    def _held(self, widget: Any) -> bool:
        """True if a widget still shows the user's value: a trajectory may have changed it."""
        return id(widget) in self._in_hand

    def _wished(self, event: Any) -> bool:
        """True if an event is a user's, and no echo of a value set by the program."""
        # viser reports values set by the program too; taken for wishes, they would move the robot in a loop.
        wish = event.client is not None and abs(event.target.value - self._shown.get(id(event.target), np.inf)) > 1e-6
        if wish:
            self._shown[id(event.target)] = event.target.value
            self._in_hand.add(id(event.target))
        return bool(wish)

    # --- built -------------------------------------------------------------------------------------------------------

    def _slider(self, joint: int, name: str) -> Any:
        factor, low, high = (float(each[joint]) for each in _slider_range(self._view.robot))
        unit = "deg" if joint < self._view.robot.n_tubes else "mm"
        slider = self._gui.add_slider(
            f"{name} ({unit})", low, max(high, low + STEP), STEP, min(max(0.0, low), high), marks=()
        )
        change = self._tab.change
        return self._when_moved(slider, lambda at: change(lambda s: move_joint(s, joint, at / factor), held=joint))

    def _when_moved(self, widget: Any, act: Callable[[float], None]) -> Any:
        """Tell `act` where the hand has put a slider."""

        async def moved(event: Any) -> None:
            if self._wished(event):
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
            turned = mirror_rotations(float(np.radians(direction.value)), float(np.radians(separation.value)))
            self._tab.change(lambda session: move(session, turned, session.equilibrium.translations), held=MIRROR)

        return [self._when_moved(slider, go) for slider in (direction, separation)]

    def _exact(self) -> list[Any]:
        """Number boxes for every joint of every tube, which act when their button is pressed: the way is straight."""
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
        read = [parse_number(box.value) for box in boxes]
        for box, number in zip(boxes, read, strict=True):
            if isinstance(number, str) or not number.is_finite():
                self.say(f"{box.label} is {box.value!r}; it must be a number", bad=True)
                return None
        return np.array([float(number) for number in read])

    def _lead_controls(self, least: float) -> tuple[Any, list[Any]]:
        margin = self._gui.add_slider("least margin", 0.0, 0.9, 0.01, min(max(least, 0.0), 0.9), marks=())
        dragged = partial(self._tab.show, "target")
        self._check("drag the tip", False, dragged, hint="Drag the arrows at the tip to move it.")
        self._check("lead the tip by keys, gamepad or 3-D mouse", False, partial(self._tab.show, "hand"))
        boxes = [self._gui.add_text(f"target {axis} (mm)", "0") for axis in "xyz"]

        def lead() -> None:
            values = self._numbers(boxes)
            if values is not None:
                self._tab.lead(values / TO_MM, done=True)

        self._button("Lead the tip there", lead)
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
            def turn(at: float, knob: Knob = knob) -> None:
                change(lambda session: redesign(session, with_knob(session.robot, knob, at)), key=knob.label)

            out.append((knob, self._when_moved(slider, turn)))
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
        """A plane that cuts the bodies, and where it stands."""
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
    """Factor from SI."""
    low: np.ndarray
    high: np.ndarray


def _slider_range(robot: Robot) -> SliderRange:
    """Ranges of the sliders, in whole steps; rotations up to `LONGEST_TURN`."""
    space = space_of(robot)
    turns = np.arange(len(space.lower)) < robot.n_tubes
    # Rotations may be unlimited, and a slider needs ends.
    factor, most = np.where(turns, np.degrees(1.0), TO_MM), np.where(turns, LONGEST_TURN, np.inf)
    low, high = (np.round(np.clip(ends * factor, -most, most), 1) for ends in (space.lower, space.upper))
    return SliderRange(factor, low, high)

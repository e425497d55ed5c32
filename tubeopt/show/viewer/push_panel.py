"""A load in the hand: a force on the tip, drawn as an arrow or typed, and gravity."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property, partial
from html import escape
from typing import Any

import numpy as np

from ...equilibrium.result import Equilibrium
from ...files.units import TO_MILLI
from ...robots.load import Load
from ...typing import Array
from .commands import Wishes
from .external_load import DIRECTIONS, head_of, newtons_per_metre, push_on
from .scene import Mark, Scene
from .view import View
from .words import typed

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
        """What the load does, in a sentence."""
        self._words.content = WORDS.format(escape(words))


class ForceArrow:
    """The force on the tip of a robot as an arrow, whose head may be dragged; without `controls` it is but shown."""

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
        """By how soft the robot is where the view begins."""
        return newtons_per_metre(self._view.session().equilibrium)

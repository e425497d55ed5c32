"""The controls of a load: a force on the tip, drawn as an arrow or typed, and gravity."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from html import escape
from typing import Any

import numpy as np

from ...files.units import TO_MILLI
from ...robots.load import Load
from .pushing import DIRECTIONS, gravity_of
from .wishes import Wishes

GIVEN = "as given"

WORDS = '<div data-testid="bears" style="font:12px sans-serif;padding:2px 10px 6px">{}</div>'


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
        numbers: Callable[[list[Any]], np.ndarray | None],
        make: tuple[Callable[..., Any], Callable[..., Any]],
        given: Load | None = None,
    ) -> None:
        self._given = None if given is None else given.gravity
        self._words = gui.add_html(WORDS.format(""))
        self._shown: tuple[float, ...] = (0.0, 0.0, 0.0)
        button, check = make
        hint = "Arrows at the head of the force on the tip lead it."
        check("drag a force", False, partial(tab.show, "force"), hint=hint)
        self._boxes = [gui.add_text(f"force {axis} (mN)", "0") for axis in "xyz"]
        self._gravity = gui.add_dropdown("gravity", (*DIRECTIONS, GIVEN)[: None if self._given else -1])
        self._gravity.value = GIVEN if self._given else "none"

        def put_on() -> None:
            force = numbers(self._boxes)
            if force is not None:
                tab.push(force / TO_MILLI, self.gravity, done=True)

        def take_off() -> None:
            self._gravity.value = "none"
            tab.push(np.zeros(3), None, done=True)

        button("Put the load on", put_on)
        button("Take the load off", take_off)

    @property
    def gravity(self) -> tuple[float, float, float] | None:
        """The acceleration that is chosen, m/s^2."""
        return self._given if self._gravity.value == GIVEN else gravity_of(self._gravity.value)

    def show(self, load: Load | None) -> None:
        """The force that acts, in the boxes, unless it is what they were last told."""
        force = (0.0, 0.0, 0.0) if load is None else load.force
        if force != self._shown:
            self._shown = force
            for box, value in zip(self._boxes, force, strict=True):
                box.value = f"{round(value * TO_MILLI, 4) + 0.0:.4f}".rstrip("0").rstrip(".")

    def tell(self, words: str) -> None:
        """What the load does, in a sentence."""
        self._words.content = WORDS.format(escape(words))

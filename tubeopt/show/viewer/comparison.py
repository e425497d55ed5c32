"""A second robot beside the first: other tubes at the same joint values, with a history of their own."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError, SolveError
from ...robots.robot import Robot
from ..arm_surfaces import plate_part, plate_radius
from .scene import SCALE, Scene
from .session import Session, move, open_session

ASIDE = 0.45
"""How far it stands to the side, as a share of the longer arm."""

PLACE = "/beside"


def session_beside(robot: Robot, first: Session) -> Session:
    """A session of a robot that can stand beside the one of `first`, at home.

    Raises:
        InputError: another number of tubes.
        SolveError: it has no stable equilibrium at home.
    """
    if robot.n_tubes != first.robot.n_tubes:
        raise InputError(
            f"{robot.name or 'the robot'} has {robot.n_tubes} tubes; it must have {first.robot.n_tubes}: both are "
            "moved by the same joint values"
        )
    return open_session(robot)


class Beside:
    """A robot of `session_beside` that follows the joint values of the first, with a label that says how it is."""

    def __init__(self, api: Any, session: Session, first: Session) -> None:
        self.session = session
        long = max(float(each.equilibrium.arc_length[-1]) for each in (session, first))
        # To the right of who looks at the first one from where the camera begins.
        place = ASIDE * long * SCALE * np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
        self._frame = api.add_frame(PLACE, show_axes=False, position=tuple(place))
        self._label = api.add_label(f"{PLACE}/name", "", anchor="bottom-right")
        self._scene = Scene(api, PLACE)
        self._scene.layer(f"{PLACE[1:]}/plate", [plate_part(plate_radius(session.equilibrium))])
        self.follow(first)

    def follow(self, first: Session) -> str:
        """Go to the joint values of the first robot; returns why it stays where it was, or nothing."""
        here, words = first.equilibrium, ""
        try:
            self.session = move(self.session, here.rotations, here.translations)
        except (InputError, SolveError) as error:
            words = f"beside: {error}"
        shown = self.session.equilibrium
        self._scene.show(shown)
        self._label.text = f"{shown.robot.name or 'robot'}: {self.session.verdict}, margin {shown.margin:.3f}"
        self._label.position = tuple(shown.tip_position * SCALE)
        return words

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return bool(self._frame.visible)

    @visible.setter
    def visible(self, on: bool) -> None:
        self._frame.visible = on

    def remove(self) -> None:
        """Take it away with all that belongs to it."""
        self._frame.remove()

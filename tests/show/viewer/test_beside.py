"""Another robot beside the first: the same joint values, its own branch."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.examples import THESIS, TWO_TUBE
from tubeopt import InputError, forward_kinematics, load_robot
from tubeopt.show.viewer import move_joint, open_session
from tubeopt.show.viewer.host import titled_page
from tubeopt.show.viewer.overlays import ComparedRobot, comparison_session


class Drawn:
    """Stands for the scene of a browser: what is added is kept by its name."""

    def __init__(self) -> None:
        self.added: dict[str, Any] = {}

    def __getattr__(self, verb: str) -> Any:
        def add(name: str, *values: Any, **options: Any) -> Any:
            handle = SimpleNamespace(vertices=values[0] if values else None, **options)
            self.added[name] = handle
            return handle

        return add


def test_it_takes_the_joint_values_and_keeps_its_own_branch() -> None:
    drawn, first = Drawn(), open_session(THESIS)
    other = load_robot("configs/robots/example_equal_ends.yaml")
    beside = ComparedRobot(drawn, comparison_session(other, first), first)
    for degrees in (120.0, 230.0):
        first, _ = move_joint(first, 0, np.radians(degrees))
        assert beside.follow(first) == ""
    alone = forward_kinematics(other, np.radians([230.0, 0.0, 0.0]), start=beside.session.equilibrium)
    assert beside.session.equilibrium.tip_position == pytest.approx(alone.tip_position, abs=1e-9)
    label = drawn.added["/beside/name"]
    assert label.text == f"three equal ends: {beside.session.verdict}, margin {alone.margin:.3f}"
    assert np.linalg.norm(drawn.added["/beside"].position) > 0.5


def test_what_it_cannot_reach_is_said_and_it_stays() -> None:
    first = open_session(THESIS)
    other = load_robot("configs/robots/example_equal_ends.yaml")
    beside = ComparedRobot(Drawn(), comparison_session(other, first), first)
    first, _ = move_joint(first, 3, -0.19)
    before = beside.session
    assert beside.follow(first).startswith("beside: ")
    assert beside.session is before


def test_the_number_of_tubes_must_agree() -> None:
    with pytest.raises(InputError, match="two tubes has 2 tubes; it must have 3"):
        comparison_session(TWO_TUBE, open_session(THESIS))


def test_a_title_is_text_in_the_page() -> None:
    assert titled_page("<title>Viser</title>", "<b> CTR") == "<title>&lt;b&gt; CTR</title>"

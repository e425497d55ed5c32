"""One browser and one server for all tests of the viewer's page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt.bodies.obstacles import Sphere
from tubeopt.show.viewer import View
from tubeopt.show.viewer.view import ViewerWaypoints

from .browser import CHROMIUM, FLAGS, LITTLE_DRAWING, Tab, served


@pytest.fixture(scope="session")
def address() -> Iterator[str]:
    """The page with the robot of the thesis, a ball, and a trajectory: tube 1 once around and back in 4 s."""
    turn = np.radians([0.0, 180.0, 360.0, 180.0, 0.0])
    path = ViewerWaypoints(np.arange(5.0), turn[:, None] * [1.0, 0.0, 0.0], np.zeros((5, 3)))
    with served(View(THESIS, waypoints=path, obstacles=(Sphere((0.06, 0.0, 0.1), 0.02),))) as url:
        yield url


@pytest.fixture(scope="session")
def context(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    """A browser with a new profile, in which it keeps the page as it was compiled for the first tabs."""
    if CHROMIUM is None:
        pytest.skip("NOT TESTED: the viewer's page needs Chromium (apt-get install chromium)")
    api = pytest.importorskip("playwright.sync_api", reason="NOT TESTED: the viewer's page needs playwright")
    with api.sync_playwright() as player:
        context = player.chromium.launch_persistent_context(
            tmp_path_factory.mktemp("profile"),
            executable_path=CHROMIUM,
            args=FLAGS,
            viewport={"width": 900, "height": 620},
            device_scale_factor=0.5,
        )
        context.add_init_script(LITTLE_DRAWING)
        yield context
        context.close()


@pytest.fixture
def tab(context: Any, address: str) -> Iterator[Tab]:
    """A fresh tab, which has a robot of its own."""
    tab = Tab(context, address)
    yield tab
    tab.page.close()

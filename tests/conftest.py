"""Settings shared by all tests."""

from __future__ import annotations

import contextlib
import ctypes
import gc
import os
import sys
from collections.abc import Iterator
from pathlib import Path

# Matrices here are small: BLAS threads only wait for each other, long where every core has a worker.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import pytest
from hypothesis import HealthCheck, settings
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from tests.command_line import COLOUR, Outcome, Run
from tubeopt.cli.app import main
from tubeopt.show.page import WIDTH
from tubeopt.show.plots import scene, style
from tubeopt.show.plots.trajectory import save_film
from tubeopt.show.surfaces import Detail, plate_part, robot_parts
from tubeopt.solvers.compiled.library import cache_directory

# A solve that builds its functions first takes seconds, later ones well under a millisecond: a deadline per example
# would only measure the order of the tests.
settings.register_profile("default", deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("ci", settings.get_profile("default"), derandomize=True, print_blob=True)
settings.load_profile("ci" if os.environ.get("CI") else "default")


def listed(name: str) -> frozenset[str]:
    """The tests that a file of this folder names, one in a line; lines that begin with # are words."""
    lines = (Path(__file__).parent / name).read_text(encoding="utf-8").splitlines()
    return frozenset(line for line in lines if line and not line.startswith("#"))


SLOW = listed("slow.txt")
"""Tests that take a fifth of a second or more: left out by `python -m pytest -m "not slow"`, for everyday work."""

NIGHT = listed("night.txt")
"""Tests and single cases of tests, more of what others show already, that `.ci/night` runs: left out by day."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One more than there are processors: tests wait for browsers and other processes a fifth of their time."""
    return (os.cpu_count() or 1) + 1


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the slow tests, which are listed in one file, so that a new list is one run with `--durations=0`.

    The longest come first: at the end no worker waits for another one.
    """
    items.sort(key=lambda item: item.path.name != "test_problems.py")
    for item in items:
        name = item.nodeid.removeprefix("tests/")
        if name in NIGHT:
            item.add_marker(pytest.mark.night)
        if name.split("[")[0] in SLOW:
            item.add_marker(pytest.mark.slow)


def pytest_collection_finish() -> None:
    """Modules and tests stay to the end: to look through them for garbage, again and again, takes a twentieth of the
    time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 20, 20)


MOST_MEMORY = 1500
"""MB that a worker may hold when it begins a module; above it, what was built for other robots is forgotten."""


@pytest.fixture(scope="module", autouse=True)
def _memory() -> Iterator[None]:
    """Forget cached functions where hundreds of robots have filled the caches: no user has so many in one process."""
    yield
    statm = Path("/proc/self/statm")
    if statm.is_file() and int(statm.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") > MOST_MEMORY * 1e6:
        for name, module in list(sys.modules.items()):
            if name.startswith("tubeopt"):
                for each in list(vars(module).values()):
                    if hasattr(each, "cache_clear"):
                        each.cache_clear()
        gc.collect()
        with contextlib.suppress(AttributeError, OSError):
            ctypes.CDLL(None).malloc_trim(0)  # the C library keeps what is free otherwise


@pytest.fixture(scope="module")
def own_tables(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """A cache in which a module makes tables of its own, beside the kernels that were compiled before."""
    own, kernels = tmp_path_factory.mktemp("cache"), cache_directory() / "kernels"
    kernels.mkdir(parents=True, exist_ok=True)
    (own / "kernels").symlink_to(kernels, target_is_directory=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TUBEOPT_CACHE", str(own))
        yield


@pytest.fixture
def short_films(monkeypatch: pytest.MonkeyPatch) -> None:
    """Films of three pictures."""
    monkeypatch.setattr(
        "tubeopt.show.plots.trajectory.save_film",
        lambda path, title, count, draw: save_film(path, title, min(count, 3), draw),
    )


LAID_OUT: set[tuple[object, ...]] = set()
"""Panels of the pictures that were laid out."""


def lay_out_once(patch: pytest.MonkeyPatch) -> None:
    """Of pictures with the same panels one is laid out, which is half of what they take; the others stay as drawn."""
    execute = ConstrainedLayoutEngine.execute

    def execute_once(engine: ConstrainedLayoutEngine, figure: Figure) -> None:
        panels = (WIDTH.get(), *((axes.get_aspect(), axes.get_xlabel(), axes.get_ylabel()) for axes in figure.axes))
        if panels not in LAID_OUT:
            LAID_OUT.add(panels)
            execute(engine, figure)

    patch.setattr(ConstrainedLayoutEngine, "execute", execute_once)


def draw_quickly(patch: pytest.MonkeyPatch) -> None:
    """Pictures of a sixteenth of their points and facets, laid out once for all of a kind, with outlines for letters:
    they take a third of the time."""
    patch.setattr(style, "DPI", 50)
    patch.setitem(style.RC, "pdf.fonttype", 3)
    patch.setattr(scene, "robot_parts", lambda arm, _, window: robot_parts(arm, Detail(8, 30, even=True), window))
    patch.setattr(scene, "plate_part", lambda radius, **_: plate_part(radius, sides=32))
    lay_out_once(patch)


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the program with these arguments; pictures are not for looking at."""
    monkeypatch.setenv("COLUMNS", "80")
    draw_quickly(monkeypatch)

    def run_main(*arguments: str) -> Outcome:
        with pytest.raises(SystemExit) as exit_:
            main(list(arguments))
        out, err = (COLOUR.sub("", stream) for stream in capsys.readouterr())
        assert "Traceback" not in out + err
        code = exit_.value.code
        assert isinstance(code, int)
        return Outcome(code, out, err)

    return run_main

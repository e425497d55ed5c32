"""Pictures for a page: no text overlaps another or is clipped, and none is higher than 1.2 widths.

By day some kinds of pictures at the narrowest width; by night all kinds at three, every picture of `problems/`, and
those of commands that no problem has.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import tubeopt
from tests.test_problems import LAW_RIGS, PROBLEMS, problem
from tubeopt.cli.app import main
from tubeopt.runs.heating_study import ClosedLoopHeating
from tubeopt.shaping import plan_mandrel, rank_mold_materials
from tubeopt.shaping.firmware.boards import Wiring
from tubeopt.show.page import TITLED, WIDTH
from tubeopt.show.plots import layout, style
from tubeopt.show.plots.labels import note
from tubeopt.show.plots.style import entitle, headed, new_figure, picture
from tubeopt.show.plots.texts import faults

ROOT = Path(__file__).resolve().parents[2]
TURN = np.radians([200.0, 30.0, 0.0])


@cache
def pose() -> Any:
    return tubeopt.load_robot("thesis_ctr").fk(np.radians([0.0, 57.3, 114.6]))


@cache
def walked() -> Any:
    return tubeopt.follow(pose().robot, np.radians(np.linspace(0, 360, 13))[:, None] * [1.0, 0, 0])


@cache
def pair() -> Any:
    return tubeopt.load_robot("two_tube")


@cache
def mold() -> Any:
    return tubeopt.plan_mold(pose().robot.tubes[0])


@cache
def helix() -> Any:
    piece = tubeopt.Piece(0.05, (20.0, 0.0, 30.0))
    return tubeopt.Tube.of_pieces(1.2e-3, 1.0e-3, [piece], straight_length=0.02)


@cache
def led() -> ClosedLoopHeating:
    """A heating, on an Arduino Uno; its controller is not drawn."""
    rig = tubeopt.load_rig("thesis_calcium_silicate")
    plan = tubeopt.plan_heating(rig.tube, rig, tubeopt.HeatingSpec(hold_time=2.0))
    return ClosedLoopHeating(plan, None, Wiring(), rig.circuit.pwm_frequency)  # type: ignore[arg-type]


@cache
def drawings() -> dict[str, Callable[[], Any]]:
    """A kind of picture -> what draws a small one."""
    from tubeopt.show import plots
    from tubeopt.show.plots import mold as molds
    from tubeopt.show.plots import workspace
    from tubeopt.show.plots.heating import plot_wiring
    from tubeopt.show.plots.sheets import plot_setup_sheet

    robot = pose().robot
    loaded = tubeopt.forward_kinematics(robot, TURN, load=tubeopt.Load(force=(0.01, 0.0, 0.02)))
    return {
        "shape": lambda: plots.plot_shape(loaded),
        "shapes": lambda: plots.plot_shapes([pose(), walked().equilibria[3]], titles=["home", "turned"]),
        "torsion": lambda: plots.plot_torsion(pose()),
        "torsions": lambda: plots.plot_torsions([pose(), loaded]),
        "equilibria": lambda: plots.plot_equilibria(tubeopt.find_equilibria(robot, np.radians([180.0, 0, 0]))),
        "path": lambda: plots.plot_path(walked()),
        "snap": lambda: plots.plot_snap(walked().snaps[0]),
        "hysteresis": lambda: plots.plot_hysteresis((walked(), walked()), angles_deg=np.linspace(0, 360, 13)),
        "branch": lambda: plots.plot_branch(tubeopt.trace_branch(pair(), [0.0, 0.0], [6.28, 0.0])),
        "map": lambda: plots.plot_stability_map(tubeopt.stability_map(robot, samples=5)),
        "energy": lambda: plots.plot_energy_maps([tubeopt.energy_map(pair(), [2.0, 0.0], samples=7)] * 2),
        "workspace": lambda: workspace.plot_workspace(tubeopt.workspace(robot, samples=60, seed=1)),
        "mold": lambda: molds.plot_mold(mold()),
        "setup sheet": lambda: plot_setup_sheet(mold()),
        "materials": lambda: molds.plot_materials(rank_mold_materials(robot.tubes[0])),
        "mandrel": lambda: molds.plot_mandrel(plan_mandrel(helix())),
        "wiring": lambda: plot_wiring(led()),
    }


@contextmanager
def page(width_mm: float, *, titled: bool = True) -> Iterator[None]:
    """Pictures of this width."""
    tokens = WIDTH.set(width_mm * 1e-3), TITLED.set(titled)
    try:
        yield
    finally:
        WIDTH.reset(tokens[0])
        TITLED.reset(tokens[1])


KINDS = (
    *("shape", "shapes", "torsion", "torsions", "equilibria", "path", "snap", "hysteresis", "branch", "map", "energy"),
    *("workspace", "mold", "materials", "mandrel", "setup sheet", "wiring"),
)


@pytest.mark.parametrize("width_mm", [60, 88, 180])
@pytest.mark.parametrize("kind", KINDS)
def test_no_text_overlaps_another_or_is_clipped(kind: str, width_mm: float) -> None:
    with page(width_mm):
        figure = drawings()[kind]()
    assert [str(fault) for fault in faults(figure)] == []
    if kind != "setup sheet":  # a page A4
        assert sum(np.prod(axes.get_position().size) for axes in figure.axes) > 0.15  # nothing shrinks to nothing
        assert figure.get_figwidth() == pytest.approx(width_mm / 25.4)


@contextmanager
def measured(patch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """What is wrong with pictures that are drawn meanwhile, each at three widths; nothing is saved."""
    results: list[str] = []
    fitted = layout.fitted

    def _fitted(draw: Callable[[], Any]) -> Any:
        for width_mm in (60, 88, 180):
            with page(width_mm):
                figure = fitted(draw)
            heading = figure.get_suptitle().split("\n")[0]
            results.extend(f"{heading} at {width_mm} mm: {fault}" for fault in faults(figure))
        return figure

    patch.setattr(layout, "fitted", _fitted)
    patch.setattr(style, "saved", lambda figure, _: figure)
    with page(60):
        yield results


@pytest.mark.parametrize("script", PROBLEMS, ids=lambda script: script.stem)
def test_pictures_of_problems_fit_a_page(script: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tubeopt.shaping.heating.robust.RIGS", LAW_RIGS)
    draw, coarse = problem(script)
    with measured(monkeypatch) as result:
        draw(tmp_path, **coarse)
    assert result == []


COMMANDS = (
    "validate configs/robots/thesis_etr.yaml configs/experiments/synthetic_etr.csv --fit curvature",
    "heat calibrate configs/experiments/heating_log.csv --rig configs/rigs/thesis_calcium_silicate.yaml",
    "mold calibrate configs/molds/example_trials.csv",
    "mold mandrel configs/robots/example_pieces.yaml --tube 1",
)


@pytest.mark.parametrize("typed", COMMANDS, ids=lambda typed: typed.split(" configs")[0])
def test_pictures_of_commands_fit_a_page(typed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    with measured(monkeypatch) as result, pytest.raises(SystemExit):
        main([*typed.split(), "--out", str(tmp_path), "--width-mm", "60", "--quiet"])
    assert result == []


@picture
def crowded(words: str) -> Any:
    """A picture with a long heading, a long name of an axis and many wide numbers."""
    figure = new_figure(7.0, 4.0)
    axes = figure.subplots()
    axes.plot([0, 1e6], [0, 1])
    axes.set_xticks(np.linspace(0, 1e6, 21), [f"{x:.1f}" for x in np.linspace(0, 1e6, 21)])
    axes.set_ylabel(words)
    return headed(figure, words)


def test_faults_are_found() -> None:
    figure = new_figure(2.0, 3.0)
    figure.text(0.5, 0.5, "one")
    figure.text(0.5, 0.5, "two")
    figure.text(0.95, 0.2, "outside")
    assert [fault.kind for fault in faults(figure)] == ["high", "clipped", "overlap"]


@pytest.mark.parametrize("order", [1, -1])
def test_text_in_the_area_of_another_panel_is_found(order: int) -> None:
    """Drawn below the other panel, whose face hides it, or above it."""
    figure = new_figure(4.0, 4.0, layout=None)
    left, right = (figure.add_axes((x, 0.1, 0.3, 0.8)) for x in (0.1, 0.6))
    right.set_zorder(order)
    left.text(0.9, 0.5, "a text wider than its panel")
    inset = right.inset_axes((0.5, 0.5, 0.4, 0.4))
    inset.text(0.5, 0.5, "in its own panel")
    right.set_title("neighbour", loc="left")
    assert [str(fault) for fault in faults(figure)] == ["covered: 'a text wider than its panel' and 'neighbour'"]


@picture
def neighbours(words: str) -> Any:
    """Two panels, of which the left one names a point beside the right one."""
    figure = new_figure(4.0, 3.0)
    left, right = figure.subplots(1, 2)
    left.set(xlim=(0, 1), ylim=(0, 1))
    note(left, words, (0.9, 0.5), (5.0, 0.0)).set_in_layout(False)
    right.plot([0, 1], [0, 1])
    return figure


def test_names_are_moved_out_of_other_panels() -> None:
    assert faults(neighbours("a long name")) == []


def test_what_is_crowded_is_relieved() -> None:
    text = " ".join(["word"] * 30)
    assert faults(crowded(text)) != []
    with page(60):
        assert faults(crowded(text)) == []


def test_a_picture_without_heading() -> None:
    with page(88, titled=False):
        assert crowded("a heading").get_suptitle() == ""
        axes = new_figure(3.0, 2.0).subplots()
        entitle(axes, "a heading")
        assert axes.get_title("left") == ""


@pytest.mark.parametrize("form", ["png", "tiff", "eps", "pdf", "svg"])
def test_files_have_the_width_and_600_dots_per_inch(form: str, tmp_path: Path) -> None:
    path = tmp_path / f"picture.{form}"
    with page(60):
        crowded("words", path)
    if form in ("png", "tiff"):
        with Image.open(path) as image:
            assert image.width == pytest.approx(60 / 25.4 * 600, abs=1)
            assert image.info["dpi"][0] == pytest.approx(600, abs=0.1)
    elif form == "eps":
        box = next(line for line in path.read_text("latin-1").splitlines() if line.startswith("%%HiResBoundingBox"))
        left, _, right, _ = map(float, box.split()[1:])
        assert right - left == pytest.approx(60 / 25.4 * 72, abs=0.1)

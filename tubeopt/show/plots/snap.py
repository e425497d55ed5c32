"""A snap: the robot before and after it, and how far the tip jumps."""

from __future__ import annotations

import numpy as np

from ...equilibrium.result import Equilibrium
from ...files.units import TO_MILLI, TO_MM
from ...stability import Snap
from ..formatting import released
from .shape import draw_scenes
from .stage import View, widest_view
from .style import INK, Axes, Figure, headed, millimetres, new_figure, picture, rotations_in_words


@picture
def plot_snap(
    snap: Snap,
    *,
    title: str = "",
    view: tuple[float, float] | None = None,
) -> Figure:
    """Picture of the robot before and after a snap, side by side in equal boxes and at one scale.

    The shape that is lost stands behind the new one as a ghost, with an arrow from the old tip to the new.

    Args:
        snap: of `find_snap` or `follow`.
        title: heading; default the robot's name.
        view: elevation and azimuth of the viewer, deg; None looks across the jump of the tip.
    """
    before, after = snap.before, snap.after
    figure = new_figure(7.0, 4.9)
    headed(figure, _heading(snap, title))
    if view is None:
        tips = np.array([before.tip_position, after.tip_position])
        across = widest_view(tips - tips.mean(0))
        view = across.elevation, across.azimuth
    scenes, seen = draw_scenes(figure, [before, after], [(), (before,)], view, close_ups=False)
    scenes[0].set_title("before\n" + _state(before, at_fold=True), fontsize=8, loc="left")
    scenes[1].set_title("after\n" + _state(after), fontsize=8, loc="left")
    _draw_jump(scenes[1], snap, seen)
    return figure


def _heading(snap: Snap, title: str) -> str:
    """Where the robot snaps and what that does, in two lines."""
    robot = snap.before.robot
    name = title or robot.name or f"Robot with {robot.n_tubes} tubes"
    joints = rotations_in_words(snap.rotations, 3)
    if np.any(snap.translations):
        joints += f", translations ({millimetres(snap.translations)}) mm"
    energy = released(snap.energy_released, ", {:.2f} mJ are released")
    return f"{name}:  snap at {joints}\nthe tip jumps by {snap.tip_jump * TO_MM:.1f} mm{energy}"


def _state(equilibrium: Equilibrium, *, at_fold: bool = False) -> str:
    """Tip, margin and energy, in two lines; at a fold the margin is 0 but for round-off."""
    margin = "0, the fold" if at_fold else f"{equilibrium.margin:.3f}"
    energy = f"{equilibrium.energy * TO_MILLI:.2f} mJ"
    return f"tip ({millimetres(equilibrium.tip_position)}) mm\nmargin {margin},  energy {energy}"


def _draw_jump(scene: Axes, snap: Snap, view: View) -> None:
    """An arrow from the old tip to the new one, with its length."""
    old, new = (view.project(each.tip_position)[:2] for each in (snap.before, snap.after))
    style = {"arrowstyle": "-|>", "color": INK, "lw": 1.0, "ls": "-", "shrinkA": 3, "shrinkB": 3, "mutation_scale": 10}
    scene.annotate("", (float(new[0]), float(new[1])), (float(old[0]), float(old[1])), arrowprops=style, zorder=6)
    # The label stands above the arrow, to the side that the arrow leaves free.
    slope = (old[1] - new[1]) * (new[0] - old[0])
    scene.annotate(
        f"{snap.tip_jump * TO_MM:.1f} mm",
        tuple(((old + new) / 2).tolist()),
        (3.0 * float(np.sign(slope)), 10.0),
        textcoords="offset points",
        ha="center",
        va="bottom",
        bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.5},
        zorder=7,
    )

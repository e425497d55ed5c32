"""Pictures and films of trajectories: the arm as it sweeps, joint values and margin over time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...bodies.frames import Frame, Plane
from ...bodies.obstacles import Obstacle, nearest_distance
from ...equilibrium.arm_surface import ArmSurface
from ...equilibrium.kinematics import forward_kinematics
from ...equilibrium.result import Equilibrium
from ...errors import InputError, SolveError
from ...files.files import atomic_write
from ...files.units import TO_MM
from ...planning import ArmsPlan, Trajectory
from ...runs.plan_study import VerifiedTrajectory
from ...typing import Array
from ..quantities import load_text
from .labels import legend_beside, note
from .panels import CLEARANCE, DEVIATION, MARGIN, PanelScale, draw_joints, draw_over, share_x
from .projection import Projection, SceneBox
from .scene import DrawnArm, PlotScene, TipPath, draw_scene
from .style import FAINT, INK, Axes, Figure, headed, new_figure, number, picture, styled

SHOWN = 9
"""Shapes of the arm in the picture."""

FRAMES = 48
"""Frames of the film."""

CHECK_SAMPLES = 150
"""Number of instants with a computed arm of a checked trajectory, in addition to its samples."""

START_OPACITY, BETWEEN_OPACITY = 0.45, 0.2
"""Opacity of the arm at the start, and between start and end, where arms overlap."""

ROBOT_FRAME = Frame()


@picture
def plot_trajectory(
    trajectory: Trajectory,
    *,
    title: str = "",
    view: tuple[float, float] | None = None,
) -> Figure:
    """Figure of a trajectory: swept arm and path of the tip; joint values, margin and clearance over time.

    Args:
        title: heading; by default the robot's name.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side of the motion.
    """
    t = trajectory
    quantities: list[tuple[Array, PanelScale, float | None]] = [(t.margin, MARGIN, t.min_margin)]
    if np.isfinite(t.clearance).all():
        quantities.append((t.clearance, CLEARANCE, t.min_clearance))
    if t.deviation is not None:
        quantities.append((t.deviation, DEVIATION, None))
    figure = new_figure(10.0, 5.4)
    panels = beside_scene(figure, 2 + len(quantities), swept_scene(t.arms, t.time, t.tip_position, t.obstacles), view)
    draw_joints(panels[:2], t.time, t.rotations, t.translations)
    for axes, (values, scale, limit) in zip(panels[2:], quantities, strict=True):
        draw_over(axes, t.time, values, scale, limit=limit)
    legend_beside(panels[2])
    share_x(panels, t.time)
    clearance = t.proof.least_clearance
    clear = f",  least clearance {clearance * TO_MM:.2f} mm" if np.isfinite(clearance) else ""
    facts = f"{number(float(t.time[-1]), 1)} s,  least margin {t.proof.least_margin:.3f}{clear}"
    proved = "proved" if t.proved else "not proved"
    return headed(figure, f"{title or t.robot.name or 'robot'}\n{facts},  {proved}{_under_load(t.start)}")


@picture
def plot_checked(checked: VerifiedTrajectory) -> Figure:
    """Picture of a trajectory that was checked: swept arm, path of its tip, joint values, and margin.

    Arm and margin end where the proof ends; a snap is marked.
    """
    joints, proof = checked.joints, checked.proof
    figure = new_figure(10.0, 5.4)
    time, arms = _followed(checked)
    scene = swept_scene(arms, time, np.array([each.tip_position for each in arms]), checked.obstacles)
    panels = beside_scene(figure, 3, scene, None)
    draw_joints(panels[:2], joints.time, joints.rotations, joints.translations)
    draw_over(panels[2], time, [each.margin for each in arms], MARGIN)
    if proof.snap is not None:
        at = joints.time[0] + proof.snap * (joints.time[-1] - joints.time[0])
        panels[2].axvline(float(at), color="#C1272D", lw=1.2, label="snaps")
        legend_beside(panels[2])
    share_x(panels, joints.time)
    verdict = "is proved" if proof.holds else "is not proved"
    seconds = number(float(joints.time[-1] - joints.time[0]), 1)
    margin_text = f"least margin {proof.least_margin:.3f}"
    return headed(
        figure, f"{joints.robot.name or 'robot'}\n{seconds} s,  {margin_text},  {verdict}{_under_load(proof.end)}"
    )


def _under_load(arm: Equilibrium) -> str:
    """Load of an arm as the last part of a heading; "" without a load."""
    return "" if arm.load is None else f",  under {load_text(arm.load)}"


class Followed(NamedTuple):
    """Equilibria along a trajectory that was checked."""

    time: Array
    """(k,) times of the arms, s."""
    arms: list[Equilibrium]


def _followed(checked: VerifiedTrajectory) -> Followed:
    """Equilibria from the first sample to where the proof ends."""
    joints, proof = checked.joints, checked.proof
    first, last = float(joints.time[0]), float(joints.time[-1])
    # Places of a proof are fractions of the whole motion, from 0 to 1.
    end = first + (proof.snap if proof.snap is not None else proof.followed) * (last - first)
    # Samples may be far apart; margins between them are part of what was checked.
    instants = np.union1d(joints.time, np.linspace(first, last, CHECK_SAMPLES))
    times, arms = [first], [proof.samples[0] if proof.samples else proof.end]
    for time in instants[(instants > first) & (instants < end)]:
        rotations, translations = (
            np.array([np.interp(time, joints.time, row) for row in values.T])
            for values in (joints.rotations, joints.translations)
        )
        try:
            # From the last equilibrium, so that the arm stays on its branch; from home it might reach another.
            arm = forward_kinematics(joints.robot, rotations, translations, load=proof.end.load, start=arms[-1])
        except SolveError:  # so close to a snap that no step from the last one reaches it
            break
        times.append(float(time))
        arms.append(arm)
    return Followed(np.array([*times, max(end, times[-1] + 1e-9)]), [*arms, proof.end])


@styled
def animate_trajectory(
    trajectory: Trajectory,
    path: str | PathLike[str],
    *,
    frames: int = FRAMES,
    view: tuple[float, float] | None = None,
) -> Path:
    """Path of a film of the moving arm, with the margin over time below it: GIF, or MP4 if ffmpeg is installed.

    Raises:
        InputError: the file cannot be written, its name ends otherwise, or ffmpeg is missing.
    """
    film_ending(path)
    t = trajectory
    rows = np.unique(np.linspace(0, len(t.time) - 1, min(frames, len(t.time))).astype(int))
    arms = [t.arms[row] for row in rows]
    # One view and one box for all frames: a box that changes would move the scene.
    scene = PlotScene([DrawnArm(arm) for arm in arms], t.obstacles, [TipPath(t.time, t.tip_position)])
    projection, box = scene.view(view), SceneBox.around(scene.extent())

    def draw(axes: Axes, below: Axes, k: int) -> None:
        passed = slice(rows[k] + 1)
        draw_scene(
            axes,
            PlotScene([DrawnArm(arms[k])], t.obstacles, [TipPath(t.time[passed], t.tip_position[passed])]),
            projection,
            box,
        )
        draw_over(below, t.time, t.margin, MARGIN, color=FAINT, lw=1)
        below.plot(t.time[passed], t.margin[passed], color=INK, lw=1.4)
        below.set_xlabel("time (s)")

    return save_film(path, f"{t.robot.name or 'robot'}: {number(float(t.time[-1]), 1)} s", len(rows), draw)


def film_ending(path: str | PathLike[str]) -> str:
    """Ending of a film, .gif or .mp4; raises InputError for any other, and if .mp4 cannot be written."""
    from matplotlib.animation import writers

    ending = Path(path).suffix.lower()
    if ending not in (".gif", ".mp4"):
        raise InputError(f"{path}: the file name of an animation must end in .gif or .mp4")
    if ending == ".mp4" and not writers.is_available("ffmpeg"):
        raise InputError(f"{path}: MP4 needs ffmpeg, which was not found; install it, or let the name end in .gif")
    return ending


def save_film(
    path: str | PathLike[str],
    title: str,
    count: int,
    draw: Callable[[Axes, Axes, int], None],
    *,
    beside: bool = False,
) -> Path:
    """Path of a film of `count` frames, each drawn by its number into a scene and a panel below or `beside` it."""
    from matplotlib.animation import FFMpegWriter, PillowWriter

    gif = film_ending(path) == ".gif"
    figure = new_figure(7.2, 3.6, layout=None) if beside else new_figure(5.0, 5.6, layout=None)
    figure.suptitle(title, fontsize=9, x=0.04, ha="left")
    positions = (
        ((0.04, 0.09, 0.46, 0.84), (0.60, 0.15, 0.37, 0.72))
        if beside
        else ((0.04, 0.24, 0.92, 0.68), (0.13, 0.09, 0.83, 0.12))
    )
    scene, panel = (figure.add_axes(position) for position in positions)
    # GIF has no compression between frames: half as many frames, and less than half the dots.
    writer, dpi = (PillowWriter(fps=12), 100) if gif else (FFMpegWriter(fps=24), 150)
    draw(scene, panel, 0)
    figure.draw_without_rendering()  # a scene of equal aspect takes its position, on which its scales depend
    # An Animation of matplotlib would draw every frame twice.
    with atomic_write(path) as temporary, writer.saving(figure, temporary, dpi):
        for k in range(count):
            scene.clear()
            panel.clear()
            draw(scene, panel, k)
            writer.grab_frame()
    return Path(path)


def some_of(arms: Sequence[Equilibrium], count: int = SHOWN) -> list[Equilibrium]:
    """Equilibria along a motion, at most `count`, evenly spaced, with the first and the last."""
    # Unique, as a short motion has fewer arms.
    return [arms[k] for k in np.unique(np.linspace(0, len(arms) - 1, count).round().astype(int))]


def swept_scene(
    arms: Sequence[Equilibrium],
    x: Array,
    tips: Array,
    bodies: Sequence[Obstacle] = (),
    *,
    shown: int = SHOWN,
    targets: bool = False,
) -> PlotScene:
    """Scene of a motion: some of its arms with the path of the tip.

    Args:
        x: (T,) time, or another increasing parameter, of `tips` (T, 3), m.
        shown: largest number of arms.
        targets: tips are targets.
    """
    return PlotScene(swept_arms(some_of(arms, shown)), bodies, [TipPath(x, tips, targets)])


def swept_arms(arms: Sequence[Equilibrium], base: Frame = ROBOT_FRAME) -> list[DrawnArm]:
    """Arms of a motion: the last one solid, the first one paler, those between faint."""
    last = len(arms) - 1
    # Start and end are what a reader searches; between them arms overlap and must let through.
    opacity = [1.0 if k == last else START_OPACITY if k == 0 else BETWEEN_OPACITY for k in range(len(arms))]
    return [DrawnArm(arm, part, base) for arm, part in zip(arms, opacity, strict=True)]


def beside_scene(figure: Figure, count: int, scene: PlotScene, view: tuple[float, float] | None) -> list[Axes]:
    """Draw a scene, and return `count` empty panels next to it, the second with a legend of the scene."""
    grid = figure.add_gridspec(count, 2, width_ratios=(1.15, 1.0))
    left, first = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
    panels = [first, *(figure.add_subplot(grid[k, 1], sharex=first) for k in range(1, count))]
    draw_scene(left, scene, scene.view(view), SceneBox.around(scene.extent()))
    legend_beside(panels[1], *left.get_legend_handles_labels())
    return panels


CELLS = 300
"""Grid points along a side of the picture for the distance of bodies."""

BORDER = 0.012
"""Width of the region shown around the arm, m."""

ALONG = 400
"""Points along an arm."""

BODY, ARM, PROJECTED = "#DDD3CE", "#0072B2", "#9CC3DE"


@picture
def plot_section(trajectory: Trajectory, *, plane: Plane | None = None, title: str = "") -> Figure:
    """Picture of a motion in a plane: bodies cut by the plane, the arm at the end to scale, and earlier centrelines.

    The arm is darker where the plane cuts it than where it lies before or behind.

    Args:
        plane: in the frame of the plate; by default `trajectory.cut`.
        title: heading; by default the robot's name.

    Raises:
        InputError: neither a plane nor `trajectory.cut`.
    """
    from matplotlib.collections import EllipseCollection

    t, plane = trajectory, plane or trajectory.cut
    if plane is None:
        raise InputError("there is no plane to cut along; give one, or a trajectory with a cut")
    arms = some_of(t.arms)
    lines = [ArmSurface(arm).line(ALONG)[0] for arm in arms]
    frame = plane.frame
    in_frame = frame.seen(np.concatenate([*lines, t.tip_position]))[:, :2]
    low, high = in_frame.min(0) - BORDER, in_frame.max(0) + BORDER
    figure = new_figure(4.6, 4.4)
    axes = figure.add_subplot()
    if t.obstacles:
        u, v = (np.linspace(a, b, CELLS) for a, b in zip(low, high, strict=True))
        points = frame.placed(np.stack(np.broadcast_arrays(u[None], v[:, None], 0.0), axis=-1))
        # The zero of the signed distance is the outline of bodies of every kind, without a section of each.
        distance = nearest_distance(t.obstacles, points)
        axes.contourf(u * TO_MM, v * TO_MM, distance, levels=[-np.inf, 0.0], colors=[BODY])
        axes.contour(u * TO_MM, v * TO_MM, distance, levels=[0.0], colors=[FAINT], linewidths=0.7)
    for line in lines[:-1]:
        axes.plot(*(frame.seen(line)[:, :2].T * TO_MM), color=ARM, lw=0.6, alpha=0.5, label="before")
    line, radius = ArmSurface(arms[-1]).line(ALONG)
    centres, height = frame.seen(line)[:, :2] * TO_MM, plane.height(line)
    # The arm is the balls about its centreline. A plane at height h cuts a ball of radius r in a disc of radius
    # sqrt(r^2 - h^2).
    for half, colour in ((radius, PROJECTED), (np.sqrt(np.maximum(radius**2 - height**2, 0.0)), ARM)):
        wide = 2 * TO_MM * half[half > 0]
        where: dict[str, Any] = {"units": "xy", "offsets": centres[half > 0], "offset_transform": axes.transData}
        # Hundreds of discs as one collection: single patches would take seconds and megabytes of PDF.
        axes.add_collection(EllipseCollection(wide, wide, 0 * wide, color=colour, lw=0, zorder=3, **where))
    axes.plot(*(frame.seen(t.tip_position[-1])[:2, None] * TO_MM), "o", color=INK, ms=3, zorder=4, label="tip")
    axes.set(xlim=TO_MM * np.array([low[0], high[0]]), ylim=TO_MM * np.array([low[1], high[1]]), aspect="equal")
    axes.set(xlabel="to the right in the plane (mm)", ylabel="upwards in the plane (mm)")
    for colour, name in ((ARM, "arm, cut"), (PROJECTED, "arm, beside"), (BODY, "body, cut")):
        axes.fill([], [], color=colour, label=name)
    # Of equal names only the last one is kept.
    signs = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    legend_beside(axes, signs.values(), signs.keys())
    point, normal = (
        ", ".join(number(float(x), digits) for x in row)
        for row, digits in ((plane.point * TO_MM, 1), (plane.normal, 2))
    )
    headed(figure, f"{title or t.robot.name or 'robot'}\nplane through {point} mm, square to {normal}")
    return figure


ARMS_SHOWN = 6
"""Number of instants with a drawn arm."""

ARMS_FRAMES = 24
"""Frames of the film of several arms."""

DISTANCE_SAMPLES = 160
"""Instants of the curve of distances."""

BETWEEN_ARMS = CLEARANCE._replace(name="between arms (mm)")


@picture
def plot_arms(plan: ArmsPlan, *, title: str = "", view: tuple[float, float] | None = None) -> Figure:
    """Figure of a plan of several arms: all arms to scale at some instants, and their distances over time.

    Args:
        title: heading; by default the names of the arms.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side of the motion.
    """
    figure = new_figure(10.0, 4.8)
    left, distances = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    scene = _arms_scene(plan, np.linspace(0.0, plan.duration, ARMS_SHOWN))
    _draw_arms(left, plan, scene, scene.view(view), SceneBox.around(scene.extent()))
    _draw_distances(distances, plan, np.linspace(0.0, plan.duration, DISTANCE_SAMPLES))
    distances.legend(loc="best")
    headed(figure, title or " and ".join(arm.called for arm in plan.arms))
    return figure


@styled
def animate_arms(
    plan: ArmsPlan, path: str | PathLike[str], *, frames: int = ARMS_FRAMES, view: tuple[float, float] | None = None
) -> Path:
    """Path of a film of the moving arms, with the distances between them below: GIF, or MP4 if ffmpeg is installed.

    Raises:
        InputError: the file cannot be written, its name ends otherwise, or ffmpeg is missing.
    """
    film_ending(path)
    times = np.linspace(0.0, plan.duration, frames)
    scene = _arms_scene(plan, times)
    projection, box = scene.view(view), SceneBox.around(scene.extent())

    def draw(axes: Axes, below: Axes, k: int) -> None:
        _draw_arms(axes, plan, _arms_scene(plan, times[k : k + 1]), projection, box)
        _draw_distances(below, plan, times)
        below.axvline(float(times[k]), color=INK, lw=0.8)

    return save_film(path, f"{len(plan.arms)} arms: {number(plan.duration, 1)} s", frames, draw)


def _arms_scene(plan: ArmsPlan, times: Array) -> PlotScene:
    """Every arm at some instants, with the path of its tip up to the last."""
    arms, paths = [], []
    rows = zip(*(plan.rows_at(float(t)) for t in times), strict=True)
    for arm, motion, arm_rows in zip(plan.arms, plan.trajectories, rows, strict=True):
        arms += swept_arms([motion.arms[row] for row in arm_rows], arm.base)
        passed = slice(arm_rows[-1] + 1)
        paths.append(TipPath(motion.time[passed], arm.base.placed(motion.tip_position[passed])))
    return PlotScene(arms, plan.obstacles, paths)


def _draw_arms(axes: Axes, plan: ArmsPlan, scene: PlotScene, projection: Projection, box: SceneBox) -> None:
    """Draw all arms, with their names at their bases."""
    draw_scene(axes, scene, projection, box)
    for arm in plan.arms:
        note(axes, arm.called, projection.project(arm.base.origin)[:2], (7.0, 0.0))


def _draw_distances(axes: Axes, plan: ArmsPlan, times: Array) -> None:
    """Draw the distance of every pair of arms over time, and its proved lower bound."""
    distances = plan.clearance(times)
    for k, pair in enumerate(plan.proof.pairs):
        name = f"arms {pair.arms[0] + 1} and {pair.arms[1] + 1}"
        line = draw_over(axes, times, distances[:, k], BETWEEN_ARMS, name=name, color=INK if k == 0 else None)
        if np.isfinite(pair.least_clearance):
            bound = pair.least_clearance * TO_MM
            axes.axhline(bound, lw=0.8, color=line.get_color(), ls=":", label="proved at all times")
    axes.axhline(plan.min_clearance * TO_MM, color=FAINT, lw=0.8, ls="--", label="required")
    axes.set_xlabel("time (s)")

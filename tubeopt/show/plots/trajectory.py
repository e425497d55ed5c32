"""Pictures of trajectories: the arm as it sweeps, joint values and margin over time; the same as a film."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import Akima1DInterpolator

from ...bodies.anatomy import Turned
from ...bodies.corridors import Corridor, MeshObstacle
from ...bodies.distance_field import DistanceField
from ...bodies.frames import Frame, Plane
from ...bodies.obstacles import HalfSpace, Obstacle, nearest_distance
from ...equilibrium.kinematics import forward_kinematics
from ...equilibrium.result import Equilibrium
from ...errors import InputError, SolveError
from ...files.files import atomic_write
from ...files.units import TO_MM
from ...inverse.arm_surface import ArmSurface
from ...planning import ArmsPlan, Trajectory
from ...runs.plan_study import VerifiedTrajectory
from ...typing import Array
from ..page import tube_colour
from ..quantities import load_in_words
from ..surfaces import Detail, obstacle_surface, swept
from .shape import robot_mesh
from .stage import Box, Mesh, View, draw_box, facets, facets_of, note, widest_view
from .style import FAINT, INK, Axes, Figure, headed, legend_beside, new_figure, number, picture, styled, widen

SHOWN = 9
"""Shapes of the arm in the picture."""

FRAMES = 48
"""Pictures of the film."""

SWEEPING = Detail(10, 120, even=True)
"""How finely arms are cut, of which there are many."""

LOOKED_AT = 150
"""Instants at which the arm of a trajectory that was checked is drawn, beside its samples."""

WAY = 1500
"""Points of the drawn way of the tip: between samples it is bent, not straight."""

FLAT = {"rotation (deg)": 10.0, "translation (mm)": 5.0}
"""Least height of a scale: what does not move is drawn as a line across, not as its rounding."""

SIDES = 20
"""Facets around what is round."""

OBSTACLE = np.array([0.55, 0.55, 0.58, 0.35])
VESSEL = np.array([0.80, 0.47, 0.65, 0.10])


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
    figure = new_figure(10.0, 5.4)
    curves = 3 + bool(np.isfinite(t.clearance).all()) + (t.deviation is not None)
    axes = beside_scene(figure, curves, Sweep(some_of(t.arms), t.time, t.tip_position), t.obstacles, view)
    _draw_curves(axes, t)
    figure.align_ylabels(axes)
    return headed(figure, _heading(t, title))


@picture
def plot_checked(checked: VerifiedTrajectory) -> Figure:
    """Picture of a trajectory that was checked: the swept arm with the way of its tip, joint values, and the margin as
    far as it was followed, with the place of a snap."""
    joints, proof = checked.joints, checked.proof
    figure = new_figure(10.0, 5.4)
    time, followed = _followed(checked)
    sweep = Sweep(some_of(followed), time, np.array([e.tip_position for e in followed]))
    axes = beside_scene(figure, 3, sweep, checked.obstacles, None)
    draw_joints(axes, joints.time, joints.rotations, joints.translations)
    axes[2].plot(time, [e.margin for e in followed], color=INK, lw=1.4)
    if proof.snap is not None:
        at = joints.time[0] + proof.snap * (joints.time[-1] - joints.time[0])
        axes[2].axvline(float(at), color="#C1272D", lw=1.2, label="snaps")
        legend_beside(axes[2])
    margin_scale(axes[2], min(e.margin for e in followed))
    along(axes, joints.time)
    figure.align_ylabels(axes)
    verdict = "holds" if proof.holds else "does not hold"
    seconds = number(float(joints.time[-1] - joints.time[0]), 1)
    least = f"least margin {proof.least_margin:.3f}"
    return headed(figure, f"{joints.robot.name or 'robot'}\n{seconds} s,  {least},  {verdict}{_under(proof.end)}")


@styled
def animate_trajectory(
    trajectory: Trajectory,
    path: str | PathLike[str],
    *,
    frames: int = FRAMES,
    view: tuple[float, float] | None = None,
) -> Path:
    """The moving arm as a film, with the margin over time below it: GIF, or MP4 where there is ffmpeg.

    Raises:
        InputError: the file cannot be written, its name ends otherwise, or ffmpeg is missing.
    """
    film_ending(path)
    t = trajectory
    rows = np.unique(np.linspace(0, len(t.time) - 1, min(frames, len(t.time))).astype(int))
    arms = [t.arms[row] for row in rows]
    stage = stage_for([Sweep(arms, t.time, t.tip_position)], t.obstacles, view)

    def draw(scene: Axes, below: Axes, k: int) -> None:
        passed = slice(rows[k] + 1)
        draw_sweeps(scene, stage, [Sweep([arms[k]], t.time[passed], t.tip_position[passed])], t.obstacles)
        below.plot(t.time, t.margin, color=FAINT, lw=1)
        below.plot(t.time[passed], t.margin[passed], color=INK, lw=1.4)
        below.set_xlabel("time (s)")
        margin_scale(below, float(t.margin.min()))

    return save_film(path, f"{t.robot.name or 'robot'}: {number(float(t.time[-1]), 1)} s", len(rows), draw)


def _followed(checked: VerifiedTrajectory) -> tuple[Array, list[Equilibrium]]:
    """Instants (k,), s, and the equilibria there, from the first sample to where the proof ends, which is the last."""
    joints, proof = checked.joints, checked.proof
    first, last = float(joints.time[0]), float(joints.time[-1])
    # Places of a proof are fractions of the whole motion, from 0 to 1.
    end = first + (proof.snap if proof.snap is not None else proof.followed) * (last - first)
    # Samples may be far apart; margins between them are part of what was checked.
    instants = np.union1d(joints.time, np.linspace(first, last, LOOKED_AT))
    times, found = [first], [proof.samples[0] if proof.samples else proof.end]
    for time in instants[(instants > first) & (instants < end)]:
        rotations, translations = (
            np.array([np.interp(time, joints.time, row) for row in values.T])
            for values in (joints.rotations, joints.translations)
        )
        try:
            # From the last equilibrium, so that the arm stays on its branch; from home it might land on another.
            here = forward_kinematics(joints.robot, rotations, translations, load=proof.end.load, start=found[-1])
        except SolveError:  # so close to a snap that no step from the last one reaches it
            break
        times.append(float(time))
        found.append(here)
    return np.array([*times, max(end, times[-1] + 1e-9)]), [*found, proof.end]


def film_ending(path: str | PathLike[str]) -> str:
    """.gif or .mp4; raises InputError for any other, and where .mp4 cannot be written."""
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
    """Write `count` pictures of a scene with a panel below or `beside` it, each drawn anew by its number, as a film."""
    from matplotlib.animation import FFMpegWriter, PillowWriter

    gif = film_ending(path) == ".gif"
    figure = new_figure(7.2, 3.6, layout=None) if beside else new_figure(5.0, 5.6, layout=None)
    figure.suptitle(title, fontsize=9, x=0.04, ha="left")
    places = (
        ((0.04, 0.09, 0.46, 0.84), (0.60, 0.15, 0.37, 0.72))
        if beside
        else ((0.04, 0.24, 0.92, 0.68), (0.13, 0.09, 0.83, 0.12))
    )
    scene, below = (figure.add_axes(place) for place in places)
    # GIF has no compression between pictures: half the pictures, and less than half the dots.
    writer, dpi = (PillowWriter(fps=12), 100) if gif else (FFMpegWriter(fps=24), 150)
    draw(scene, below, 0)
    figure.draw_without_rendering()  # a scene of equal aspect takes its place, which its scales depend on
    # An Animation of matplotlib would draw every picture twice.
    with atomic_write(path) as temporary, writer.saving(figure, temporary, dpi):
        for k in range(count):
            scene.clear()
            below.clear()
            draw(scene, below, k)
            writer.grab_frame()
    return Path(path)


def some_of(arms: Sequence[Equilibrium]) -> list[Equilibrium]:
    """At most `SHOWN` of the equilibria along a motion, evenly, with the first and the last."""
    # Unique, as a short motion has fewer arms than SHOWN.
    return [arms[k] for k in np.unique(np.linspace(0, len(arms) - 1, SHOWN).astype(int))]


class Sweep(NamedTuple):
    """A motion as it is drawn."""

    arms: Sequence[Equilibrium]
    """At some instants."""
    time: Array
    """(T,) s, or what else rises along the way."""
    tips: Array
    """(T, 3) way of the tip, m."""
    base: Frame = Frame()
    """Where the plate of the arms stands; the tips are placed already."""
    asked: bool = False
    """Whether the tips are targets: nothing is known of the way between two, so straight lines join them."""


def stage_for(
    sweeps: Sequence[Sweep], obstacles: Sequence[Obstacle], view: tuple[float, float] | None
) -> tuple[View, Box]:
    """How motions are seen, by default across their widest side, and the box around them, bodies, and the plate."""
    # One box for all pictures of a film: a box that changes would move the scene.
    passed = [each.base.placed(arm.position) for each in sweeps for arm in each.arms]
    # Tips at all instants count too: between the arms that are drawn the tip may go farther.
    points = np.concatenate([*passed, *(each.tips for each in sweeps)])
    seen = View(*view) if view is not None else widest_view(points)
    corners = [mesh.corners.reshape(-1, 3) for mesh in body_meshes(obstacles)]
    # The plate's origin is in the box, also where no arm begins there.
    return seen, Box.around(np.concatenate([points, *corners, np.zeros((1, 3))]))


def beside_scene(
    figure: Figure, count: int, sweep: Sweep, obstacles: Sequence[Obstacle], view: tuple[float, float] | None
) -> list[Axes]:
    """Draw a motion; so many panels over time beside it, of which the second names its marks."""
    grid = figure.add_gridspec(count, 2, width_ratios=(1.15, 1.0))
    scene, first = figure.add_subplot(grid[:, 0]), figure.add_subplot(grid[0, 1])
    axes = [first, *(figure.add_subplot(grid[k, 1], sharex=first) for k in range(1, count))]
    draw_sweeps(scene, stage_for([sweep], obstacles, view), [sweep], obstacles)
    legend_beside(axes[1], *scene.get_legend_handles_labels())
    return axes


def draw_sweeps(
    scene: Axes,
    stage: tuple[View, Box],
    sweeps: Sequence[Sweep],
    obstacles: Sequence[Obstacle],
    *,
    faint: float = 0.2,
) -> None:
    """Arms among bodies, the last solid, the first paler and those between `faint`; and the ways of their tips."""
    seen, box = stage
    draw_box(scene, box, seen)
    parts = body_meshes(obstacles)
    for sweep in sweeps:
        for k, arm in enumerate(sweep.arms):
            # Start and end are what a reader searches; between them arms overlap and must let through.
            strong = 1.0 if k == len(sweep.arms) - 1 else 0.45 if k == 0 else faint
            parts.append(robot_mesh(arm, opacity=strong, detail=SWEEPING).placed(sweep.base))
    scene.add_collection(facets(Mesh.join(parts), seen))
    for sweep in sweeps:
        _draw_way(scene, sweep, seen)


def _draw_way(scene: Axes, sweep: Sweep, seen: View) -> None:
    """The way of a tip, curved between its samples, or targets; with its ends."""
    time, tips = sweep.time, seen.project(sweep.tips)
    way = tips
    if len(time) > 2 and not sweep.asked:
        # Makima does not swing where the tip rests between motions, as a cubic spline would.
        curve = Akima1DInterpolator(time, tips, method="makima")
        way = curve(np.union1d(time, np.linspace(time[0], time[-1], WAY)))
    name, dots = ("targets", ".") if sweep.asked else ("tip", None)
    scene.plot(way[:, 0], way[:, 1], marker=dots, ms=3, color=INK, lw=0.9, zorder=5, label=name)
    scene.plot(*tips[0, :2], "o", mfc="white", mec=INK, ms=4, zorder=6, label="start")
    scene.plot(*tips[-1, :2], "o", color=INK, ms=4, zorder=6, label="end")


def body_meshes(obstacles: Sequence[Obstacle]) -> list[Mesh]:
    """Obstacles as facets, but for half-spaces, which have no bounds."""
    bodies = [(each, each.body if isinstance(each, Turned) else each) for each in obstacles]
    return [_body_mesh(each, body) for each, body in bodies if not isinstance(body, HalfSpace)]


def _body_mesh(obstacle: Obstacle, body: Obstacle) -> Mesh:
    if isinstance(obstacle, Corridor):
        surface = swept(np.array(obstacle.centreline), obstacle.radii, sides=SIDES, capped=False)
    else:
        surface = obstacle_surface(obstacle, 0.0, sides=SIDES)
    # A corridor encloses the arm: in the opaque grey of obstacles it would hide it.
    around = isinstance(body, Corridor) or (isinstance(body, DistanceField) and not body.bounded)
    return facets_of(surface, VESSEL if around else OBSTACLE, triangles=isinstance(body, MeshObstacle))


def _draw_curves(axes: Sequence[Axes], t: Trajectory) -> None:
    """Joint values, margin, clearance and deviation over time."""
    draw_joints(axes, t.time, t.rotations, t.translations)
    rest = iter(axes[2:])
    margin = next(rest)
    margin.plot(t.time, t.margin, color=INK, lw=1.4)
    margin.axhline(t.min_margin, color=FAINT, lw=0.8, ls="--", label="required")
    legend_beside(margin)
    margin_scale(margin, float(t.margin.min()))
    if np.isfinite(t.clearance).all():
        clear = next(rest)
        clear.plot(t.time, t.clearance * TO_MM, color=INK, lw=1.4)
        clear.axhline(t.min_clearance * TO_MM, color=FAINT, lw=0.8, ls="--")
        clear.set_ylim(bottom=0)
        clear.set_ylabel("clearance (mm)")
    if t.deviation is not None:
        off = next(rest)
        off.plot(t.time, t.deviation * TO_MM, color=INK, lw=1.4)
        off.set_ylim(bottom=0)
        off.set_ylabel("deviation (mm)")
    along(axes, t.time)


def draw_joints(axes: Sequence[Axes], x: Array, rotations: Array, translations: Array) -> None:
    """Joint values (T, n), rad and m, over time, or what else there is of (T,), in the first two panels."""
    for name, panel, values in zip(FLAT, axes, (np.degrees(rotations), translations * TO_MM), strict=False):
        for i, row in enumerate(values.T):
            # Outer tubes wider and behind: where joints move together, all curves stay visible.
            panel.plot(x, row, color=tube_colour(i), lw=1.2 + 1.1 * i, zorder=2 - 0.01 * i, label=f"tube {i + 1}")
        panel.set_ylabel(name)
        widen(panel, FLAT[name])
    legend_beside(axes[0])


def margin_scale(axes: Axes, least: float) -> None:
    """The scale of a margin that comes down to `least`."""
    axes.set_ylim(min(0.0, least) - 0.02, 1.05)
    axes.set_ylabel("margin")


def along(axes: Sequence[Axes], x: Array, name: str = "time (s)") -> None:
    """Rules, and one scale below all panels."""
    for each in axes:
        each.grid(axis="y")
        each.tick_params(labelbottom=each is axes[-1])
    axes[-1].set_xlabel(name)
    # A motion of no duration would give a scale of no length.
    axes[-1].set_xlim(float(x[0]), max(float(x[-1]), float(x[0]) + 1e-9))


def _under(arm: Equilibrium) -> str:
    """What pushes on an arm, for a heading."""
    return "" if arm.load is None else f",  under {load_in_words(arm.load)}"


def _heading(t: Trajectory, title: str) -> str:
    least = f"least margin {t.proof.least_margin:.3f}"
    gap = t.proof.least_clearance
    clear = f",  least clearance {gap * TO_MM:.2f} mm" if np.isfinite(gap) else ""
    proved = "proved" if t.proved else "not proved"
    found = f"{number(float(t.time[-1]), 1)} s,  {least}{clear},  {proved}{_under(t.start)}"
    return f"{title or t.robot.name or 'robot'}\n{found}"


CELLS = 300
"""Places along a side of the picture at which it is told whether a body is there."""

AROUND = 0.012
"""Length (m) by which more is shown than the arm."""

ALONG = 400
"""Points along an arm."""

BODY, ARM, BESIDE = "#DDD3CE", "#0072B2", "#9CC3DE"


@picture
def plot_section(trajectory: Trajectory, *, plane: Plane | None = None, title: str = "") -> Figure:
    """Picture of a motion in a plane: the bodies as it cuts them, the arm at the end as wide as it is, where the plane
    cuts it darker than where it lies before or behind, and centrelines on the way there.

    Args:
        plane: in the frame of the plate; by default `trajectory.cut`.
        title: heading; by default the robot's name.

    Raises:
        InputError: neither a plane nor `trajectory.cut`.
    """
    t, plane = trajectory, plane or trajectory.cut
    if plane is None:
        raise InputError("there is no plane to cut along; give one, or a trajectory with a cut")
    arms = some_of(t.arms)
    lines = [ArmSurface(arm).line(ALONG)[0] for arm in arms]
    frame = plane.frame
    seen = frame.seen(np.concatenate([*lines, t.tip_position]))[:, :2]
    low, high = seen.min(0) - AROUND, seen.max(0) + AROUND
    figure = new_figure(4.6, 4.4)
    axes = figure.add_subplot()
    if t.obstacles:
        u, v = (np.linspace(a, b, CELLS) for a, b in zip(low, high, strict=True))
        places = frame.placed(np.stack(np.broadcast_arrays(u[None], v[:, None], 0.0), axis=-1))
        # The zero of the signed distance is the outline of bodies of every kind, without a section of each.
        away = nearest_distance(t.obstacles, places)
        axes.contourf(u * TO_MM, v * TO_MM, away, levels=[-np.inf, 0.0], colors=[BODY])
        axes.contour(u * TO_MM, v * TO_MM, away, levels=[0.0], colors=[FAINT], linewidths=0.7)
    for line in lines[:-1]:
        axes.plot(*(frame.seen(line)[:, :2].T * TO_MM), color=ARM, lw=0.6, alpha=0.5, label="before")
    _draw_arm(axes, arms[-1], plane)
    axes.plot(*(frame.seen(t.tip_position[-1])[:2, None] * TO_MM), "o", color=INK, ms=3, zorder=4, label="tip")
    axes.set(xlim=TO_MM * np.array([low[0], high[0]]), ylim=TO_MM * np.array([low[1], high[1]]), aspect="equal")
    axes.set(xlabel="to the right in the plane (mm)", ylabel="upwards in the plane (mm)")
    for colour, what in ((ARM, "arm, cut"), (BESIDE, "arm, beside"), (BODY, "body, cut")):
        axes.fill([], [], color=colour, label=what)
    signs = dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    legend_beside(axes, signs.values(), signs.keys())
    place, across = (
        ", ".join(number(float(x), digits) for x in row)
        for row, digits in ((plane.point * TO_MM, 1), (plane.normal, 2))
    )
    headed(figure, f"{title or t.robot.name or 'robot'}\nplane through {place} mm, square to {across}")
    return figure


def _draw_arm(axes: Axes, arm: Equilibrium, plane: Plane) -> None:
    """An arm as the balls about its centreline: all of them as they are seen, and what the plane cuts of them."""
    from matplotlib.collections import EllipseCollection

    line, radius = ArmSurface(arm).line(ALONG)
    at, height = plane.frame.seen(line)[:, :2] * TO_MM, plane.height(line)
    # A plane at height h cuts a ball of radius r in a disc of radius sqrt(r^2 - h^2).
    for half, colour in ((radius, BESIDE), (np.sqrt(np.maximum(radius**2 - height**2, 0.0)), ARM)):
        wide = 2 * TO_MM * half[half > 0]
        where: dict[str, Any] = {"units": "xy", "offsets": at[half > 0], "offset_transform": axes.transData}
        # Hundreds of discs as one collection: single patches would take seconds and megabytes of PDF.
        axes.add_collection(EllipseCollection(wide, wide, 0 * wide, color=colour, lw=0, zorder=3, **where))


ARMS_SHOWN = 6
"""Instants at which the arms are drawn in the picture."""

ARMS_FRAMES = 24
"""Pictures of the film."""

CURVE = 160
"""Instants of the curve of distances."""


@picture
def plot_arms(plan: ArmsPlan, *, title: str = "", view: tuple[float, float] | None = None) -> Figure:
    """Figure of a plan of several arms: all arms to scale at some instants, and their distances over time.

    Args:
        title: heading; by default what the arms are called.
        view: elevation and azimuth of the viewer, deg; None looks across the widest side of the motion.
    """
    figure = new_figure(10.0, 4.8)
    scene, curve = figure.subplots(1, 2, width_ratios=(1.25, 1.0))
    sweeps = _sweeps(plan, np.linspace(0.0, plan.duration, ARMS_SHOWN))
    _draw(scene, plan, sweeps, stage_for(sweeps, plan.obstacles, view))
    _distances(curve, plan, np.linspace(0.0, plan.duration, CURVE))
    curve.legend(loc="best")
    headed(figure, title or " and ".join(arm.called for arm in plan.arms))
    return figure


@styled
def animate_arms(
    plan: ArmsPlan, path: str | PathLike[str], *, frames: int = ARMS_FRAMES, view: tuple[float, float] | None = None
) -> Path:
    """The moving arms as a film, with the distances between them below: GIF, or MP4 where there is ffmpeg.

    Raises:
        InputError: the file cannot be written, its name ends otherwise, or ffmpeg is missing.
    """
    film_ending(path)
    times = np.linspace(0.0, plan.duration, frames)
    stage = stage_for(_sweeps(plan, times), plan.obstacles, view)

    def draw(scene: Axes, below: Axes, k: int) -> None:
        _draw(scene, plan, _sweeps(plan, times[k : k + 1]), stage)
        _distances(below, plan, times)
        below.axvline(float(times[k]), color=INK, lw=0.8)

    return save_film(path, f"{len(plan.arms)} arms: {number(plan.duration, 1)} s", frames, draw)


def _sweeps(plan: ArmsPlan, times: Array) -> list[Sweep]:
    """Every arm at some instants, and the way of its tip up to the last."""
    out = []
    rows = zip(*(plan.rows_at(float(t)) for t in times), strict=True)
    for arm, motion, own in zip(plan.arms, plan.trajectories, rows, strict=True):
        passed = slice(own[-1] + 1)
        tips = arm.base.placed(motion.tip_position[passed])
        out.append(Sweep([motion.arms[row] for row in own], motion.time[passed], tips, arm.base))
    return out


def _draw(scene: Axes, plan: ArmsPlan, sweeps: list[Sweep], stage: tuple[View, Box]) -> None:
    """All arms, with their names."""
    draw_sweeps(scene, stage, sweeps, plan.obstacles, faint=0.15)
    for arm in plan.arms:
        note(scene, arm.called, stage[0].project(arm.base.origin)[:2], np.array([7.0, 0.0]))


def _distances(axes: Axes, plan: ArmsPlan, times: Array) -> None:
    gaps = plan.clearance(times) * TO_MM
    for k, pair in enumerate(plan.proof.pairs):
        words = f"arms {pair.arms[0] + 1} and {pair.arms[1] + 1}"
        line = axes.plot(times, gaps[:, k], lw=1.4, color=INK if k == 0 else None, label=words)[0]
        if np.isfinite(pair.least_clearance):
            axes.axhline(
                pair.least_clearance * TO_MM, lw=0.8, color=line.get_color(), ls=":", label="proved at all times"
            )
    axes.axhline(plan.min_clearance * TO_MM, color=FAINT, lw=0.8, ls="--", label="required")
    axes.set(xlabel="time (s)", ylabel="between arms (mm)")
    axes.set_ylim(bottom=0)

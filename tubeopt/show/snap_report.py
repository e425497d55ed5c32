"""Reports on other equilibria, snaps, and robots under a load."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group, RenderableType
from rich.text import Text

from .. import stability
from ..equilibrium.readings import to_readings
from ..equilibrium.result import Equilibrium, FrictionState
from ..files.csv_file import to_csv
from ..files.files import save_arrays, write_text
from ..files.units import DEG, TO_MILLI, TO_MM, in_unit
from ..robots.file import joint_cells, joint_columns
from ..robots.load import Load
from ..robots.order import ends_inside, out_of_order
from ..runs.stability_studies import Equilibria, LoadLimitResult, RobotMap, StraightMotion
from ..stability import LoadLimit, Snap, SnapInTime
from ..typing import Array
from ..validation import ForceEstimate, ForceRecord
from .formatting import counted, degrees, in_a_word, margin_text, millimetres, released, row, tip_number
from .quantities import Quantity, described, line, load_text, of_field, readings, record, rows, within
from .report import Drawing, Report, drawing, grid, remarks, to_text, two_columns

JOINTS: tuple[Quantity[Any], ...] = tuple(
    of_field(Equilibrium, name, form="") for name in ("rotations", "translations")
)
"""Joint values of an answer."""

STATE = described(
    Equilibrium,
    Quantity("stable", "true if it is stable"),
    "margin index energy",
    Quantity("potential_mJ", "elastic energy less the work of the load; absent without load, null without an energy",
             lambda e: None if e.load is None else e.potential, optional=True),
    *within([of_field(FrictionState, name, optional=True) for name in ("held_margin", "heat")], lambda e: e.friction),
    Quantity("tip_position_mm", "tip position in the frame of the plate"),
    Quantity("tip_direction", "direction of the tip", lambda e: e.tip_rotation[:, 2]),
    "tip_rotations",
)  # fmt: skip
"""An equilibrium in short."""

EQUILIBRIA = described(
    Equilibria,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    *JOINTS,
    *readings(lambda a: a.equilibria[0]),
    of_field(Equilibria, "equilibria", of=(*STATE, *described(Equilibrium, "residual tip_error"))),
)  # fmt: skip

SNAP = described(
    Snap,
    "fraction",
    Quantity("rotations_deg", "rotations at the snap", label="snap at rotations", form=".9g"),
    Quantity("translations_mm", "translations at the snap", form=".9g", label="translations"),
    *readings(lambda snap: snap.before),
    line("tip before", lambda snap: millimetres(snap.before.tip_position, ".4f")),
    line("tip after", lambda snap: millimetres(snap.after.tip_position, ".4f")),
    Quantity("tip_jump_mm", "distance that the tip jumps", form=".4f", label="the tip jumps"),
    Quantity(
        "energy_released_mJ",
        "energy released; null for a load without energy",
        label="energy released",
        text=lambda snap: released(snap.energy_released, "{:.4f} mJ") or None,
    ),
    line("tubes' tips before", lambda snap: degrees(snap.before.tip_rotations, ".6f")),
    line("tubes' tips after", lambda snap: degrees(snap.after.tip_rotations, ".6f")),
    line("margin after", lambda snap: margin_text(snap.after.margin)),
    of_field(Snap, "before", of=STATE),
    of_field(Snap, "after", of=STATE),
)

IN_TIME = described(
    SnapInTime,
    "duration peak_speed",
    Quantity("energy_released_mJ", "energy released"),
    of_field(SnapInTime, "swept_area"),
    of_field(SnapInTime, "swept_volume"),
    of_field(SnapInTime, "tip_path"),
    Quantity("dissipated_mJ", "energy dissipated in the material until the end", lambda m: m.dissipated[-1]),
    Quantity("drive_work_mJ", "work of the drives until the end", lambda m: m.drive_work[-1]),
    "frequencies damping_ratios",
    Quantity("simulated_ms", "simulated time", lambda m: m.time[-1], form=".3f"),
    Quantity("steps", "number of time steps", lambda m: m.statistics.steps, form="d"),
    "energy_error",
    of_field(SnapInTime, "relaxation", text="{relaxation_us:g} us, {damping}"),
    Quantity("damping", "source of the damping: assumed, or given", lambda m: "given" if m.given else "assumed: speeds "
             "depend on it, see docs/snap-in-time.md"),
    Quantity("status", "end of the motion, as a sentence", lambda m: str(m.status), label="in time",
             text="{status}"),
)  # fmt: skip

STRAIGHT_MOTION = described(
    StraightMotion,
    Quantity("robot", "name of the robot", lambda w: w.robot.name),
    Quantity("from_deg", "rotations at the start", lambda w: w.start[0]),
    Quantity("from_mm", "translations at the start", lambda w: w.start[1]),
    Quantity("to_deg", "rotations at the end", lambda w: w.end[0]),
    Quantity("to_mm", "translations at the end", lambda w: w.end[1]),
    Quantity("answer", "result, as text", lambda w: motion_sentence(w)),
    line("from", "rotations {from_deg:.9g} deg, translations {from_mm:.9g} mm"),
    line("to", "rotations {to_deg:.9g} deg, translations {to_mm:.9g} mm"),
    of_field(StraightMotion, "snap", of=SNAP),
    of_field(StraightMotion, "arrived", label="tip at the end", text="{arrived[tip_position_mm]:.4f} mm", of=STATE),
    of_field(StraightMotion, "in_time", of=IN_TIME, optional=True),
)  # fmt: skip

PATH = described(
    stability.Path,
    Quantity("robot", "name of the robot", lambda m: m.equilibria[0].robot.name),
    line("least margin", lambda m: f"{min(e.margin for e in m.equilibria):.3f} at a waypoint"),
    line("friction", lambda m: _friction_text(m)),
    Quantity("waypoints", "the state at every waypoint", lambda m: list(m.equilibria), of=(*JOINTS, *STATE)),
    line("tip at the end", lambda m: millimetres(m.equilibria[-1].tip_position, ".4f")),
    Quantity("remarks", "carriages out of order, or an outer tube at the tip; absent otherwise",
             lambda m: _remarks(m) or None, optional=True),
    of_field(stability.Path, "snaps", of=(
        Quantity("after_waypoint", "number of the waypoint before it, from 1", lambda snap: snap.index + 1), *SNAP)),
)  # fmt: skip


def _remarks(m: stability.Path) -> list[str]:
    """Remarks on the order of carriages, and on an outer tube at the tip."""
    waypoints: dict[str, list[int]] = {}
    for k, e in enumerate(m.equilibria, start=1):
        violations = [demand.broken for demand, _ in out_of_order(e.robot, e.translations)]
        inside, tip = ends_inside(e.robot, e.tube_end), tip_number(e)
        if inside and tip is not None:
            numbers = ", ".join(str(end.tube + 1) for end in inside)
            violations.append(f"the tip is the end of tube {tip}, and tube {numbers} ends inside an outer tube")
        for violation in violations:
            # One remark for all waypoints with the same violation: a path may have thousands.
            waypoints.setdefault(violation, []).append(k)
    texts = []
    for violation, (first, *further) in waypoints.items():
        more = f" and {counted(len(further), 'other')}" if further else ""
        texts.append(f"{violation}, at waypoint {first}{more}")
    return texts


def _friction_text(m: stability.Path) -> str | None:
    """Effect of friction along the path, as text; None without friction."""
    last = m.equilibria[-1].friction
    if last is None:
        return None
    return f"took {last.heat * TO_MILLI:.3f} mJ; tubes stick at {100 * last.sticking.mean():.0f} % of where they rub"


def motion_sentence(w: StraightMotion) -> str:
    """Snaps along the path, as text."""
    if w.snap is not None:
        return (
            f"snaps {100 * w.snap.fraction:.6f} % of the path, at rotations {degrees(w.snap.rotations)}, "
            f"translations {millimetres(w.snap.translations)}"
        )
    margin = "" if w.arrived is None else f", with margin {w.arrived.margin:.3f}"
    return f"does not snap: the branch reaches the end of the path{margin}"


class EquilibriaReport(Report[Equilibria]):
    command = "equilibria"
    quantities = EQUILIBRIA
    file = "equilibria.json"
    drawn = (("equilibria", "shape.plot_equilibria", "equilibria"),)

    def table(self) -> Group:
        """A row per equilibrium."""
        a = self.answer
        stable = sum(e.stable for e in a.equilibria)
        count = counted(len(a.equilibria), "equilibrium", "equilibria")
        head = f"{a.robot.name or 'robot'}: {count} ({stable} stable) at rotations {degrees(a.rotations)}"
        cells = [
            (
                row(e.tip_position * TO_MM, ".2f"),
                row(np.degrees(e.tip_rotations), ".2f"),
                f"{e.margin:.4f}",
                "none" if np.isnan(e.potential) else f"{e.potential * TO_MILLI:.4f}",
                str(e.index),
                in_a_word(e.margin),
            )
            for e in a.equilibria
        ]
        columns = ("tip (mm)", "tubes' tips (deg)", "margin >", "mJ >", "index >", "")
        return Group(Text(f"{head}, translations {millimetres(a.translations)}"), grid(columns, cells))


class StraightMotionReport(Report[StraightMotion]):
    command = "snap"
    quantities = STRAIGHT_MOTION
    file = "snap.json"
    drawn = (("snap", "shape.plot_shape", "arrived"), ("snap", "path.plot_snap", "snap"),
             ("snap_in_time", "snap_in_time.plot_snap_in_time", "in_time"))  # fmt: skip

    def table(self) -> Group:
        """The answer in words, then the numbers of the snap."""
        w = self.answer
        numbers = self.rows() + ([] if w.snap is None else rows(w.snap, SNAP))
        numbers += [] if w.in_time is None else rows(w.in_time, IN_TIME)
        return Group(Text(f"{w.robot.name or 'the robot'} {motion_sentence(w)}"), two_columns("", numbers))

    def save(self, directory: Path) -> list[Path]:
        """Write snap.json and, for a snap in time, snap_in_time.csv with a row per time step."""
        paths, m = super().save(directory), self.answer.in_time
        if m is None:
            return paths
        tips = [f"tip_rotation_{i + 1}_deg" for i in range(m.tip_rotations.shape[1])]
        energies = ["kinetic_mJ", "potential_mJ", "dissipated_mJ", "drive_work_mJ"]
        columns = ["time_ms", "tip_x_mm", "tip_y_mm", "tip_z_mm", *tips, *energies]
        spent = np.column_stack([m.kinetic, m.potential, m.dissipated, m.drive_work])
        table = np.column_stack(
            [m.time * TO_MILLI, m.tip_position * TO_MM, np.degrees(m.tip_rotations), spent * TO_MILLI]
        )
        write_text(directory / "snap_in_time.csv", to_csv(columns, ([f"{v:.9g}" for v in each] for each in table)))
        return [*paths, directory / "snap_in_time.csv"]

    def films(self) -> dict[str, Drawing]:
        """Film of a snap in time."""
        m = self.answer.in_time
        return {} if m is None else {"snap_in_time": drawing("snap_in_time.animate_snap", m)}

    def solids(self) -> dict[str, Equilibrium]:
        """Arms before and after the snap, or at the end of the path, to save as meshes."""
        w = self.answer
        if w.snap is not None:
            return {"before": w.snap.before, "after": w.snap.after}
        return {} if w.arrived is None else {"arm": w.arrived}


class PathReport(Report[stability.Path]):
    command = "follow"
    quantities = PATH
    drawn = (("path", "path.plot_path"),)

    def title(self) -> str:
        path = self.answer
        count = counted(len(path.snaps), "snap", none="no snap")
        return f"{path.equilibria[0].robot.name or 'robot'}: {len(path.equilibria)} waypoints, {count}"

    def below(self) -> list[RenderableType]:
        """A row per snap."""
        cells = [
            (
                f"{snap.index + 1} to {snap.index + 2}",
                f"{100 * snap.fraction:.3f}",
                row(np.degrees(snap.rotations), ".7g"),
                row(snap.translations * TO_MM, ".6g"),
                f"{snap.tip_jump * TO_MM:.3f}",
                released(snap.energy_released, "{:.4f}"),
            )
            for snap in self.answer.snaps
        ]
        columns = ("waypoints", "at (%) >", "rotations (deg)", "translations (mm)", "tip jump (mm) >", "energy (mJ) >")
        return [*([grid(columns, cells, title="snaps")] if cells else []), *super().below()]

    def save(self, directory: Path) -> list[Path]:
        """Write path.csv, the dense path with two rows at every snap, and snaps.json."""
        turns, shifts = joint_columns(self.answer.equilibria[0].robot.n_tubes)
        columns = ["waypoint", *turns, *shifts, "tip_x_mm", "tip_y_mm", "tip_z_mm", "margin"]
        path, snaps = directory / "path.csv", directory / "snaps.json"
        write_text(path, to_csv(columns, self._cells()))
        write_text(snaps, to_text({key: record(self.answer, PATH)[key] for key in ("robot", "snaps")}))
        return [path, snaps]

    def _cells(self) -> Iterator[Sequence[object]]:
        for part in self.answer.dense:
            for at, e in zip(part.at, part.equilibria, strict=True):
                tip = [round(float(x), 9) + 0.0 for x in e.tip_position * TO_MM]
                joints = joint_cells(*to_readings(e.robot, e.rotations, e.translations))
                yield [f"{at:.9g}", *joints, *tip, round(e.margin, 12)]

    def tables(self) -> dict[str, Any]:
        return {"path": self.answer}


def _nearest(a: RobotMap) -> Array | None:
    """Rotations (2,) of the nearest snap, by the larger rotation, rad; None without snaps."""
    boundary = a.map.boundary
    # Directions without a snap are NaN.
    boundary = boundary[np.isfinite(boundary).all(1)]
    # Maximum norm: both drives turn at once, and the larger turn takes the time.
    return boundary[np.argmin(np.abs(boundary).max(1))] if len(boundary) else None


def _min_margin_before_snap(a: RobotMap) -> float | None:
    """Smallest margin of the points reached without a snap; None without any."""
    snapped = a.map.snaps > 0
    return None if snapped.all() else float(a.map.margin[~snapped].min())


def _snapping_fraction(a: RobotMap) -> float:
    """Fraction of all directions from home that snap; directions are weighted by their spacing."""
    angles = a.map.directions
    # Half of the distance between both neighbours, times 2; directions need not be even.
    weights = np.roll(angles, -1) - np.roll(angles, 1)
    # The neighbours of the first and last direction are a turn away.
    weights[[0, -1]] += 2 * np.pi
    # The weights add to 4 pi, twice a turn.
    return float(weights @ np.isfinite(a.map.boundary).all(1)) / (4 * np.pi)


MAP = described(
    RobotMap,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    line("axes", "rotations of tubes {tubes[0]} and {tubes[1]} from -180 to 180 deg, {samples} points each"),
    "translations",
    Quantity("tubes", "the two rotated tubes, from 1", lambda a: [tube + 1 for tube in a.map.tubes]),
    Quantity("samples", "points per axis", lambda a: len(a.map.angles)),
    Quantity("directions", "number of directions searched for the first snap", lambda a: len(a.map.boundary)),
    Quantity("least_margin", "smallest margin", lambda a: a.map.margin.min(), form=".3f", label="least margin"),
    Quantity("least_margin_before_a_snap", "smallest margin of the points reached without a snap",
             _min_margin_before_snap),
    Quantity("snapped_fraction", "fraction of the map that is reached after a snap", lambda a: (a.map.snaps > 0).mean(),
             label="reached after a snap", text=lambda a: f"{100 * (a.map.snaps > 0).mean():.1f} % of the map"),
    Quantity("most_snaps", "largest number of snaps on the path to a point", lambda a: a.map.snaps.max()),
    Quantity("snapping_fraction", "fraction of all directions from home with a snap", _snapping_fraction,
             label="directions with a snap", text=lambda a: f"{100 * _snapping_fraction(a):.1f} % of all directions"),
    Quantity("nearest_snap_deg", "nearest snap: smallest rotation from home", _nearest, label="the nearest snap",
             text="at {nearest_snap_deg:.6f} deg"),
    Quantity("directions_deg", "directions, from the axis of the first tube", lambda a: a.map.directions),
    Quantity("boundary_deg", "rotations of the first snap in every direction", lambda a: a.map.boundary),
)  # fmt: skip


class RobotMapReport(Report[RobotMap]):
    command = "stability-map"
    quantities = MAP

    def title(self) -> str:
        return f"{self.answer.robot.name or 'robot'}: stability map"

    def save(self, directory: Path) -> list[Path]:
        """Write map.npz: the fields of `StabilityMap` and the translations, in SI."""
        chart = self.answer.map
        fields = {
            name: getattr(chart, name)
            for name in ("tubes", "angles", "margin", "snaps", "directions", "boundary", "approach")
        }
        return [save_arrays(directory / "map.npz", translations=self.answer.translations, **fields)]

    def pictures(self) -> dict[str, Drawing]:
        return {"stability_map": drawing("maps.plot_stability_map", self.answer.map, title=self.answer.robot.name)}


SHOWN = 20
"""Rows of a recording that a table shows."""

HAPPENS = {
    "fold": "the equilibrium vanishes, and the robot snaps",
    "bifurcation": "the equilibrium turns unstable, and the robot leaves it to one of two sides",
    "ends": "ends of tubes separate or pass each other, and the robot snaps",
    "flutter": "the equilibrium turns unstable: slow oscillations about it grow",
}

LIMIT = described(
    LoadLimit,
    of_field(LoadLimit, "factor", label="lost at", text="{factor:.9g} times the load"),
    of_field(LoadLimit, "kind", label="there", text=lambda a: HAPPENS[a.kind]),
    line("tip before", lambda a: millimetres(a.before.tip_position, ".4f")),
    line("tip after", lambda a: None if a.after is None else millimetres(a.after.tip_position, ".4f")),
    of_field(LoadLimit, "tip_jump", label="the tip jumps",
             text=lambda a: None if a.after is None else f"{a.tip_jump * TO_MM:.4f} mm"),
    of_field(LoadLimit, "energy_released", label="energy released by tubes and load",
             text=lambda a: released(a.energy_released, "{:.4f} mJ") or None),
    line("margin after", lambda a: _margin_after_text(a)),
    of_field(LoadLimit, "before", of=STATE),
    of_field(LoadLimit, "after", of=STATE),
)  # fmt: skip


def _margin_after_text(limit: LoadLimit) -> str | None:
    """Margin of the equilibrium after the limit, as text."""
    if limit.after is None:
        return None
    if limit.kind == "bifurcation":
        # The load of `after` exceeds the limit by a small fraction, so its margin is small and no sign of a snap.
        return f"{limit.after.margin:.1e}, at a load just above the limit"
    return margin_text(limit.after.margin)


LOAD_LIMIT = described(
    LoadLimitResult,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    *JOINTS,
    Quantity("load", "the load, as text", lambda a: load_text(a.load), label="load", text="{load}"),
    "up_to",
    of_field(LoadLimitResult, "limit", of=LIMIT),
)  # fmt: skip


def _size(load: Load, factor: float) -> str:
    """Text of a multiple of a load: its tip force and moment if it has no other parts, and the factor."""
    # Of a combined load no single size is meaningful; the factor alone is reported.
    alone = not load.points and load.distributed is None and load.gravity is None
    sizes = [(factor * float(np.linalg.norm(part)), unit) for part, unit in ((load.force, "N"), (load.moment, "N m"))]
    parts = [f"{x:.4g} {unit}" if x >= 1 else f"{x * TO_MILLI:.4g} m{unit}" for x, unit in sizes if x > 0]
    times = f"{factor:.6g} times the load"
    return f"{' and '.join(parts)} at the tip ({times})" if alone and parts else times


class LoadLimitReport(Report[LoadLimitResult]):
    command = "load-limit"
    quantities = LOAD_LIMIT
    file = "load_limit.json"

    def title(self) -> str:
        a = self.answer
        name = a.robot.name or "the robot"
        if a.limit is None:
            return f"{name} withstands at least {_size(a.load, a.up_to)}, the largest load searched (--up-to)"
        return f"{name} withstands {_size(a.load, a.limit.factor)}"

    def rows(self) -> list[tuple[str, str]]:
        """Rows (name, text) of the load, then of the limit."""
        limit = self.answer.limit
        return super().rows() + ([] if limit is None else rows(limit, LIMIT))

    def pictures(self) -> dict[str, Drawing]:
        """Drawing of the robot at the load limit, with a translucent robot after it."""
        limit = self.answer.limit
        if limit is None:
            return {}
        remark = f"{limit.factor:.4g} times the load, where the equilibrium is lost"
        if limit.after is None:
            return {"load_limit": drawing("shape.plot_shape", limit.before, remark=remark)}
        return {"load_limit": drawing("shape.plot_shape", limit.before, ghosts=[limit.after],
                                      remark=f"{remark}; ghost: where the robot lands")}  # fmt: skip


FORCE = described(
    ForceEstimate,
    "force",
    Quantity("standard_error_mN", "standard error along each axis; null if undetermined",
             lambda e: np.sqrt(np.diag(e.covariance))),
    "directions errors",
    Quantity("undetermined", "directions in which the force cannot be distinguished from zero", label="",
             text="{undetermined}"),
    "residual",
)  # fmt: skip

ESTIMATE: tuple[Quantity[tuple[int, ForceEstimate]], ...] = (
    Quantity("row", "row of the recording, from 1", lambda estimate: estimate[0]),
    *within(FORCE, lambda estimate: estimate[1]),
)


CONFIDENCE = (
    "standard errors are to second order in the noise; ForceEstimate.coverage computes how often the ellipsoid of a "
    "row contains the force, and contains asks the region of the likelihood"
)
"""Remark on standard errors."""

RECORD = described(
    ForceRecord,
    Quantity("robot", "name of the robot", lambda r: r.robot.name),
    Quantity("rows", "number of rows of the recording", lambda r: len(r.estimates), form="d",
             label="rows of the recording"),
    Quantity("estimated", "number of rows with an estimate", lambda r: sum(e is not None for e in r.estimates),
             form="d", label="rows with an estimate"),
    "noise",
    line("largest force", lambda r: _largest_force_text(r)),
    line("standard errors (median)", lambda r: _standard_errors_text(r)),
    line("confidence", lambda r: CONFIDENCE if _estimates(r) else None),
    line("not significant", lambda r: _undetermined_text(r)),
    Quantity("estimates", "the force in every row with an estimate", lambda r: _estimates(r), of=ESTIMATE),
    Quantity("failures", "rows without an estimate, from 1, and the reason",
             lambda r: [[k + 1, why] for k, why in r.failures]),
    Quantity("remarks", "effects of the robot that the estimates ignore"),
)  # fmt: skip


def _largest_force_text(r: ForceRecord) -> str | None:
    sizes = np.linalg.norm(r.force, axis=1)
    if np.isnan(sizes).all():
        return None
    k = int(np.nanargmax(sizes))
    return f"{sizes[k] * TO_MILLI:.4g} mN in row {k + 1}: {row(r.force[k] * TO_MILLI, '.4g')} mN"


def _standard_errors_text(r: ForceRecord) -> str | None:
    # NaN: undetermined, or no estimate.
    known = r.standard_error[~np.isnan(r.standard_error[:, 0])]
    return f"{row(np.median(known, axis=0) * TO_MILLI, '.3g')} mN along x, y, z" if len(known) else None


def _estimates(r: ForceRecord) -> list[tuple[int, ForceEstimate]]:
    """Numbers, from 1, of the rows with an estimate, and their estimates."""
    return [(k, e) for k, e in enumerate(r.estimates, start=1) if e is not None]


def _undetermined_text(r: ForceRecord) -> str:
    """Number of rows with an undetermined direction, as text."""
    count = sum(e is not None and e.undetermined.startswith("undetermined") for e in r.estimates)
    return f"in some direction in {counted(count, 'row', none='no row')}"


class ForceReport(Report[ForceRecord]):
    command = "force"
    quantities = RECORD
    file = "forces.json"

    def title(self) -> str:
        r = self.answer
        return f"{r.robot.name or 'robot'}: forces on the tip in {counted(len(r.estimates), 'row')}"

    def rows(self) -> list[tuple[str, str]]:
        """Rows (name, text) of the recording, then of its first failures."""
        return [*super().rows(), *((f"row {k + 1}", why) for k, why in self.answer.failures[:5])]

    def below(self) -> list[RenderableType]:
        """First rows of the table."""
        estimates = _estimates(self.answer)
        columns = ("row >", "force x, y, z (mN) >", "size (mN) >", "standard errors (mN) >")
        cells = (
            [
                str(k),
                row(e.force * TO_MILLI, ".2f"),
                f"{np.linalg.norm(e.force) * TO_MILLI:.2f}",
                row(np.sqrt(np.diag(e.covariance)) * TO_MILLI, ".3g"),
            ]
            for k, e in estimates[:SHOWN]
        )
        more = len(estimates) - SHOWN
        further = [f"and {counted(more, 'row')} more, which --out saves in forces.csv"] if more > 0 else []
        return [grid(columns, cells), *remarks(further), *remarks(self.answer.remarks, what="remark")]

    def save(self, directory: Path) -> list[Path]:
        """Write forces.json, and forces.csv with a row per row of the recording."""
        path = directory / "forces.csv"
        turns = [f"rotation_{i + 1}_deg" for i in range(self.answer.robot.n_tubes)]
        axes = [f"{name}_{axis}_mN" for name in ("force", "standard_error") for axis in "xyz"]
        corners = [f"covariance_{a}{b}_mN2" for a, b in ("xx", "xy", "xz", "yy", "yz", "zz")]
        write_text(path, to_csv(["row", *turns, *axes, *corners, "residual_mm"], self._cells()))
        return [self.save_record(directory), path]

    def _cells(self) -> Iterator[list[object]]:
        # Row by row: xx, xy, xz, yy, yz, zz, as the columns are named.
        upper = np.triu_indices(3)
        for k, e in enumerate(self.answer.estimates):
            turns = [in_unit(float(a), DEG) for a in self.answer.measurements.rotations[k]]
            if e is None:
                # 3 components, 3 standard errors, 6 covariances and the residual.
                yield [k + 1, *turns, *[""] * 13]
                continue
            numbers = np.concatenate([e.force, np.sqrt(np.diag(e.covariance))]) * TO_MILLI
            # N^2 to mN^2.
            square = e.covariance[upper] * TO_MILLI**2
            yield [k + 1, *turns, *(f"{v:.9g}" for v in (*numbers, *square, e.residual * TO_MM))]

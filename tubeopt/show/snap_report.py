"""What is said and saved about equilibria, about a snap, about motion with snaps, and about a map of them."""

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
from ..files.units import TO_MILLI, TO_MM
from ..robots.file import joint_cells, joint_columns
from ..robots.order import ends_inside, out_of_order
from ..runs.stability_studies import Equilibria, RobotMap, Way
from ..stability import Snap
from ..typing import Array
from .formatting import counted, degrees, in_a_word, margin_in_words, millimetres, released, row, tip_number
from .quantities import Quantity, described, line, of_field, record, rows, within
from .readings import readings
from .report import Drawing, Report, drawing, grid, to_text, two_columns

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
        words=lambda snap: released(snap.energy_released, "{:.4f} mJ") or None,
    ),
    line("tubes' tips before", lambda snap: degrees(snap.before.tip_rotations, ".6f")),
    line("tubes' tips after", lambda snap: degrees(snap.after.tip_rotations, ".6f")),
    line("margin after", lambda snap: margin_in_words(snap.after.margin)),
    of_field(Snap, "before", of=STATE),
    of_field(Snap, "after", of=STATE),
)

WAY = described(
    Way,
    Quantity("robot", "name of the robot", lambda w: w.robot.name),
    Quantity("from_deg", "rotations at the start", lambda w: w.start[0]),
    Quantity("from_mm", "translations at the start", lambda w: w.start[1]),
    Quantity("to_deg", "rotations at the end", lambda w: w.end[0]),
    Quantity("to_mm", "translations at the end", lambda w: w.end[1]),
    Quantity("answer", "result, as text", lambda w: way_sentence(w)),
    line("from", "rotations {from_deg:.9g} deg, translations {from_mm:.9g} mm"),
    line("to", "rotations {to_deg:.9g} deg, translations {to_mm:.9g} mm"),
    of_field(Way, "snap", of=SNAP),
    of_field(Way, "arrived", label="tip at the end", words="{arrived[tip_position_mm]:.4f} mm", of=STATE),
)  # fmt: skip

PATH = described(
    stability.Path,
    Quantity("robot", "name of the robot", lambda m: m.equilibria[0].robot.name),
    line("least margin", lambda m: f"{min(e.margin for e in m.equilibria):.3f} at a waypoint"),
    line("friction", lambda m: _rubbed(m)),
    Quantity("waypoints", "the state at every waypoint", lambda m: list(m.equilibria), of=(*JOINTS, *STATE)),
    line("tip at the end", lambda m: millimetres(m.equilibria[-1].tip_position, ".4f")),
    Quantity("remarks", "carriages out of order, or an outer tube at the tip; absent otherwise",
             lambda m: _remarks(m) or None, optional=True),
    of_field(stability.Path, "snaps", of=(
        Quantity("after_waypoint", "number of the waypoint before it, from 1", lambda snap: snap.index + 1), *SNAP)),
)  # fmt: skip


def _remarks(m: stability.Path) -> list[str]:
    """Where carriages are out of order, or an outer tube is the tip, in words."""
    found: dict[str, list[int]] = {}
    for k, e in enumerate(m.equilibria, start=1):
        said = [demand.broken for demand, _ in out_of_order(e.robot, e.translations)]
        inside, tip = ends_inside(e.robot, e.tube_end), tip_number(e)
        if inside and tip is not None:
            within = ", ".join(str(one.tube + 1) for one in inside)
            said.append(f"the tip is the end of tube {tip}, and tube {within} ends inside an outer tube")
        for words in said:
            found.setdefault(words, []).append(k)
    return [f"{words}, {_waypoints(where)}" for words, where in found.items()]


def _waypoints(where: Sequence[int]) -> str:
    return f"at waypoint {where[0]}" + (f" and {counted(len(where) - 1, 'other')}" if len(where) > 1 else "")


def _rubbed(m: stability.Path) -> str | None:
    """What friction did on the way; None without friction."""
    last = m.equilibria[-1].friction
    if last is None:
        return None
    return f"took {last.heat * TO_MILLI:.3f} mJ; tubes stick at {100 * last.sticking.mean():.0f} % of where they rub"


def way_sentence(w: Way) -> str:
    """What happens on the way."""
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


class WayReport(Report[Way]):
    command = "snap"
    quantities = WAY
    file = "snap.json"
    drawn = (("snap", "shape.plot_shape", "arrived"), ("snap", "path.plot_snap", "snap"))

    def table(self) -> Group:
        """The answer in words, then the numbers of the snap."""
        w = self.answer
        numbers = self.rows() + ([] if w.snap is None else rows(w.snap, SNAP))
        return Group(Text(f"{w.robot.name or 'the robot'} {way_sentence(w)}"), two_columns("", numbers))

    def solids(self) -> dict[str, Equilibrium]:
        """The arm before and after the snap, or arrived."""
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
    """The snap that needs the least turning of the tube that turns more; None without snaps."""
    boundary = a.map.boundary
    boundary = boundary[np.isfinite(boundary).all(1)]
    return boundary[np.argmin(np.abs(boundary).max(1))] if len(boundary) else None


def _least_before(a: RobotMap) -> float | None:
    snapped = a.map.snaps > 0
    return None if snapped.all() else float(a.map.margin[~snapped].min())


def _snapping_fraction(a: RobotMap) -> float:
    """Part of all directions; each stands for those that are closer to it than to its neighbours."""
    angles = a.map.directions
    wide = np.roll(angles, -1) - np.roll(angles, 1)
    wide[[0, -1]] += 2 * np.pi
    return float(wide @ np.isfinite(a.map.boundary).all(1)) / (4 * np.pi)


MAP = described(
    RobotMap,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    line("axes", "rotations of tubes {tubes[0]} and {tubes[1]} from -180 to 180 deg, {samples} points each"),
    "translations",
    Quantity("tubes", "the two rotated tubes, from 1", lambda a: [tube + 1 for tube in a.map.tubes]),
    Quantity("samples", "points per axis", lambda a: len(a.map.angles)),
    Quantity("directions", "number of directions searched for the first snap", lambda a: len(a.map.boundary)),
    Quantity("least_margin", "smallest margin", lambda a: a.map.margin.min(), form=".3f", label="least margin"),
    Quantity("least_margin_before_a_snap", "smallest margin of the points reached without a snap", _least_before),
    Quantity("snapped_fraction", "fraction of the map that is reached after a snap", lambda a: (a.map.snaps > 0).mean(),
             label="reached after a snap", words=lambda a: f"{100 * (a.map.snaps > 0).mean():.1f} % of the map"),
    Quantity("most_snaps", "largest number of snaps on the path to a point", lambda a: a.map.snaps.max()),
    Quantity("snapping_fraction", "fraction of all directions from home with a snap", _snapping_fraction,
             label="directions with a snap", words=lambda a: f"{100 * _snapping_fraction(a):.1f} % of all directions"),
    Quantity("nearest_snap_deg", "nearest snap: smallest rotation from home", _nearest, label="the nearest snap",
             words="at {nearest_snap_deg:.6f} deg"),
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
        found = self.answer.map
        fields = {
            name: getattr(found, name)
            for name in ("tubes", "angles", "margin", "snaps", "directions", "boundary", "approach")
        }
        return [save_arrays(directory / "map.npz", translations=self.answer.translations, **fields)]

    def pictures(self) -> dict[str, Drawing]:
        return {"stability_map": drawing("maps.plot_stability_map", self.answer.map, title=self.answer.robot.name)}

"""What is said and saved about a trajectory, planned or checked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..files.csv_file import to_csv
from ..files.files import atomic_write, write_text
from ..planning import Proof, Trajectory
from ..planning.file import save_trajectory
from ..robots.file import save_robot
from ..runs.plan_study import Checked
from ..stability import ASSUMING
from .report import report, to_text, two_columns
from .words import MM, degrees, millimetres

DEG = 180 / np.pi

HOW = {
    "straight": "straight",
    "detour": "by translations at which nothing can snap",
    "search": "by random search",
    "tip path": "by inverse kinematics along the curve",
    "leader": "by withdrawing the arm along itself",
    "partial": "as far as the search came",
}


def proof_record(proof: Proof) -> dict[str, Any]:
    """A proof as JSON."""
    p = proof
    return {
        "proved": p.holds,
        "assumed": ASSUMING,
        "faults": list(p.faults),
        "followed_percent": 100 * p.followed,
        "snap_at_percent": None if p.snap is None else 100 * p.snap,
        "least_margin": p.least_margin,
        "least_clearance_mm": p.least_clearance * MM,
        "clearance_bound_mm": p.clearance_bound * MM,
        "measured_clearance_mm": p.measured_clearance * MM,
        "largest_rotation_rate_deg_per_s": p.largest_rotation_rate * DEG,
        "largest_translation_rate_mm_per_s": p.largest_translation_rate * MM,
        "largest_rotation_acceleration_deg_per_s2": p.largest_rotation_acceleration * DEG,
        "largest_translation_acceleration_mm_per_s2": p.largest_translation_acceleration * MM,
        "largest_tip_step_mm": p.largest_tip_step * MM,
        "tip_length_mm": p.tip_length * MM,
        "reintegration_mm": p.reintegration * MM,
        "equilibria": p.equilibria,
    }


def proof_rows(proof: Proof) -> list[tuple[str, str]]:
    """A proof as lines of a table."""
    p = proof
    rows = [("least margin", f"{p.least_margin:.4f}")]
    if np.isfinite(p.least_clearance):
        shown, measured = _down(p.least_clearance * MM), p.measured_clearance * MM
        rows.append(("clearance", f"at least {shown:.3f} mm at all times ({measured:.3f} mm measured)"))
    elif p.least_clearance < 0:
        rows.append(("clearance", f"none is shown ({p.measured_clearance * MM:.3f} mm measured)"))
    return [
        *rows,
        (
            "largest rates",
            f"{p.largest_rotation_rate * DEG:.2f} deg/s, {p.largest_translation_rate * MM:.2f} mm/s; "
            f"{p.largest_rotation_acceleration * DEG:.2f} deg/s^2, "
            f"{p.largest_translation_acceleration * MM:.2f} mm/s^2",
        ),
        ("way of the tip", f"{p.tip_length * MM:.2f} mm, in steps of at most {p.largest_tip_step * MM:.2f} mm"),
        (
            "followed again",
            f"through {p.equilibria} equilibria"
            + (f", re-integrated to {p.reintegration * MM:.0e} mm (DOP853)" if np.isfinite(p.reintegration) else ""),
        ),
    ]


def _down(value: float) -> float:
    """Rounded down to what is printed, so that a bound stays one."""
    return float(np.floor(value * 1e3) / 1e3)


@dataclass(frozen=True)
class TrajectoryReport:
    """What is said and saved about a plan."""

    answer: Trajectory

    def record(self) -> dict[str, Any]:
        """The plan as JSON; joint values over time are in the CSV file."""
        t = self.answer
        return {
            "robot": t.robot.name,
            "duration_s": float(t.time[-1]),
            "samples": len(t.time),
            "start": {
                "rotations_deg": np.degrees(t.rotations[0]).tolist(),
                "translations_mm": (t.translations[0] * MM).tolist(),
            },
            "goal": {
                "rotations_deg": np.degrees(t.rotations[-1]).tolist(),
                "translations_mm": (t.translations[-1] * MM).tolist(),
            },
            "tip_position_mm": (t.tip_position[-1] * MM).tolist(),
            "tip_rotations_deg": np.degrees(t.end.tip_rotations).tolist(),
            "turns": list(t.turns),
            "status": t.status,
            "largest_deviation_mm": None if t.deviation is None else float(t.deviation.max()) * MM,
            "proof": proof_record(t.proof),
            "statistics": asdict(t.statistics),
        }

    def table(self) -> Group:
        """The plan, its proof, and how it was found."""
        t, s = self.answer, self.answer.statistics
        rows = [
            (
                "from",
                f"rotations {degrees(t.rotations[0], '.4g')}, translations {millimetres(t.translations[0], '.4g')}",
            ),
            (
                "to",
                f"rotations {degrees(t.rotations[-1], '.4g')}, translations {millimetres(t.translations[-1], '.4g')}",
            ),
            ("tip at the end", millimetres(t.tip_position[-1], ".3f")),
            ("duration", f"{t.time[-1]:.2f} s, {len(t.time)} samples"),
        ]
        if any(t.turns):
            rows.append(("whole turns added", ", ".join(str(turn) for turn in t.turns)))
        if t.deviation is not None:
            rows.append(("largest deviation", f"{t.deviation.max() * MM:.3f} mm"))
        rows += proof_rows(t.proof)
        found = f"{HOW[s.how]}, {s.motions} motions, {s.search_seconds:.1f} s"
        rows.append(("found", found))
        if s.smoothed:
            words = f"{s.raw_length:.2f} to {s.length:.2f} joint units ({s.smoothed}), {s.iterations} iterations"
            rows.append(("smoothed", f"{words}, {s.smooth_seconds:.1f} s"))
        what = "a motion on one stable branch, proved" if t.proved else f"a motion, {t.status}"
        return Group(two_columns(f"{t.robot.name or 'robot'}: {what}", rows))

    def save(self, directory: Path) -> list[Path]:
        """Write trajectory.csv, with robot.yaml beside it, tip.csv, and plan.json."""
        paths = [directory / name for name in ("robot.yaml", "trajectory.csv", "tip.csv", "plan.json")]
        save_robot(self.answer.robot, paths[0])
        save_trajectory(self.answer, paths[1], robot_file="robot.yaml")
        columns = ["time_s", "x_mm", "y_mm", "z_mm", "margin", "clearance_mm"]
        write_text(paths[2], to_csv(columns, self._tip()))
        write_text(paths[3], to_text(self.record()))
        return paths

    def _tip(self) -> Iterator[Sequence[object]]:
        t = self.answer
        for time, tip, margin, clear in zip(t.time, t.tip_position, t.margin, t.clearance, strict=True):
            shown = round(float(clear) * MM, 6) if np.isfinite(clear) else ""
            yield [float(time), *(round(float(x) * MM, 6) + 0.0 for x in tip), float(margin), shown]

    def draw(self, directory: Path) -> list[Path]:
        """Write trajectory.png and trajectory.gif."""
        from .plots.trajectory import animate_trajectory, plot_trajectory

        picture, film = directory / "trajectory.png", directory / "trajectory.gif"
        with atomic_write(picture) as temporary:
            plot_trajectory(self.answer, temporary)
        animate_trajectory(self.answer, film)
        return [picture, film]


@dataclass(frozen=True)
class CheckedReport:
    """What is said about a trajectory that was checked."""

    answer: Checked

    def record(self) -> dict[str, Any]:
        """The answer as JSON."""
        j = self.answer.joints
        return {
            "robot": j.robot.name,
            "duration_s": float(j.time[-1] - j.time[0]),
            "samples": len(j.time),
        } | proof_record(self.answer.proof)

    def table(self) -> Group:
        """Whether it holds, what is wrong, and the numbers."""
        a = self.answer
        verdict = "holds" if a.proof.holds else "does not hold"
        notes = [Text(f"- {fault}") for fault in a.proof.faults]
        table: Table = two_columns("", proof_rows(a.proof))
        return Group(Text(f"{a.file} {verdict}, {ASSUMING}"), *notes, table)

    def save(self, directory: Path) -> list[Path]:
        """Write verify.json."""
        path = directory / "verify.json"
        write_text(path, to_text(self.record()))
        return [path]

    def draw(self, directory: Path) -> list[Path]:
        """No picture."""
        return []


@report.register
def _(answer: Trajectory) -> TrajectoryReport:
    return TrajectoryReport(answer)


@report.register
def _(answer: Checked) -> CheckedReport:
    return CheckedReport(answer)

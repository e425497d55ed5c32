"""What is said and saved about a design."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..design.objectives import AnyObjective, key_of, shown
from ..design.pareto import front_label
from ..design.stock import objective_label
from ..files.files import write_text
from ..robots.file import save_robot
from ..runs.design_study import DesignAnswer
from .report import report, to_text, two_columns
from .words import MM

STOCK_ROWS = 12
"""Choices from stock that are listed one by one."""

MAP_SAMPLES = 20
"""Points per axis of the stability maps before and after."""


@dataclass(frozen=True)
class DesignReport:
    """What is said and saved about a design."""

    answer: DesignAnswer

    def record(self) -> dict[str, Any]:
        """The answer as JSON."""
        s = self.answer.solution
        return {
            "task": s.task.name,
            "robot": s.robot.name,
            "certificate": s.certificate,
            "objectives": {_key(one): s.objectives[key_of(one)] * one.factor for one in s.task.objectives},
            "dimensions": [
                {"name": d.name, "unit": d.unit, "before": d.before, "after": d.after, "bound": d.bound or None}
                for d in s.dimensions
            ],
            "binding": [
                {
                    "limit": one.limit.words,
                    "value": one.limit.value * one.limit.factor,
                    "unit": one.limit.unit,
                    "derivative_si": one.derivative,
                    "words": one.sentence,
                }
                for one in s.sensitivities
            ],
            "poses": [
                {
                    "rotations_deg": np.degrees(e.rotations).tolist(),
                    "translations_mm": (e.translations * MM).tolist(),
                    "tip_position_mm": (e.tip_position * MM).tolist(),
                    "margin": e.margin,
                }
                for e in s.equilibria
            ],
            "checks": [{"what": c.what, "found": c.found, "kept": c.kept} for c in s.verification.checks],
            "starts": s.ranking.starts,
            "designs": len(s.ranking.designs),
            "failures": s.ranking.failures,
            "rounds": s.rounds,
            "seconds": s.seconds,
            "tolerance": self._tolerance(),
            "pareto": self._front(),
            "stock": self._stock(),
        }

    def _tolerance(self) -> dict[str, Any] | None:
        t = self.answer.tolerance
        if t is None:
            return None
        return {
            "samples": len(t.certificate),
            "snap_free_probability": t.snap_free,
            "interval_95": list(t.interval),
            "tip_spread_rms_mm": (t.spread * MM).tolist(),
            "tip_spread_95_mm": (t.spread_95 * MM).tolist(),
            "failed": t.failed,
        }

    def _front(self) -> dict[str, Any] | None:
        front = self.answer.front
        if front is None:
            return None
        _, unit, factor = front_label(front)
        points = [{"margin": p.margin, "value": p.objective * factor} for p in front.points]
        return {"objective": front.objective, "unit": unit, "points": points, "infeasible_from": front.ended}

    def _stock(self) -> list[dict[str, Any]] | None:
        choice = self.answer.stock
        if choice is None:
            return None
        factor = objective_label(self.answer.solution.task)[2]
        return [
            {
                "sizes": [size.name for size in one.sizes],
                "value": None if one.objective is None else one.objective * factor,
                "status": one.status,
            }
            for one in choice.candidates
        ]

    def summary(self) -> list[tuple[str, str]]:
        """The answer in short."""
        s = self.answer.solution
        failed = ", ".join(f"{count} at the {name}" for name, count in s.ranking.failures.items())
        rows = [("objective", shown(one, s.objectives[key_of(one)])) for one in s.task.objectives]
        rows.append(("certificate", f"{s.certificate:.6f}, a lower bound of the margin at all rotations"))
        if s.equilibria:
            rows.append(("task poses", f"{len(s.equilibria)}, least margin {min(e.margin for e in s.equilibria):.4f}"))
        rows.append(
            ("starts", f"{s.ranking.starts}, of which {sum(s.ranking.found)} feasible" + f" ({failed})" * bool(failed))
        )
        rows.append(("worst cases added", f"in {s.rounds} rounds"))
        t = self.answer.tolerance
        if t is not None:
            low, high = t.interval
            words = f"{100 * t.snap_free:.1f} % of {len(t.certificate)} samples stay snap-free"
            words += f" (95 %: {100 * low:.1f} to {100 * high:.1f} %)"
            rows.append(("as manufactured", words))
            if len(t.spread):
                rows.append(
                    (
                        "tip spread",
                        f"RMS up to {t.spread.max() * MM:.3f} mm, 95 % within {t.spread_95.max() * MM:.3f} mm",
                    )
                )
        if self.answer.stock is not None and self.answer.stock.best is not None:
            names = ", ".join(size.name for size in self.answer.stock.best.sizes)
            rows.append(("from stock", f"{names} (of {len(self.answer.stock.candidates)} choices)"))
        rows.append(("seconds", f"{s.seconds:.1f}"))
        return rows

    def table(self) -> Group:
        """The answer as tables: summary, dimensions, what binds, checks."""
        s = self.answer.solution
        parts: list[Text | Table] = [two_columns(s.robot.name or "design", self.summary())]
        parts.append(_table("dimensions", ("", "before", "after", ""), self.dimension_rows()))
        if s.sensitivities:
            parts.append(Text("what binds, and what easing it would buy", style="italic"))
            parts += [Text(f"  {one.sentence}") for one in s.sensitivities]
        rows = [(check.what, check.found, "kept" if check.kept else "BROKEN") for check in s.verification.checks]
        parts.append(_table("checked again by other code", ("", "found", ""), rows))
        if self.answer.stock is not None:
            parts.append(_table("choices from stock", ("inner to outer", "value", ""), self.stock_rows()))
        return Group(*parts)

    def dimension_rows(self) -> Sequence[tuple[str, ...]]:
        """Name, before, after, and the bound on which a dimension lies."""
        return [
            (f"{d.name} ({d.unit})", f"{d.before:.5g}", f"{d.after:.5g}", f"at its {d.bound} bound" if d.bound else "")
            for d in self.answer.solution.dimensions
        ]

    def stock_rows(self) -> Sequence[tuple[str, ...]]:
        """Sizes, value and status of every choice, the best first."""
        choice = self.answer.stock
        if choice is None:
            return []
        _, unit, factor = objective_label(self.answer.solution.task)
        shown = choice.candidates[:STOCK_ROWS]
        rows = [
            (
                ", ".join(size.name for size in one.sizes),
                "–" if one.objective is None else f"{one.objective * factor:.5g} {unit}",
                one.status,
            )
            for one in shown
        ]
        rest = choice.candidates[STOCK_ROWS:]
        counts = {"design": "worse designs", "infeasible": "infeasible", "pruned": "pruned by their bound"}
        for status, words in counts.items():
            count = sum(one.status.startswith(status) for one in rest)
            rows += [(f"{count} more", "–", words)] if count else []
        return rows

    def save(self, directory: Path) -> list[Path]:
        """Write the robot, design.json and the page report.md."""
        paths = [directory / name for name in ("robot.yaml", "design.json", "report.md")]
        save_robot(self.answer.solution.robot, paths[0])
        write_text(paths[1], to_text(self.record()))
        write_text(paths[2], self.page())
        return paths

    def pictures(self) -> list[tuple[str, str]]:
        """Name of each picture, and what it shows."""
        s = self.answer.solution
        out = [("shapes.png", "The robot before and after, at home with all tubes to one side.")]
        if s.equilibria:
            out.append(("poses.png", "The design in its task poses, from two sides."))
        if s.robot.n_tubes > 2:
            out.append(("maps.png", "Margin over the rotations of the two inner tubes at home, before and after."))
        if self.answer.front is not None:
            out.append(("pareto.png", "What margin costs."))
        if self.answer.tolerance is not None:
            out.append(("tolerance.png", "The certificate of robots as they may be made."))
        return out

    def page(self) -> str:
        """The report as Markdown, with its pictures."""
        s = self.answer.solution
        lines = [f"# {s.robot.name or 'Design'}", ""]
        lines += _markdown(("", ""), self.summary())
        lines += ["", "## Dimensions", "", *_markdown(("", "before", "after", ""), self.dimension_rows())]
        lines += ["", "## Requirements that bind", ""]
        rows = [(o.limit.words, o.limit.shown(), o.sentence) for o in s.sensitivities]
        lines += _markdown(("limit", "at", "price"), rows) if rows else ["None."]
        lines += ["", "## Checked again", ""]
        lines += _markdown(
            ("promise", "found", "kept"), [(c.what, c.found, "yes" if c.kept else "no") for c in s.verification.checks]
        )
        if self.answer.stock is not None:
            lines += ["", "## Choices from stock", "", *_markdown(("inner to outer", "value", ""), self.stock_rows())]
        lines += ["", "## Pictures", ""]
        for name, words in self.pictures():
            lines += [f"![{words}]({name})", "", f"*{words}*", ""]
        return "\n".join(lines) + "\n"

    def draw(self, directory: Path) -> list[Path]:
        """Write the pictures."""
        from ..equilibrium.kinematics import forward_kinematics
        from ..stability import stability_map
        from .plots import plot_shapes
        from .plots.design import plot_before_after, plot_front, plot_poses, plot_tolerance

        s = self.answer.solution
        paths = {name: directory / name for name, _ in self.pictures()}
        robots = (s.task.robot, s.robot)
        home = [forward_kinematics(robot, np.zeros(robot.n_tubes)) for robot in robots]
        plot_shapes(home, paths["shapes.png"], titles=("before", "after"))
        if "poses.png" in paths:
            plot_poses(s, paths["poses.png"])
        if "maps.png" in paths:
            charts = [stability_map(robot, samples=MAP_SAMPLES, directions=60, workers=1) for robot in robots]
            plot_before_after(charts[0], charts[1], paths["maps.png"])
        if self.answer.front is not None:
            plot_front(self.answer.front, paths["pareto.png"])
        if self.answer.tolerance is not None:
            plot_tolerance(self.answer.tolerance, paths["tolerance.png"])
        return list(paths.values())


def _key(one: AnyObjective) -> str:
    unit = {"1/m": "_per_m", "mm": "_mm", "%": "_percent"}.get(one.unit, "")
    return f"{key_of(one)}{unit}"


def _table(title: str, head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> Table:
    table = Table(title=title, title_justify="left", box=None, padding=(0, 2, 0, 0))
    for k, name in enumerate(head):
        table.add_column(name, style="bold" if k == 0 else None)
    for row in rows:
        table.add_row(*row)
    return table


def _markdown(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> list[str]:
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    return lines + [f"| {' | '.join(row)} |" for row in rows]


@report.register
def _(answer: DesignAnswer) -> DesignReport:
    return DesignReport(answer)

"""What is said and saved about whether a robot can snap: what is proved apart from what is found."""

from __future__ import annotations

import itertools
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from ..files.files import write_text
from ..robots.robot import is_general
from ..runs.stability_studies import Certification
from ..stability import ASSUMING, EccentricVerdict, Finding, Verdict, WorstCertificate
from ..typing import Array
from .report import report, to_text, two_columns
from .snap_report import draw_snap
from .words import MILLI, MM, degrees, flag, millimetres, snap_record

BOX_METHOD = "the DIRECT algorithm, L-BFGS-B from its best point and every corner, Nelder-Mead from the best of all"
"""How the least certificate in a box is found; see `stability.worst_certificate`."""

GRADIENT = {
    "bending_stiffness": ("bending stiffness EI", "N_mm2", 1e-6),
    "torsional_stiffness": ("torsional stiffness GJ", "N_mm2", 1e-6),
    "curvature": ("precurvature", "per_m", 1.0),
    "straight_length": ("straight length", "mm", 1e-3),
    "curved_length": ("curved length", "mm", 1e-3),
    "translation": ("translation", "mm", 1e-3),
}
"""Parameters of the certificate: their name, unit, and what turns a derivative per SI unit into one per this unit."""

EXIT_CODES = {Finding.SNAP_FREE: 0, Finding.CAN_SNAP: 3, Finding.OPEN: 4}
"""What `tubeopt certify` ends with."""

SIGNS = {"N_mm2": "N mm²", "per_m": "1/m", "mm": "mm"}


@dataclass(frozen=True)
class CertificationReport:
    """What is said and saved about a verdict; `robot_file` is what the commands that repeat it name."""

    answer: Certification
    robot_file: str = "ROBOT.yaml"

    def record(self) -> dict[str, Any]:
        """The answer as JSON: in words, the numbers proved and found, what limits them, and how to repeat it."""
        verdict = self.answer.verdict
        certificate, worst, box = verdict.certificate, verdict.worst, self.answer.box
        return {
            "robot": self.answer.robot.name,
            "translations_mm": (certificate.translations * MM).tolist(),
            "finding": verdict.finding.name,
            "exit_code": EXIT_CODES[verdict.finding],
            "answer": self.sentence(),
            "assumed": ASSUMING,
            "certificate": _number(certificate.margin),
            "untwisted_margin": verdict.untwisted if isinstance(verdict, EccentricVerdict) else None,
            "margin_found": None if worst is None else worst.margin,
            "found_at_deg": None if worst is None else np.degrees(worst.equilibrium.rotations).tolist(),
            "limiting_tubes": None if certificate.pair is None else [i + 1 for i in certificate.pair],
            "limiting_section_mm": None if certificate.section is None else [s * MM for s in certificate.section],
            "shares": [{"tubes": list(pair), "share": share} for pair, share in self._shares()],
            "gradient": {
                f"{key}_{unit}": [_number(value * factor) for value in certificate.gradient[key].tolist()]
                for key, (_, unit, factor) in GRADIENT.items()
            },
            "ways_tried": verdict.ways,
            "ways_lost": verdict.failed,
            "rotation_limits_deg": np.degrees(self.answer.robot.limits.rotations).tolist(),
            "within_limits": verdict.within_limits,
            "way_deg": [np.degrees(angles).tolist() for angles in self._way()],
            "snap": None if verdict.snap is None else snap_record(verdict.snap),
            "repeat": self.command(),
            "box": None if box is None else _box_record(box),
        }

    def sentence(self) -> str:
        """The verdict, with what is proved and what is found, where the snap is, and what is assumed."""
        return f"{self._finding()}, {ASSUMING}"

    def _finding(self) -> str:
        verdict = self.answer.verdict
        proved = f"{verdict.certificate.margin:.3g}" if np.isfinite(verdict.certificate.margin) else "none"
        found = "0" if verdict.worst is None else f"{verdict.worst.margin:.3g}"
        if verdict.finding is Finding.SNAP_FREE and isinstance(verdict, EccentricVerdict):
            return (
                f"{verdict.finding} (proved, also at {1 - verdict.certificate.margin:.3g} of its torsional stiffness)"
            )
        if verdict.finding is Finding.SNAP_FREE:
            return f"{verdict.finding} (margin {proved} proved; {found} found)"
        if verdict.snap is None and verdict.finding is Finding.CAN_SNAP:
            return (
                f"{verdict.finding}: equilibria that it must pass are unstable (margin {found}; certificate {proved})"
            )
        if verdict.snap is None:
            least = f"least margin found {found}"
            if verdict.worst is not None and verdict.worst.margin < 0:
                least += ", an unstable equilibrium, so that some way leads to a snap"
            return f"not proved (certificate {proved}), and search found no snap ({least})"
        beyond = "" if verdict.decided else "search found that "
        where = "" if verdict.within_limits else f", but {beyond}only beyond its joint limits"
        start, end = (degrees(angles, ".6g") for angles in self._way())
        return (
            f"{verdict.finding}{where}: from rotations {start} towards {end}, at {degrees(verdict.snap.rotations)} "
            f"(least margin found {found}; certificate {proved})"
        )

    def _way(self) -> list[Array]:
        """Rotations from the relaxed pose to beyond the snap, none without one."""
        return [angles for angles in (self.answer.verdict.start, self.answer.verdict.end) if angles is not None]

    def command(self) -> str | None:
        """The command that repeats the snap, or, without one, shows the least margin found; None without either."""
        verdict = self.answer.verdict
        shift = flag(verdict.certificate.translations * MM)
        file = shlex.quote(self.robot_file)
        if not verdict.followed:
            return None
        if verdict.snap is not None:
            start, end = (flag(np.degrees(angles)) for angles in self._way())
            return f"tubeopt snap {file} --from-deg {start} --to-deg {end} --from-mm {shift}"
        if verdict.worst is None:
            return None
        angles = flag(np.asarray(np.round(np.degrees(verdict.worst.equilibrium.rotations), 4), dtype=float))
        return f"tubeopt equilibria {file} --rotations-deg {angles} --translations-mm {shift}"

    def _shares(self) -> list[tuple[tuple[int, int], float]]:
        """Pairs of tubes, from 1, and the part that each takes from a margin of 1; the largest first."""
        share = self.answer.verdict.certificate.share
        pairs = [((i + 1, j + 1), float(share[i, j])) for i, j in itertools.combinations(range(len(share)), 2)]
        return sorted((pair for pair in pairs if pair[1] > 0), key=lambda pair: -pair[1])

    def table(self) -> Group:
        """The verdict in words; what limits it; the gradient; the command that repeats it."""
        verdict = self.answer.verdict
        parts: list[Text | Table] = [Text(f"{self.answer.robot.name or 'the robot'} {self.sentence()}", style="bold")]
        parts += [Text(note) for note in self._notes()]
        parts += [two_columns("", self._rows()), self._gradient()]
        command = self.command()
        if command is not None:
            what = "to repeat the least margin found:" if verdict.snap is None else "to repeat the snap:"
            parts += [Text(what), Text(f"  {command}", no_wrap=True, overflow="ignore")]
        return Group(*parts)

    def _notes(self) -> list[str]:
        """What a number of the verdict does not say."""
        verdict = self.answer.verdict
        notes = []
        if self.answer.box is not None:
            notes.append(
                "Of the box, these are the translations with the least certificate that search found. A certificate is "
                "a proof for its own translations, not for the box."
            )
        if not verdict.followed:
            notes.append("The snap is too shallow to be met by following the robot; it is computed from its fold.")
        if isinstance(verdict, EccentricVerdict):
            notes += _eccentric_notes(verdict)
        return notes

    def _rows(self) -> list[tuple[str, str]]:
        verdict = self.answer.verdict
        certificate, worst, box = verdict.certificate, verdict.worst, self.answer.box
        rows = [
            ("translations", millimetres(certificate.translations, ".6g")),
            ("certificate", _certificate(verdict)),
        ]
        if worst is None:
            rows.append(("least margin found", "0, a fold"))
        else:
            where = degrees(np.radians(np.round(np.degrees(worst.equilibrium.rotations), 4)), ".7g")
            rows.append(("least margin found", f"{worst.margin:.6f}, at rotations {where}"))
        if certificate.pair is not None and certificate.section is not None:
            i, j = certificate.pair
            start, end = (f"{s * MM:.6g}" for s in certificate.section)
            rows.append(("limited by", f"tubes {i + 1} and {j + 1}, on the section from {start} to {end} mm"))
        elif certificate.section is not None:
            start, end = (f"{s * MM:.6g}" for s in certificate.section)
            rows.append(("limited by", f"the section from {start} to {end} mm"))
        shares = [f"tubes {i} and {j} {100 * share:.1f} %" for (i, j), share in self._shares()]
        rows.append(("takes from the margin", ", ".join(shares) or "nothing: no two tubes are coupled"))
        if verdict.snap is not None:
            jump, energy = verdict.snap.tip_jump * MM, verdict.snap.energy_released * MILLI
            rows.append(("the snap", f"the tip jumps {jump:.3f} mm and {energy:.4f} mJ are released"))
            rows.append(("rotations allowed", self._limits()))
        elif verdict.ways:
            lost = f", its equilibria were lost on {verdict.failed} of them" if verdict.failed else ""
            rows.append(("the search for a snap", f"{verdict.ways} ways from the relaxed pose, none with a snap{lost}"))
        if box is not None:
            rows += [
                ("box", f"{millimetres(box.lower, '.6g')} to {millimetres(box.upper, '.6g')}"),
                ("searched by", f"{BOX_METHOD}, {box.evaluations} evaluations"),
            ]
        return rows

    def _limits(self) -> str:
        """The limits of the rotations, and whether the snap is inside."""
        inside = "the snap is inside" if self.answer.verdict.within_limits else "the snap is beyond"
        ranges = (f"{low:.6g} to {high:.6g}" for low, high in np.degrees(self.answer.robot.limits.rotations))
        implied = "" if self.answer.robot.joint_limits is not None else " where the file gives no limits"
        return f"{', '.join(ranges)} deg{implied}; {inside}"

    def _gradient(self) -> Table | Text:
        certificate = self.answer.verdict.certificate
        if not np.isfinite(certificate.gradient["curvature"]).all():
            if not np.isfinite(certificate.margin):
                return Text("")
            if is_general(self.answer.robot):
                return Text("Of tubes made of pieces the certificate has no gradient.")
            return Text("The certificate has no gradient here: two ways to lose stability are equally close.")
        table = Table(title="change of the certificate", title_justify="left", box=None, padding=(0, 2, 0, 0))
        table.add_column("per unit of", style="bold", no_wrap=True)
        for i in range(self.answer.robot.n_tubes):
            table.add_column(f"tube {i + 1}", justify="right")
        for key, (name, unit, factor) in GRADIENT.items():
            values = certificate.gradient[key] * factor
            table.add_row(
                f"{name} ({SIGNS[unit]})", *(f"{value:.4g}" if np.isfinite(value) else "-" for value in values)
            )
        return table

    def save(self, directory: Path) -> list[Path]:
        """Write certificate.json."""
        path = directory / "certificate.json"
        write_text(path, to_text(self.record()))
        return [path]

    def draw(self, directory: Path) -> list[Path]:
        """Write snap.png where a snap was found."""
        snap = self.answer.verdict.snap
        return [] if snap is None else [draw_snap(directory / "snap.png", snap)]


def _number(value: float) -> float | None:
    """A number for JSON, which knows neither infinity nor NaN."""
    return value if np.isfinite(value) else None


def _certificate(verdict: Verdict) -> str:
    """The certificate, and what it is a bound of."""
    margin = verdict.certificate.margin
    if not np.isfinite(margin):
        return "none"
    if isinstance(verdict, EccentricVerdict):
        return f"{margin:.6f}, the share of torsional stiffness that may be lost with the proof still holding"
    return f"{margin:.6f}, a lower bound of the margin at all rotations"


def _eccentric_notes(verdict: EccentricVerdict) -> list[str]:
    """What is known in closed form, or why nothing is proved."""
    if verdict.untwisted is None:
        return [
            "Nothing is proved of tubes off the centreline but for segments of three equal ones at 0, 120 and -120 deg "
            "whose distance from the centreline is at most a quarter of the radius of precurvature."
        ]
    if verdict.finding is Finding.CAN_SNAP and verdict.untwisted < 0:
        return [
            "That it can snap is certain: in closed form, an untwisted equilibrium has the margin "
            f"{verdict.untwisted:.3g}."
        ]
    if verdict.finding is Finding.OPEN:
        return [
            f"The softest untwisted equilibrium has the margin {verdict.untwisted:.3g} in closed form: only below 0 "
            "would a snap be certain."
        ]
    return []


def _box_record(box: WorstCertificate) -> dict[str, Any]:
    return {
        "lower_mm": (box.lower * MM).tolist(),
        "upper_mm": (box.upper * MM).tolist(),
        "method": BOX_METHOD,
        "evaluations": box.evaluations,
    }


@report.register
def _(answer: Certification) -> CertificationReport:
    return CertificationReport(answer)

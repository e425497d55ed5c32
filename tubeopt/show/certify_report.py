"""Report of certification: proofs apart from results of a search."""

from __future__ import annotations

import itertools
import shlex

import numpy as np
import typer
from rich.console import Group, RenderableType
from rich.text import Text

from ..equilibrium.readings import to_readings
from ..files.units import SIGNS, TO_MILLI, TO_MM, per_si, unit_of
from ..robots.eccentric import BundleRobot
from ..runs.stability_studies import Certification
from ..stability import ASSUMING, EccentricSnapAssessment, Finding, SnapAssessment, WorstCertificate
from ..typing import Array
from .formatting import degrees, flag
from .quantities import Quantity, described, line, of_field
from .report import Report, grid, two_columns
from .snap_report import SNAP

BOX_METHOD = "the DIRECT algorithm, L-BFGS-B from its best point and every corner, Nelder-Mead from the best of all"
"""Method that finds the smallest certificate in a box; see `stability.worst_certificate`."""

GRADIENT = {
    "bending_stiffness_N_mm2": "bending stiffness EI",
    "torsional_stiffness_N_mm2": "torsional stiffness GJ",
    "curvature_per_m": "precurvature",
    "straight_length_mm": "straight length",
    "curved_length_mm": "curved length",
    "translation_mm": "translation",
}
"""Parameters of the certificate with the unit that its derivatives are per, and their names."""

# As of every command: 3 where there is no solution, 4 where nothing is proved.
EXIT_CODES = {Finding.SNAP_FREE: 0, Finding.CAN_SNAP: 3, Finding.OPEN: 4}
"""Finding -> exit code of `tubeopt certify`."""


def sentence(a: Certification) -> str:
    """Verdict with its proof, the results of the search, the snap, and the assumptions."""
    return f"{_verdict_text(a.verdict)}, {ASSUMING}"


def _verdict_text(verdict: SnapAssessment) -> str:
    """Verdict with its proof, the results of the search, and the snap."""
    proved = f"{verdict.certificate.margin:.3g}" if np.isfinite(verdict.certificate.margin) else "none"
    found_margin = "0" if verdict.worst is None else f"{verdict.worst.margin:.3g}"
    # The certificate of eccentric robots bounds the torsional stiffness, not the margin.
    if verdict.finding is Finding.SNAP_FREE and isinstance(verdict, EccentricSnapAssessment):
        return f"{verdict.finding} (proved, also at {1 - verdict.certificate.margin:.3g} of its torsional stiffness)"
    if verdict.finding is Finding.SNAP_FREE and isinstance(verdict.robot, BundleRobot):
        return f"{verdict.finding} (proved, certificate {proved}; least margin found {found_margin})"
    if verdict.finding is Finding.SNAP_FREE:
        return f"{verdict.finding} (margin {proved} proved; {found_margin} found)"
    # An unstable equilibrium that the robot must pass proves a snap, though no path was followed to one.
    if verdict.snap is None and verdict.finding is Finding.CAN_SNAP:
        reason = f"equilibria that it must pass are unstable (margin {found_margin}; certificate {proved})"
        return f"{verdict.finding}: {reason}"
    if verdict.snap is None:
        search = f"least margin found {found_margin}"
        if verdict.worst is not None and verdict.worst.margin < 0:
            search += ", an unstable equilibrium, so some path has a snap"
        return f"not proved (certificate {proved}), and search found no snap ({search})"
    # A search that finds nothing within the limits is no proof that nothing is there.
    beyond = "" if verdict.decided else "search found that "
    where = "" if verdict.within_limits else f", but {beyond}only beyond its joint limits"
    start, end = (degrees(angles, ".6g") for angles in _path_rotations(verdict))
    return (
        f"{verdict.finding}{where}: from rotations {start} towards {end}, at {degrees(verdict.snap.rotations)} "
        f"(least margin found {found_margin}; certificate {proved})"
    )


def _path_rotations(verdict: SnapAssessment) -> list[Array]:
    """Rotations at the relaxed pose and after the snap; empty without a snap."""
    return [angles for angles in (verdict.start, verdict.end) if angles is not None]


def command(a: Certification) -> str | None:
    """Command that repeats the snap, or shows the smallest margin found; None without either."""
    verdict = a.verdict
    file = shlex.quote(a.robot_file)
    if not verdict.followed:
        return None
    if verdict.snap is not None:
        (start, shift), (end, _) = (_readings(a, angles) for angles in _path_rotations(verdict))
        return f"tubeopt snap {file} --from-deg {flag(start)} --to-deg {flag(end)} --from-mm {flag(shift)}"
    if verdict.worst is None:
        return None
    angles, shift = _readings(a, verdict.worst.equilibrium.rotations)
    # 1e-4 deg is finer than any drive, and keeps the command short.
    question = "fk" if isinstance(a.robot, BundleRobot) else "equilibria"
    return f"tubeopt {question} {file} --rotations-deg {flag(np.round(angles, 4))} --translations-mm {flag(shift)}"


def _readings(a: Certification, rotations: Array) -> tuple[Array, Array]:
    """Readings of the drives at given rotations, deg, and the translations of the assessment, mm."""
    rotations, translations = to_readings(a.robot, rotations, a.verdict.certificate.translations)
    return np.degrees(rotations), translations * TO_MM


def _fractions(a: Certification) -> list[tuple[tuple[int, int], float]]:
    """Pairs of tubes, from 1, and the fraction of a margin of 1 that each takes; the largest first."""
    fraction = a.verdict.certificate.pair_fractions
    # The matrix is symmetric: each pair once.
    pairs = [((i + 1, j + 1), float(fraction[i, j])) for i, j in itertools.combinations(range(len(fraction)), 2)]
    return sorted((pair for pair in pairs if pair[1] > 0), key=lambda pair: -pair[1])


def _fractions_text(a: Certification) -> str | None:
    """Text on the fractions by which pairs of tubes reduce the margin from 1; None for bundles, which have none."""
    if isinstance(a.robot, BundleRobot):
        return None
    fractions = [f"tubes {i} and {j} {100 * fraction:.1f} %" for (i, j), fraction in _fractions(a)]
    return ", ".join(fractions) or "nothing: no two tubes are coupled"


def _certificate_text(a: Certification) -> str:
    """Text of the certificate, and of the quantity that it bounds."""
    margin = a.verdict.certificate.margin
    if not np.isfinite(margin):
        return "none"
    if isinstance(a.verdict, EccentricSnapAssessment):
        return f"{margin:.6f}, the share of torsional stiffness that may be lost with the proof still valid"
    if isinstance(a.robot, BundleRobot):
        return f"{margin:.6f}, of the energy with its coupling at worst, relative to that without"
    return f"{margin:.6f}, a lower bound of the margin at all rotations"


def _force_text(a: Certification) -> str | None:
    """Certificate under a force, as text."""
    if a.force is None or a.forced is None:
        return None
    pushed = f"of up to {a.force * TO_MILLI:.6g} mN that keeps its direction"
    if a.finding is Finding.SNAP_FREE:
        return f"{pushed}: cannot snap or buckle at any rotation (margin {a.forced:.3g} proved)"
    return f"{pushed}: nothing is proved (certificate {a.forced:.3g})"


def _real_text(a: Certification) -> str | None:
    """Certificates of the real robot, as text."""
    if a.real is None:
        return None
    likely, sure = a.real.tolist()
    return f"at least {likely:.4f} with 95 %, {sure:.4f} with 99.9 % (estimated)"


def _smallest_margin_text(a: Certification) -> str:
    """Smallest margin found and its rotations, as text."""
    worst = a.verdict.worst
    if worst is None:
        return "0, a fold"
    where = degrees(np.radians(np.round(np.degrees(worst.equilibrium.rotations), 4)), ".7g")
    return f"{worst.margin:.6f}, at rotations {where}"


def _limiting_text(a: Certification) -> str | None:
    """Tubes and section that limit the certificate, as text."""
    certificate = a.verdict.certificate
    if certificate.section is None:
        return None
    start, end = (f"{s * TO_MM:.6g}" for s in certificate.section)
    section = f"the section from {start} to {end} mm"
    if certificate.pair is None:
        return section
    i, j = certificate.pair
    return f"tubes {i + 1} and {j + 1}, on {section}"


def _search_text(a: Certification) -> str | None:
    """Effort of a search without a snap, as text."""
    verdict = a.verdict
    if verdict.snap is not None or not verdict.paths:
        return None
    lost = f", its equilibria were lost on {verdict.failed} of them" if verdict.failed else ""
    where = "between random rotations" if isinstance(a.robot, BundleRobot) else "from the relaxed pose"
    return f"{verdict.paths} paths {where}, none with a snap{lost}"


def _snap_text(a: Certification) -> str | None:
    """Jump of the tip and released energy, as text."""
    snap = a.verdict.snap
    if snap is None:
        return None
    return f"the tip jumps {snap.tip_jump * TO_MM:.3f} mm and {snap.energy_released * TO_MILLI:.4f} mJ are released"


def _limits_text(a: Certification) -> str | None:
    """Text of the rotation limits, and of the position of the snap relative to them."""
    if a.verdict.snap is None:
        return None
    inside = "the snap is inside" if a.verdict.within_limits else "the snap is beyond"
    ranges = (f"{low:.6g} to {high:.6g}" for low, high in np.degrees(a.robot.limits.rotations))
    implied = "" if a.robot.joint_limits is not None else " where the file gives no limits"
    return f"{', '.join(ranges)} deg{implied}; {inside}"


def _gradient(a: Certification) -> dict[str, list[float | None]]:
    """Derivatives of the certificate, each per unit of its key."""
    derivatives = {}
    for key in GRADIENT:
        unit = unit_of(key)
        values = a.verdict.certificate.gradient[key.removesuffix(f"_{unit}")] / per_si(unit)
        derivatives[key] = [value if np.isfinite(value) else None for value in values.tolist()]
    return derivatives


SHARE: tuple[Quantity[tuple[tuple[int, int], float]], ...] = (
    Quantity("tubes", "the two tubes, from 1", lambda pair: pair[0]),
    Quantity("share", "part of the margin of 1 that their coupling takes", lambda pair: pair[1]),
)

BOX = described(
    WorstCertificate,
    "lower upper",
    Quantity("method", "method of the search for the smallest certificate", lambda box: BOX_METHOD),
    Quantity("evaluations", "number of certificates computed"),
)

CERTIFICATION = described(
    Certification,
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
    Quantity("translations_mm", "translations", lambda a: a.verdict.certificate.translations, form=".6g"),
    Quantity("finding", "SNAP_FREE, CAN_SNAP or OPEN", lambda a: a.finding.name),
    Quantity("exit_code", "exit code", lambda a: EXIT_CODES[a.finding]),
    Quantity("answer", "the verdict in words", sentence),
    Quantity("assumed", "assumptions of all results", lambda a: ASSUMING),
    Quantity("certificate", "certificate",
             lambda a: a.verdict.certificate.margin if np.isfinite(a.verdict.certificate.margin) else None,
             text=_certificate_text),
    Quantity("obstacle", "reason why nothing can be proved for a bundle",
             lambda a: a.verdict.certificate.obstacle or None, text=lambda a: a.verdict.certificate.obstacle or None,
             label="nothing is proved, since", optional=True),
    of_field(Certification, "force", optional=True),
    of_field(Certification, "forced", label="under a force on the tip", text=_force_text, optional=True),
    of_field(Certification, "real", label="of the real robot", text=_real_text, optional=True),
    Quantity("untwisted_margin", "margin of the softest untwisted equilibrium, in closed form; eccentric robots only",
             lambda a: a.verdict.untwisted if isinstance(a.verdict, EccentricSnapAssessment) else None),
    Quantity("margin_found", "smallest margin found",
             lambda a: None if a.verdict.worst is None else a.verdict.worst.margin, text=_smallest_margin_text,
             label="least margin found"),
    Quantity("found_at_deg", "rotations of the smallest margin",
             lambda a: None if a.verdict.worst is None else a.verdict.worst.equilibrium.rotations),
    Quantity("limiting_tubes", "the two tubes that limit the certificate, from 1",
             lambda a: None if a.verdict.certificate.pair is None else [i + 1 for i in a.verdict.certificate.pair]),
    Quantity("limiting_section_mm", "ends of the section that limits the certificate",
             lambda a: a.verdict.certificate.section, label="limited by", text=_limiting_text),
    Quantity("shares", "part of the margin of 1 that each pair of tubes takes", _fractions, of=SHARE,
             label="takes from the margin", text=_fractions_text),
    Quantity("gradient", "derivatives of the certificate by the parameters of each tube, per unit of the key",
             _gradient),
    Quantity("paths_tried", "number of paths searched for a snap", lambda a: a.verdict.paths),
    Quantity("paths_lost", "number of these paths where the equilibrium was lost", lambda a: a.verdict.failed),
    line("the snap", _snap_text),
    Quantity("rotation_limits_deg", "allowed rotations", lambda a: np.array(a.robot.limits.rotations),
             text=_limits_text, label="rotations allowed"),
    line("the search for a snap", _search_text),
    Quantity("within_limits", "true if the snap is within the limits", lambda a: a.verdict.within_limits),
    Quantity("path_deg", "rotations from the relaxed pose to beyond the snap", lambda a: _path_rotations(a.verdict)),
    Quantity("snap", "the snap found", lambda a: a.verdict.snap, of=SNAP),
    Quantity("repeat", "command that reproduces the snap", command),
    of_field(Certification, "box", label="box", text="{box[lower_mm]:.6g} mm to {box[upper_mm]:.6g} mm", of=BOX),
    line("searched by", lambda a: None if a.box is None else f"{BOX_METHOD}, {a.box.evaluations} evaluations"),
)  # fmt: skip


class CertificationReport(Report[Certification]):
    command = "certify"
    quantities = CERTIFICATION
    file = "certificate.json"
    drawn = (("snap", "path.plot_snap", "verdict.snap"),)

    def table(self) -> Group:
        """Table with the verdict in words, the limiting quantity, the gradient, and the command that repeats it."""
        a = self.answer
        parts: list[RenderableType] = [Text(f"{a.robot.name or 'the robot'} {sentence(a)}", style="bold")]
        parts += [Text(note) for note in self._notes()]
        parts += [two_columns("", self.rows()), self._gradient()]
        repetition = command(a)
        if repetition is not None:
            purpose = "to repeat the least margin found:" if a.verdict.snap is None else "to repeat the snap:"
            parts += [Text(purpose), Text(f"  {repetition}", no_wrap=True, overflow="ignore")]
        return Group(*parts)

    def _notes(self) -> list[str]:
        """Notes that restrict the meaning of the numbers."""
        verdict = self.answer.verdict
        notes = []
        if self.answer.box is not None:
            notes.append(
                "Of the box, these are the translations with the least certificate that search found. A certificate is "
                "a proof for its own translations, not for the box."
            )
        if not verdict.followed:
            notes.append("The snap is too shallow to be met by following the robot; it is computed from its fold.")
        if isinstance(verdict, EccentricSnapAssessment):
            notes += _eccentric_notes(verdict)
        return notes

    def _gradient(self) -> RenderableType:
        """Table of the derivatives of the certificate, or why it has none."""
        certificate = self.answer.verdict.certificate
        # The smallest of several eigenvalues is not differentiable where two of them are equal.
        if not np.isfinite(certificate.gradient["curvature"]).all():
            if not np.isfinite(certificate.margin):
                return Text("")
            return Text("The certificate has no gradient here: two modes of instability are equally close.")
        cells = [
            [
                f"{GRADIENT[key]} ({SIGNS.get(unit_of(key), unit_of(key))})",
                *("-" if value is None else f"{value:.4g}" for value in values),
            ]
            for key, values in _gradient(self.answer).items()
        ]
        tubes = [f"tube {i + 1} >" for i in range(self.answer.robot.n_tubes)]
        return grid(("per unit of", *tubes), cells, title="change of the certificate", key=True)

    def conclude(self) -> None:
        """Exit with the code of the finding."""
        raise typer.Exit(EXIT_CODES[self.answer.finding])


def _eccentric_notes(verdict: EccentricSnapAssessment) -> list[str]:
    """Notes on closed-form results, or on why nothing is proved."""
    if verdict.untwisted is None:
        return [
            "For tubes off the centreline a proof exists only for segments of three equal ones at 0, 120 and -120 deg. "
            "Their distance from the centreline must be at most a quarter of the radius of precurvature."
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

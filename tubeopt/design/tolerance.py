"""Effect of manufacturing tolerances: probability of a snap-free robot, and spread of the tips."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated

import numpy as np
import scipy

from ..arguments import typed
from ..equilibrium.batch import forward_kinematics_batch
from ..errors import InputError, SolveError, instance, vector, whole
from ..files.field_metadata import NOT_NEGATIVE, OneOf, Range, Typical, check_fields, key, unit
from ..robots.concentric import ConcentricRobot
from ..robots.eccentric import BundleRobot
from ..robots.tubes import Tube
from ..solvers.parallel import executor, run_all
from ..solvers.time_limit import LONG_TIME_LIMIT, limited
from ..stability import follow, snap_free_certificate
from ..typing import Array, Progress
from .task import DesignedRobot


@dataclass(frozen=True)
class Tolerances:
    """Independent errors of every tube: standard deviations, or half widths where uniform.

    Translations are relative to home, where the transition of each tube is at the plate. So a longer straight part
    gives a longer transmission, not a longer arm. In tubes made of pieces all pieces change in the same proportion.
    """

    curvature: Annotated[
        float, unit("percent"), NOT_NEGATIVE, Typical(1e-4, 0.5), "relative error of the curvature"
    ] = 0.0
    stiffness: Annotated[
        float,
        unit("percent"),
        NOT_NEGATIVE,
        Typical(1e-4, 0.5),
        "relative error of bending and torsional stiffness, the same for both",
    ] = 0.0
    straight_length: Annotated[float, unit("mm"), NOT_NEGATIVE, Typical(1e-6, 0.05)] = 0.0
    curved_length: Annotated[float, unit("mm"), NOT_NEGATIVE, Typical(1e-6, 0.05)] = 0.0
    distribution: Annotated[str, OneOf(("normal", "uniform"))] = "normal"

    def __post_init__(self) -> None:
        check_fields(self, "the tolerances")
        if max(self.curvature, self.stiffness) >= 0.3:
            raise InputError("tolerances of curvature and stiffness must be below 30 %")


@dataclass(frozen=True, eq=False)
class ToleranceAnalysis:
    """Statistics of robots with random manufacturing errors."""

    certificate: Array
    """Smallest mu_cert (S,) of each sample over the translations; -inf if nothing is proved.

    Of a bundle without translations, its smallest margin on the straight joint paths through the poses; 0 if it snaps
    there.
    """
    snap_free: Annotated[float, key("snap_free_probability"), "fraction of them that is snap-free"]
    """Fraction of the samples with a positive margin."""
    interval: Annotated[tuple[float, float], key("interval_95"), "95 % confidence interval of this fraction"]
    """Wilson score interval."""
    margin: float
    margin_kept: float
    """Fraction of the samples with at least `margin`."""
    tip: Array
    """Tip positions (S, P, 3) in each pose, m; NaN if a sample has no stable equilibrium."""
    spread: Annotated[Array, key("tip_spread_rms_mm"), "RMS distance of the tip of a pose from its nominal position"]
    """RMS distance (P,) of the tip from its nominal position, m."""
    spread_95: Annotated[Array, key("tip_spread_95_mm"), "distance that contains 95 % of these tips"]
    """Distance (P,) that contains 95 % of the tips, m."""
    failed: Annotated[int, "samples that could not be solved"]


@typed
@limited
def tolerance_analysis(  # noqa: PLR0913
    robot: DesignedRobot,
    tolerances: Tolerances,
    *,
    translations: Sequence[Sequence[float]] | None = None,
    poses: Sequence[tuple[Array, Array]] = (),
    margin: float = 0.0,
    samples: Annotated[int, Range(minimum=2)] = 500,
    workers: int = 1,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> ToleranceAnalysis:
    """Sample robots with random manufacturing errors.

    Args:
        translations: translations (T, n), m, of the certificate; None is home, and of a bundle no certificate.
        poses: joint values (rotations, translations), rad and m, at which tips are compared.
        margin: margin for which the fraction of samples is reported.
        samples: number of random robots.
        time_limit: maximum run time, s.

    Raises:
        InputError: fewer than 2 samples, joint values of another number of tubes, no `Tolerances`.
        SolveError: a pose has no equilibrium of the robot as designed.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    instance("tolerances", tolerances, Tolerances)
    whole("samples", samples, 2)
    whole("workers", workers, 1)
    rows = [robot.home_translations] if translations is None else translations
    where = tuple(tuple(vector("translations", row, robot.n_tubes).tolist()) for row in rows)
    if not where:
        raise InputError("translations is empty; there must be at least one row, or None for home")
    for pose in poses:
        for name, values in zip(("rotations of a pose", "translations of a pose"), pose, strict=True):
            vector(name, values, robot.n_tubes)
    if isinstance(robot, BundleRobot) and translations is None:
        if not poses:
            raise InputError(
                "poses is empty, and so is translations; errors of an eccentric robot are compared at joint values and "
                "between them, or by its certificate at translations"
            )
        where = ()
    nominal = _batch((robot.tubes,), robot, where, tuple(poses))
    if np.isnan(nominal[1]).any():
        raise SolveError("the nominal robot has no stable equilibrium at a compared pose")
    tubes = sample_tubes(robot.tubes, tolerances, samples)
    batches = [tubes[k : k + 64] for k in range(0, samples, 64)]
    with executor(min(workers, len(batches))) as pool:
        parts = run_all(partial(_batch, robot=robot, translations=where, poses=tuple(poses)), batches, pool, progress)
    certificate, tip = (np.concatenate([part[k] for part in parts]) for k in range(2))
    distance = np.linalg.norm(tip - nominal[1], axis=2)
    free = int((certificate > 0).sum())
    interval = scipy.stats.binomtest(free, samples).proportion_ci(0.95, method="wilson")
    return ToleranceAnalysis(
        certificate=certificate,
        snap_free=free / samples,
        interval=(float(interval.low), float(interval.high)),
        margin=margin,
        margin_kept=float((certificate >= margin).mean()),
        tip=tip,
        spread=np.sqrt(np.nanmean(distance**2, axis=0)),
        spread_95=np.nanquantile(distance, 0.95, axis=0),
        failed=int(np.isnan(distance).any(axis=1).sum()),
    )


def sample_tubes(tubes: Sequence[Tube], tolerances: Tolerances, samples: int, seed: int = 0) -> list[tuple[Tube, ...]]:
    """Sets of tubes with random errors, `samples` in number."""
    random = np.random.default_rng(seed)
    size = (samples, len(tubes), 4)
    errors = random.standard_normal(size) if tolerances.distribution == "normal" else random.uniform(-1, 1, size)
    return [
        tuple(_made(tube, tolerances, tube_errors) for tube, tube_errors in zip(tubes, row, strict=True))
        for row in errors.tolist()
    ]


def _made(tube: Tube, tolerances: Tolerances, errors: Sequence[float]) -> Tube:
    """Tube with errors (4,) in standard deviations or half widths; pieces stiffen in the same proportion."""
    bend, stiff, straight, curved = errors
    factor = 1 + tolerances.stiffness * stiff
    length = max(0.0, tube.curved_length + tolerances.curved_length * curved)
    longer = length / tube.curved_length if tube.pieces else 1.0
    pieces = tuple(piece.stretched(longer).stiffened(factor) for piece in tube.pieces)
    return replace(
        tube,
        curvature=tube.curvature * (1 + tolerances.curvature * bend),
        straight_length=max(0.0, tube.straight_length + tolerances.straight_length * straight),
        curved_length=length,
        bending_stiffness=float(tube.bending_stiffness) * factor,
        torsional_stiffness=float(tube.torsional_stiffness) * factor,
        pieces=pieces,
    )


def _batch(
    batch: Sequence[tuple[Tube, ...]],
    robot: DesignedRobot,
    translations: tuple[tuple[float, ...], ...],
    poses: tuple[tuple[Array, Array], ...],
) -> tuple[Array, Array]:
    """Smallest certificate (B,) and tips (B, P, 3) of sampled tubes."""
    certificates = np.zeros(len(batch))
    tips = np.full((len(batch), len(poses), 3), np.nan)
    for k, tubes in enumerate(batch):
        straight = np.array([tube.straight_length for tube in tubes])
        rotations, shift = (np.array([pose[part] for pose in poses], dtype=float) for part in (0, 1))
        if isinstance(robot, BundleRobot):
            for carriage in robot.moving_together:
                straight[[*carriage]] = straight[[*carriage]].min()
            made = replace(robot, tubes=tubes)
            with suppress(SolveError):
                if poses:
                    certificates[k], tips[k] = _used(made, rotations, np.minimum(shift, straight))
            if translations:
                rows = (np.minimum(row, straight) for row in translations)
                certificates[k] = min(snap_free_certificate(made, row) for row in rows)
            continue
        sample = ConcentricRobot(tubes)
        certificates[k] = min(snap_free_certificate(sample, np.minimum(row, straight)) for row in translations)
        if poses:
            solved = forward_kinematics_batch(sample, rotations, np.minimum(shift, straight))
            tips[k, solved.stable] = solved.tip_position[solved.stable]
    return certificates, tips


# Rows of a joint path between two poses, at which its margin is read; `follow` finds snaps between rows.
ROWS = 8


def _used(robot: BundleRobot, rotations: Array, translations: Array) -> tuple[float, Array]:
    """Smallest margin on the joint paths through poses (P, n), 0 if the robot snaps there, and tips (P, 3), m."""
    at = np.linspace(0, len(rotations) - 1, ROWS * (len(rotations) - 1) + 1)
    rows = [
        np.column_stack([np.interp(at, np.arange(len(table)), column) for column in table.T])
        for table in (rotations, translations)
    ]
    path = follow(robot, *rows)
    margin = 0.0 if path.snaps else min(e.margin for e in path.equilibria)
    return margin, np.array([e.tip_position for e in path.equilibria[::ROWS]])

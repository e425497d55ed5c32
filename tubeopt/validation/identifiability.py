"""Identifiability of parameters from measured tips, as remarks; and optimal configurations to measure.

Configurations to measure are D-optimal: of many random ones, those that make the determinant of the parameters'
covariance least, the registration being estimated along (D_s-optimality; Atkinson, Donev and Tobias, Optimum
Experimental Designs (2007), section 10.3), added one by one and then exchanged while that gains (Fedorov 1972). A path
through them does not snap.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, NamedTuple

import numpy as np

from ..arguments import typed
from ..display import Displayed
from ..equilibrium.readings import to_readings
from ..errors import InputError, SolveError
from ..files.field_metadata import MARGIN, POSITIVE, TYPICAL_NOISE, OneOf, Range, form, typical_length, unit
from ..inverse.joints import joint_space
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.robust_least_squares import RobustDescent
from ..solvers.time_limit import TIME_LIMIT, limited
from ..stability import follow
from ..typing import Array, Mask
from .effects import EFFECTS
from .measurements import Measurements
from .model import ArmModel, ParameterState, solve_poses
from .parameters import Parameter, choose_parameters, groups
from .sessions import Registrations, Sessions

# A combination of parameters is undetermined if a large change of it moves the tips by less than this part of the
# arm's length (root mean square), once the registration has followed.
NO_EFFECT = 1e-4


def undetermined(parameters: Sequence[Parameter], jacobian: Array, length: float) -> tuple[list[int], list[str]]:
    """Indices of parameters to fix so that all others are determined, and the reasons as text.

    Args:
        jacobian: (V, 3, P + F) of the residuals by parameters and registration, directions in units of the arm's
            length, m.   length: of the arm, m.
    """
    scaled = beside_registration(jacobian, len(parameters)) * [p.scale for p in parameters]
    # RMS motion of the tips, in lengths of the arm, per plausible change of each parameter.
    scaled /= length * math.sqrt(len(jacobian))
    independent: list[int] = []
    held, remarks = [], []
    for k, parameter in enumerate(parameters):
        # Added one by one in the user's order: of two indistinguishable ones the first is estimated.
        _, singular, directions = np.linalg.svd(scaled[:, [*independent, k]], full_matrices=False)
        if singular[-1] > NO_EFFECT:
            independent.append(k)
            continue
        held.append(k)
        with_it = [parameters[j].name for j, part in zip(independent, directions[-1], strict=False) if abs(part) > 0.05]
        if with_it:
            remarks.append(
                f"{parameter.name} cannot be distinguished from a change of {join(with_it)} together with the "
                f"registration; fixed at {shown(parameter.start, parameter.unit)}"
            )
        else:
            remarks.append(
                f"{parameter.name} has next to no effect on the measured tips: a change by "
                f"{shown(parameter.scale, parameter.unit)} moves them by less than "
                f"{shown(NO_EFFECT * length, 'm')} (RMS) after a new registration; fixed at "
                f"{shown(parameter.start, parameter.unit)}"
            )
    return held, remarks


def left_out(parameter: Parameter) -> str:
    """Remark on a parameter that has no influence."""
    return f"{parameter.name} has no influence on the tips and was left out: {parameter.idle}"


def beside_registration(jacobian: Array, count: int) -> Array:
    """(3V, P) columns of a Jacobian (V, 3, P + F) by parameters, after removing the effect of the registration."""
    flat = jacobian.reshape(3 * len(jacobian), jacobian.shape[2])
    # What is orthogonal to the columns of the registration is all that it cannot undo.
    q, _ = np.linalg.qr(flat[:, count:])
    return np.asarray(flat[:, :count] - q @ (q.T @ flat[:, :count]))


def doubts(
    parameters: Sequence[Parameter], free: Sequence[int], values: Array, half: Array, correlation: Array
) -> list[str]:
    """Remarks on a fit: values at the edge of their range, wide intervals, correlated pairs.

    Args:
        free: indices of the parameters that were estimated.   values, half: (P,) estimates and half widths of their
            intervals.   correlation: (P, P).
    """
    remarks = []
    for k in free:
        p = parameters[k]
        if min(values[k] - p.low, p.high - values[k]) <= 1e-6 * p.scale:
            remarks.append(f"{p.name} ended at the edge of its range: the interval is not valid there")
        if half[k] > p.scale:
            remarks.append(f"{p.name} is hardly determined: its interval is wider than any plausible range")
    for a, j in enumerate(free):
        for k in free[a + 1 :]:
            if abs(correlation[j, k]) > 0.99:
                remarks.append(
                    f"{parameters[j].name} and {parameters[k].name} are entangled (correlation "
                    f"{correlation[j, k]:.3f}): the data determine a combination of them far better than each"
                )
    return remarks


# Kinds of numbers of the tubes that explain each other's effects on the tips.
TUBE_KINDS = (
    "curvature", "piece_curvature", "curved_length", "dead_length", "fade", "bending_stiffness", "torsional_stiffness",
    "stiffness_ratio", "nu", "transmission_length",
)  # fmt: skip


def least_certain(parameters: Sequence[Parameter], free: Sequence[int], half: Array, correlation: Array) -> list[str]:
    """Remark on the least certain combination, if length, stiffness and shape of tubes replace each other.

    Args:
        free, half, correlation: as for `doubts`.
    """
    tube_parameters = [k for k in free if parameters[k].kind in TUBE_KINDS]
    related = correlation[np.ix_(tube_parameters, tube_parameters)] - np.eye(len(tube_parameters))
    if not related.size or np.abs(related).max() < 0.9:
        return []
    scale = np.array([parameters[k].scale for k in tube_parameters])
    deviation = half[tube_parameters] / scale
    variance, directions = np.linalg.eigh(
        correlation[np.ix_(tube_parameters, tube_parameters)] * np.outer(deviation, deviation)
    )
    step = directions[:, -1] * math.sqrt(max(variance[-1], 0.0))
    step *= np.sign(step[np.argmax(np.abs(step))])
    parts = [
        f"{parameters[k].name} {'+' if x > 0 else '-'}{shown(abs(x) * s, parameters[k].unit)}"
        for k, x, s in zip(tube_parameters, step.tolist(), scale.tolist(), strict=True)
        if abs(x) > 0.1 * np.abs(step).max()
    ]
    return [
        f"length, stiffness and shape explain each other: the tips change least with {join(parts)} together, and each "
        "is as uncertain as that"
    ]


def louder(left: Sequence[float], known: Sequence[float | None]) -> list[str]:
    """Remarks on residuals far beyond the given noise of positions, m, or of directions, rad."""
    remarks = []
    for spread, noise, kind in zip(left, known, ("m", "rad"), strict=True):
        if noise and spread > 3.0 * noise:
            remarks.append(
                f"residuals are {spread / noise:.2g} times the noise that was given ({shown(spread, kind)} for "
                f"{shown(noise, kind)}): the intervals are too narrow, since the model lacks something or the noise is "
                "larger"
            )
    return remarks


def shown(value: float, unit: str) -> str:
    """A value of a parameter in the unit that people use."""
    if unit == "rad":
        return f"{math.degrees(value):.4g} deg"
    if unit == "m":
        return f"{1e3 * value:.4g} mm"
    if unit == "m/N":
        return f"{1e3 * value:.4g} mm/N"
    return f"{value:.4g} {unit}".strip()


def join(names: Sequence[str]) -> str:
    """Text of names in the form "a, b and c"."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def entangled_history(model: Sessions, fit: RobustDescent[ParameterState[Registrations]]) -> list[str]:
    """Remark on a fitted effect of history that other effects could reproduce in these data."""
    fitted = {p.name.partition("@")[0] for p in model.parameters if p.effect.history}
    if not fitted:
        return []
    known = groups(model.robot, model.recordings, model.method)
    names = [name for kind, choices in known.items() if EFFECTS[kind].history for name in choices if name not in fitted]
    if not names:
        return []
    parameters = choose_parameters(model.robot, model.recordings, names, model.method)
    every = [*model.parameters, *parameters]
    count, slopes = len(model.parameters), model.slopes_with(fit, parameters)
    flat = slopes.reshape(-1, slopes.shape[2])
    usual = [k for k, p in enumerate(every) if not p.effect.history] + list(range(len(every), flat.shape[1]))
    remarks = []
    for k, p in enumerate(every):
        if k >= count or not p.effect.history:
            continue
        rivals = [j for j, q in enumerate(every) if q.kind != p.kind and q.effect.history]
        left = _unexplained(flat[:, k], flat[:, usual])
        parted = _unexplained(left, np.column_stack([_unexplained(flat[:, j], flat[:, usual]) for j in rivals]))
        ratio = float(np.linalg.norm(parted)) / max(float(np.linalg.norm(left)), 1e-300)
        if ratio < 0.3:  # of it, the others of its kind cannot imitate
            kinds = " and ".join(sorted({every[j].kind for j in rivals}))
            remarks.append(
                f"{p.name} can hardly be distinguished from {kinds} on this path: these explain all but "
                f"{100 * ratio:.0f} % of it. Measure the same path once slowly and once fast: a latency grows with the "
                "speed, play and friction do not"
            )
    return remarks


def _unexplained(column: Array, columns: Array) -> Array:
    """Residual of a column after a least-squares fit of the other columns."""
    if not columns.shape[1]:
        return column
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    answer = np.linalg.lstsq(columns / scale, column, rcond=1e-10)[0]
    return np.asarray(column - (columns / scale) @ answer)


# Registrations of measurements that are planned; "saved" is of a calibration, which comes after them.
PLANNED_REGISTRATIONS = ("rigid", "base-axis", "none")


# Random configurations that are chosen from. For curvature and rotations of the thesis robot, 300 give standard
# errors up to 2.6 times larger; 1200 change them by -21 to +8 % and take 10 s in place of 6 s.
CANDIDATES = 600

# Times as many are drawn at most, until enough are admissible: where fewer than one in 60 is, the limits leave a
# corner.
DRAWS = 60

# Times that every chosen configuration is offered for exchange (Fedorov). It ends earlier where nothing is exchanged.
EXCHANGES = 8

# Random choices whose median states the gain of the chosen one.
COMPARED = 20


@dataclass(frozen=True, eq=False)
class Placement(Displayed):
    """Configurations to measure, in an order that can be driven."""

    robot: Robot
    """Robot to measure."""
    rotations: Annotated[Array, unit("deg"), "rotations of the drives at the waypoints"]
    """Readings (N, n); home at segments of the path around a snap."""
    translations: Annotated[Array, unit("mm"), "translations of the drives at the waypoints"]
    """(N, n) readings of the translations, m."""
    measured: Annotated[Mask, "true for waypoints that are measured"]
    """(N,) True for waypoints to measure."""
    margin: Array
    """(N,) margins of the waypoints."""
    parameters: tuple[str, ...]
    """Names of the parameters."""
    units: tuple[str, ...]
    """Units of their standard errors."""
    standard_errors: Array
    """(P,) expected at `noise`."""
    random: Array
    """(P,) median of the standard errors with as many random configurations."""
    noise: Annotated[
        float,
        unit("mm"),
        form(".3g", label="assumed noise"),
        "noise of the measurement that the expected errors assume",
    ]


@typed
@small
@limited
def where_to_measure(
    robot: Robot,
    parameters: Sequence[str],
    count: Annotated[int, Range(minimum=3)] = 30,
    *,
    min_margin: Annotated[float, MARGIN] = 0.1,
    noise: Annotated[float, unit("mm"), POSITIVE, TYPICAL_NOISE] = 0.5e-3,
    registration: Annotated[str, OneOf(PLANNED_REGISTRATIONS)] = "rigid",
    seed: Annotated[int, Range(minimum=0)] = 0,
    time_limit: float = TIME_LIMIT,
) -> Placement:
    """Configurations within the joint limits with tips that determine parameters best.

    Each has at least the margin `min_margin`, and is reached from home by a straight motion of the joints on which the
    robot was followed without a snap, so that every segment of the path can at worst go through home.

    Args:
        parameters: as for `fit`; those that need time (latency, play) are found by driving one path slowly and fast.
        count: number of configurations. Their measured numbers must be more than the unknowns.
        min_margin: smallest allowed stability margin, below 1.
        noise: standard deviation of a measured coordinate, for the expected errors, m.
        registration: planned transformation from device frame to base frame: rigid, base-axis or none.
        seed: random seed of the candidate configurations.
        time_limit: s, on the clock.

    Raises:
        InputError: too few configurations, a noise or margin out of range, and what `choose_parameters` raises.
        SolveError: too few configurations of the robot have the margin.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.
    """
    typical_length("noise", noise, TYPICAL_NOISE)
    if not 0 <= min_margin < 1:
        raise InputError(f"min_margin is {min_margin:g}; it must be at least 0 and less than 1")
    alpha, shift, tips = _candidates(robot, min_margin, seed)
    data = Measurements(*to_readings(robot, alpha, shift), tips, source="where to measure")
    chosen, model = _checked_question(robot, data, parameters, registration, count)
    slopes = _scaled(model, chosen, noise)
    best = _reachable(lambda usable: _exchange(slopes, len(chosen), count, usable), robot, (alpha, shift), tips)
    scale = np.array([p.scale for p in chosen])
    random = np.random.default_rng(seed + 1)
    random_errors = [
        _errors(slopes[random.choice(len(data), count, replace=False)], len(chosen)) for _ in range(COMPARED)
    ]
    rows, joints = _measuring_path(robot, alpha[best], shift[best])
    margin = solve_poses(robot, *joints, model.stations).margin
    return Placement(
        robot,
        *to_readings(robot, *joints),
        measured=rows >= 0,
        margin=margin,
        parameters=tuple(p.name for p in chosen),
        units=tuple(p.unit for p in chosen),
        standard_errors=_errors(slopes[best], len(chosen)) * scale,
        random=np.median(random_errors, axis=0) * scale,
        noise=noise,
    )


def _checked_question(
    robot: Robot, data: Measurements, names: Sequence[str], registration: str, count: int
) -> tuple[tuple[Parameter, ...], ArmModel]:
    """Parameters to be determined, and the model of the observations; raises as `where_to_measure`."""
    for name in names:
        if name.startswith(tuple(kind for kind, effect in EFFECTS.items() if effect.history)):
            raise InputError(
                f"parameter {name!r} depends on the path: single configurations do not "
                "determine it; record one path slowly and fast"
            )
    chosen = choose_parameters(robot, data, names, registration)
    model = ArmModel(robot, data, chosen, registration)
    if 3 * count <= len(chosen) + model.freedoms:
        raise InputError(
            f"count is {count}; {len(chosen) + model.freedoms} unknowns need more than {3 * count} numbers"
        )
    if count > len(data) // 2:
        raise SolveError(f"{len(data)} of {CANDIDATES} random configurations have the margin; {count} are needed")
    _, lost = undetermined(chosen, model.jacobian(model.start), model.length)
    if lost:
        raise InputError(f"{lost[0].rsplit(';', 1)[0]}, wherever it is measured; leave it out, or measure the base")
    return chosen, model


def _reachable(
    choose: Callable[[Mask], list[int]], robot: Robot, joints: tuple[Array, Array], tips: Array
) -> list[int]:
    """The best of those configurations that are reached from home without a snap; raises SolveError if too few are."""
    (alpha, shift), usable = joints, np.ones(len(joints[0]), dtype=bool)
    while True:
        best = choose(usable)
        segments = {k: (_home(robot), (alpha[k], shift[k]), tips[k]) for k in best}
        blocked = [k for k, segment in segments.items() if not _segment(robot, *segment)]
        if not blocked:
            return best
        usable[blocked] = False
        if usable.sum() < len(best):
            raise SolveError(f"fewer than {len(best)} random configurations can be reached from home without a snap")


class _Candidates(NamedTuple):
    """C configurations that may be measured."""

    rotations: Array
    """(C, n) rotations of the candidates, rad."""
    translations: Array
    """(C, n) translations of the candidates, m."""
    tips: Array
    """(C, 3) tip positions of the candidates, m."""


def _candidates(robot: Robot, min_margin: float, seed: int) -> _Candidates:
    """Random joint values of the model that satisfy the limits, the order of carriages and ends, and the margin."""
    random, limits, space = np.random.default_rng(seed), robot.limits, joint_space(robot)
    straight, curved = np.array([(tube.straight_length, tube.curved_length) for tube in robot.tubes]).T
    low, high = np.array(limits.translations).T
    valid: list[Array] = []
    for _ in range(CANDIDATES * DRAWS):
        if len(valid) == CANDIDATES:
            break
        drawn = random.uniform(low, np.minimum(high, straight)) - space.offset[robot.n_tubes :]
        q = np.append(space.lower[: robot.n_tubes], drawn[[tubes[0] for tubes in space.carriages]])
        shift = space.joint(q)[robot.n_tubes :]
        if space.admissible(q) and (shift + curved).max() > 0.25 * curved.max():
            valid.append(shift)
    if not valid:
        raise SolveError("no random translations within the limits satisfy the tube order")
    shift = np.array(valid)
    low, high = np.array(limits.rotations).T
    alpha = random.uniform(low, high, size=(len(valid), robot.n_tubes))
    poses = solve_poses(robot, alpha, shift, np.zeros(1))
    good = np.nan_to_num(poses.margin, nan=-1.0) >= max(min_margin, 1e-6)
    if good.sum() < 3:
        raise SolveError(f"too few random configurations of the robot have the margin {min_margin:g}")
    return _Candidates(alpha[good], shift[good], poses.position[good, 0])


def _scaled(model: ArmModel, chosen: Sequence[Parameter], noise: float) -> Array:
    """(C, 3, Q) slopes of every candidate, by scaled parameters and the registration, in units of the noise."""
    slopes = model.jacobian(model.start) / noise
    slopes[..., : len(chosen)] *= [p.scale for p in chosen]
    slopes[..., len(chosen) : len(chosen) + 3] *= 0.1  # rad
    slopes[..., len(chosen) + 3 :] *= 1e-2  # m
    return slopes


def _exchange(slopes: Array, parameters: int, count: int, usable: Mask) -> list[int]:
    """Rows of a D_s-optimal selection, found by exchange."""
    size = slopes.shape[2]
    # Next to nothing stands for what is not known yet.
    start = 1e-9 * float(np.einsum("caq,caq->", slopes, slopes)) / size * np.eye(size)
    chosen: list[int] = []

    def best(without: Sequence[int]) -> int:
        information = start + np.einsum("caq,car->qr", slopes[list(without)], slopes[list(without)])
        # D_s: log det of all unknowns less that of the registration, which is estimated but of no interest.
        gain = _gain(information, slopes) - _gain(information[parameters:, parameters:], slopes[..., parameters:])
        gain[~usable] = -np.inf
        gain[list(without)] = -np.inf
        return int(np.argmax(gain))

    while len(chosen) < count:
        chosen.append(best(chosen))
    for _ in range(EXCHANGES):
        before = list(chosen)
        for k in range(count):
            chosen[k] = best([j for i, j in enumerate(chosen) if i != k])
        if chosen == before:
            break
    return chosen


def _gain(information: Array, slopes: Array) -> Array:
    """(C,) increase of log det of the information by each candidate."""
    # det(M + J^T J) = det M det(1 + J M^-1 J^T), a determinant of three rows in place of Q.
    gained = slopes @ np.linalg.inv(information) @ slopes.transpose(0, 2, 1)
    return np.asarray(np.linalg.slogdet(np.eye(3) + gained)[1])


def _errors(slopes: Array, parameters: int) -> Array:
    """(P,) standard errors in the scales of the parameters."""
    information = np.einsum("caq,car->qr", slopes, slopes)
    return np.asarray(np.sqrt(np.maximum(np.diag(np.linalg.pinv(information, hermitian=True)), 0))[:parameters])


def _home(robot: Robot) -> tuple[Array, Array]:
    return robot.home_rotations, robot.home_translations


def _segment(robot: Robot, start: tuple[Array, Array], end: tuple[Array, Array], tip: Array | None = None) -> bool:
    """True if a straight motion does not snap, and ends at the equilibrium with tip rotations `tip`, if given."""
    try:
        path = follow(robot, [start[0], end[0]], [start[1], end[1]])
    except SolveError:
        return False
    arrived = path.equilibria[-1]
    return not path.snaps and (tip is None or float(np.linalg.norm(arrived.tip_position - tip)) < 1e-6)


def _measuring_path(robot: Robot, rotations: Array, translations: Array) -> tuple[Array, tuple[Array, Array]]:
    """Rows of a path from home, each time to the nearest remaining one, -1 for home, and its joint values."""
    home = _home(robot)
    scaled = np.hstack([rotations, 20.0 * translations])  # an arm bends by about 20 rad per m
    left, position, order = list(range(len(scaled))), np.append(home[0], 20.0 * home[1]), [-1]
    while left:
        nearest = min(left, key=lambda k: float(np.linalg.norm(scaled[k] - position)))
        left.remove(nearest)
        position = scaled[nearest]
        order.append(nearest)
    joints = [home if k < 0 else (rotations[k], translations[k]) for k in order]
    rows, out = [-1], [home]
    for (_, start), (k, end) in pairwise(zip(order, joints, strict=True)):
        if k >= 0 and start is not home and not _segment(robot, start, end):
            rows.append(-1)
            out.append(home)
        rows.append(k)
        out.append(end)
    return np.array(rows), (np.array([a for a, _ in out]), np.array([d for _, d in out]))

"""Loads of the drives along a motion, or at many configurations: what their motors need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..bodies.obstacles import Obstacle
from ..display import Displayed
from ..equilibrium.drive_loads import drive_loads
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, positive, vector
from ..files.field_metadata import form, unit
from ..robots.concentric import Friction
from ..robots.eccentric import by_model
from ..robots.load import Load
from ..robots.robot import Robot
from ..solvers.blas import small
from ..solvers.time_limit import LONG_TIME_LIMIT, check_time, limited
from ..typing import Array, Progress, StatusEnum
from .following import checked_waypoints, follow, stretches
from .motion import Snap


class DrivesStatus(StatusEnum):
    """Subject of the loads of drives, as a sentence."""

    ALONG = "loads of the drives along a motion"
    AT = "loads of the drives at single configurations"


@dataclass(frozen=True)
class DrivesStatistics:
    """Numbers of equilibria."""

    equilibria: int
    """Equilibria with loads."""
    failures: int
    """Configurations without a stable equilibrium."""


@dataclass(frozen=True, eq=False)
class Drives(Displayed):
    """Torques, forces and power of the drives of n tubes on C carriages, at T equilibria.

    A snap has two rows, before and after it, at the same time.
    """

    _brief = ("peak_torque", "peak_force", "peak_torque_power", "peak_force_power", "status")

    robot: Robot
    """Robot that is driven."""
    at: Array
    """(T,) times, s; without times the numbers of the waypoints or configurations, from 0."""
    timed: bool
    """True if `at` are times."""
    rotations: Array
    """(T, n) rotations, rad."""
    translations: Array
    """(T, n) translations, m."""
    torque: Array
    """(T, n) torques of the rotation drives on the tubes, N m."""
    force: Array
    """(T, C) forces of the carriages on the tubes, N."""
    snaps: tuple[Snap, ...]
    """Snaps along the motion."""
    heat: Annotated[float, unit("mJ"), form(".4g"), "heat of the friction between the tubes"]
    """Since the start, J."""
    rates: tuple[float, float] | None
    """Rates of all drives at single configurations, rad/s and m/s; None for none, and along a motion."""
    status: DrivesStatus
    """Subject of the loads, as a sentence."""
    statistics: DrivesStatistics
    """Numbers of equilibria."""

    @property
    def peak_torque(self) -> Array:
        """(n,) largest torques of the rotation drives, N m."""
        return np.asarray(np.abs(self.torque).max(0))

    @property
    def peak_force(self) -> Array:
        """(C,) largest forces of the carriages, N."""
        return np.asarray(np.abs(self.force).max(0))

    @property
    def carried(self) -> Array:
        """(T, C) positions of the carriages, m: translations of their first tubes."""
        return self.translations[:, [tubes[0] for tubes in self.robot.moving_together]]

    @property
    def turn_rate(self) -> Array:
        """(T - 1, n) rotation rates between the rows, rad/s; NaN without times, and at snaps."""
        return self._rate(self.rotations)

    @property
    def slide_rate(self) -> Array:
        """(T - 1, C) speeds of the carriages between the rows, m/s; NaN without times, and at snaps."""
        return self._rate(self.carried)

    def _rate(self, values: Array) -> Array:
        step = np.diff(self.at) if self.timed else np.zeros(len(self.at) - 1)
        return np.asarray(np.diff(values, axis=0) / np.where(step > 0, step, np.nan)[:, None])

    @property
    def peak_torque_power(self) -> Array:
        """(n,) largest mechanical powers of the rotation drives, W; NaN without times or rates."""
        return _peak_power(self.torque, self.turn_rate) if self.rates is None else self.rates[0] * self.peak_torque

    @property
    def peak_force_power(self) -> Array:
        """(C,) largest mechanical powers of the carriages, W; NaN without times or rates."""
        return _peak_power(self.force, self.slide_rate) if self.rates is None else self.rates[1] * self.peak_force

    @property
    def work(self) -> float:
        """Work of all drives, J, by the trapezoidal rule; NaN at single configurations."""
        if self.status is DrivesStatus.AT:
            return float("nan")
        turned, moved = np.diff(self.rotations, axis=0), np.diff(self.carried, axis=0)
        return float(
            ((self.torque[1:] + self.torque[:-1]) / 2 * turned).sum()
            + ((self.force[1:] + self.force[:-1]) / 2 * moved).sum()
        )

    @property
    def value(self) -> tuple[Array, Array]:
        """Largest torques (n,), N m, and forces (C,), N."""
        return self.peak_torque, self.peak_force


def _peak_power(load: Array, rate: Array) -> Array:
    """Largest power (k,) of loads (T, k) that move at rates (T - 1, k), W; NaN without a rate, 0 if always driven."""
    power = np.concatenate([load[:-1] * rate, load[1:] * rate])
    known = np.isfinite(power)
    return np.where(known.any(0), np.maximum(np.where(known, power, 0.0).max(0, initial=0.0), 0.0) + 0.0, np.nan)


@typed
@by_model
@small
@limited
def drives_along(  # noqa: PLR0913
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    time: ArrayLike | None = None,
    start: Equilibrium | None = None,
    load: Load | None = None,
    friction: Friction | None = None,
    walls: Sequence[Obstacle] = (),
    time_limit: float = LONG_TIME_LIMIT,
) -> Drives:
    """Torques, forces and power of the drives along a slow motion through waypoints.

    The motion is that of `follow`, and the loads are those of `drive_loads`. The inertia of tubes and drives, and the
    friction of the drives themselves, are not included.

    Args:
        rotations, translations: (T, n) rad and m; translations default to home.
        time: (T,) increasing times of the waypoints, s; without them there is no power.
        start, load, friction, walls: as of `follow`.
        time_limit: maximum run time, s.

    Raises:
        InputError: as `follow` and `drive_loads`; times that do not increase.
        SolveError: as `follow`.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("two_tube")
        >>> drives = tubeopt.drives_along(robot, [[0, 0], [1.0, 0]], time=[0, 2])
        >>> drives.torque.shape, drives.peak_torque_power.shape
        ((2, 2), (2,))
    """
    alpha, shift = checked_waypoints(robot, rotations, translations)
    at = np.arange(float(len(alpha)))
    if time is not None:
        at = vector("time", time, len(alpha), "s, one for each waypoint")
        if (np.diff(at) <= 0).any():
            k = int(np.argmax(np.diff(at) <= 0))
            raise InputError(f"time[{k + 1}] is {at[k + 1]:g} s after {at[k]:g} s; times must increase")
    path = follow(robot, alpha, shift, start=start, load=load, friction=friction, walls=walls)
    times, states, parts = list[float](), list[Equilibrium](), list[int]()
    for k, part in enumerate(stretches(path, at)):
        times += part.at.tolist()
        states += part.equilibria
        parts += [k] * len(part.at)
    torque, force = list[Array](), list[Array]()
    for k, state in enumerate(states):
        check_time()
        # Where breakpoints coincide, the forces are those of the motion ahead, and at its end of the motion behind.
        last = k == len(states) - 1
        moved = (
            state.translations - states[k - 1].translations if last else states[k + 1].translations - state.translations
        )
        back = np.array([(moved[tubes[0]] > 0) == last and moved[tubes[0]] != 0 for tubes in robot.moving_together])
        before = states[k - 1] if k and parts[k] == parts[k - 1] else None
        loads = drive_loads(state, previous=before)
        withdrawing = drive_loads(state, side=-1, previous=before) if back.any() else loads
        torque.append(loads.torque)
        force.append(np.where(back, withdrawing.force, loads.force))
    heats = [state.friction.heat for state in (states[0], states[-1]) if state.friction is not None]
    return Drives(
        robot=robot,
        at=np.array(times),
        timed=time is not None,
        rotations=np.array([state.rotations for state in states]),
        translations=np.array([state.translations for state in states]),
        torque=np.array(torque),
        force=np.array(force),
        snaps=path.snaps,
        heat=heats[1] - heats[0] if len(heats) == 2 else 0.0,
        rates=None,
        status=DrivesStatus.ALONG,
        statistics=DrivesStatistics(len(states), 0),
    )


@typed
@by_model
@small
@limited
def drives_at(
    robot: Robot,
    rotations: ArrayLike,
    translations: ArrayLike | None = None,
    *,
    load: Load | None = None,
    rates: tuple[float, float] | None = None,
    progress: Progress | None = None,
    time_limit: float = LONG_TIME_LIMIT,
) -> Drives:
    """Torques and forces of the drives at single configurations, such as samples of a workspace.

    Each equilibrium is that of `forward_kinematics`, without a history. Where breakpoints coincide, the forces are
    those of advancing carriages.

    Args:
        rotations, translations: (T, n) rad and m; translations default to home.
        load: external load, the same at all configurations.
        rates: rate of all rotation drives, rad/s, and of all carriages, m/s, for the power; None for no power.
        progress: called with the configurations done and their number.
        time_limit: maximum run time, s.

    Raises:
        InputError: as `forward_kinematics` and `drive_loads`.
        SolveError: no configuration has a stable equilibrium.
        TimeLimitError: (a SolveError) the time limit was reached before there was an answer.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("two_tube")
        >>> samples = tubeopt.workspace(robot, 16)
        >>> tubeopt.drives_at(robot, samples.rotations, samples.translations).force.shape
        (16, 2)
    """
    alpha, shift = checked_waypoints(robot, rotations, translations)
    if rates is not None:
        turn, slide = vector("rates", rates, 2, "rad/s and m/s").tolist()
        rates = positive("the rate of the rotations", turn), positive("the rate of the translations", slide)
    rows, torque, force = list[int](), list[Array](), list[Array]()
    for k in range(len(alpha)):
        check_time()
        if progress is not None:
            progress(k, len(alpha))
        try:
            loads = drive_loads(forward_kinematics(robot, alpha[k], shift[k], load=load))
        except SolveError:
            continue
        rows.append(k)
        torque.append(loads.torque)
        force.append(loads.force)
    if not rows:
        raise SolveError("no configuration has a stable equilibrium")
    return Drives(
        robot=robot,
        at=np.array(rows, dtype=float),
        timed=False,
        rotations=alpha[rows],
        translations=shift[rows],
        torque=np.array(torque),
        force=np.array(force),
        snaps=(),
        heat=0.0,
        rates=rates,
        status=DrivesStatus.AT,
        statistics=DrivesStatistics(len(rows), len(alpha) - len(rows)),
    )

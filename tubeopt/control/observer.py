"""Observer of joint offsets, stiffnesses and a tip offset, from a sensor at the tip of a moving robot.

An extended Kalman filter over parameters that hardly change. A measurement is compared with the model at the joint
values of its own time, so that a delay that is known costs nothing; where none comes, nothing is corrected. Each update
linearises anew a few times about what it has found (Bell and Cathey, IEEE TAC 38 (1993)); what is far beyond all that
could be is left out.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..arguments import typed
from ..display import Displayed
from ..equilibrium.jacobian import jacobian
from ..equilibrium.kinematics import forward_kinematics, one_step
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError, finite, vector, without_unit_warnings
from ..robots.concentric import ConcentricRobot
from ..robots.robot import Robot
from ..typing import Array

BY = ("rotations", "bending_stiffness", "torsional_stiffness")

# Drift of the parameters per square root of a second, as a fraction of their standard deviations. Without it the
# covariance falls to 0, and offsets that change later are never seen. With it the variance of the prior is back after
# 2500 s.
DRIFT = 0.02

# Duration of stored joint values, s: the largest delay of a measurement. Trackers are late by 10 to 100 ms.
MEMORY = 1.0

# Standard deviations per axis beyond which a measurement is left out: three normal numbers are as far off once in
# 1e15 times.
GATE = 5.0

# Linearisations per update (iterated filter). The tip is nearly linear in offsets of a few degrees: the first brings it
# within their square, the second within the fourth power.
LINEARISATIONS = 3


@dataclass(frozen=True)
class ObserverOptions:
    """Standard deviations of the measurement and of the uncertain parameters."""

    noise: float = 5e-4
    """Standard deviation of a measured position per axis, m."""
    rotation: float = np.radians(3.0)
    """Standard deviation of the joint offsets, rad."""
    stiffness: float = 0.05
    """Relative standard deviation of every tube's stiffness."""
    offset: float = 1e-4
    """Standard deviation of the tip offset per axis, m."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if finite(name, value) < 0 or (name == "noise" and value == 0):
                raise InputError(f"{name} is {value:g}; it must be more than 0")


@dataclass(frozen=True, eq=False)
class Correction(Displayed):
    """Result of a measurement for an observer."""

    used: bool
    """True if the measurement corrected the model."""
    words: str
    """Reason for an unused measurement; "" for a used one."""
    before: float
    """Distance of the measured tip from the one that was expected, m."""
    after: float
    """Distance after the correction, m."""


@typed
class Observer:
    """Corrects the model of one robot of concentric tubes, of one arc each or made of pieces, by measured tips.

    Args:
        start: the equilibrium of the model where the robot is.   options: see `ObserverOptions`.

    Raises:
        InputError: tubes beside the centreline.
    """

    def __init__(self, start: Equilibrium, options: ObserverOptions | None = None) -> None:
        robot = start.robot
        if not isinstance(robot, ConcentricRobot):
            raise InputError("an observer supports concentric robots only")
        self.options = options or ObserverOptions()
        self._n, self._given, self._arm = robot.n_tubes, robot, start
        spread = [self.options.rotation] * self._n + [self.options.stiffness] * self._n + [self.options.offset] * 3
        self._prior = np.array(spread)
        self._x: Array = np.zeros(len(spread))
        self._cov: Array = np.diag(self._prior**2)
        self._past: deque[tuple[float, Array, Array]] = deque()
        self._time = -np.inf

    @property
    def rotation_offsets(self) -> Array:
        """(n,) estimated offsets of the tube rotations from the joint values, rad."""
        return self._x[: self._n].copy()

    @property
    def stiffness_factors(self) -> Array:
        """(n,) ratio of estimated to nominal bending and torsional stiffness of each tube."""
        return np.exp(self._x[self._n : 2 * self._n])

    @property
    def tip_offset(self) -> Array:
        """(3,) estimated offset of the measured tip from the tip of the corrected model, m."""
        return self._x[2 * self._n :].copy()

    @property
    def deviations(self) -> Array:
        """(2n + 3,) standard deviations of all of these; of the stiffnesses as a share."""
        return np.asarray(np.sqrt(np.diag(self._cov)))

    @property
    def robot(self) -> Robot:
        """The corrected robot."""
        return self._robot(self._x)

    def sent(self, time: float, rotations: ArrayLike, translations: ArrayLike) -> None:
        """Joint values (n,) that the robot has at a time, s; times increase."""
        turn, shift = vector("rotations", rotations, self._n), vector("translations", translations, self._n)
        if self._past and not time > self._past[-1][0]:
            raise InputError(f"time is {time:g} s; it must be more than that of the last joint values")
        self._past.append((time, turn, shift))
        while time - self._past[0][0] > MEMORY and len(self._past) > 2:
            self._past.popleft()

    def measured(self, time: float, position: ArrayLike) -> Correction:
        """Take in the tip position (3,), m, that was measured at a time, s, however late it arrives."""
        measured = vector("position", position, 3, "x, y, z in m")
        joints = self._joints_at(time)
        if joints is None:
            return Correction(False, "no joint values of its time are known", np.nan, np.nan)
        grown = self._cov
        if np.isfinite(self._time) and time > self._time:
            grown = grown + np.diag((DRIFT * self._prior) ** 2 * (time - self._time))
        try:
            return self._update(time, measured, joints, grown)
        except SolveError as error:
            return Correction(False, f"the model has no equilibrium there: {error}", np.nan, np.nan)

    def predict(self, rotations: ArrayLike, translations: ArrayLike) -> tuple[Equilibrium, Array]:
        """The equilibrium of the corrected robot at joint values (n,), and the tip (3,), m, that would be measured."""
        turn, shift = vector("rotations", rotations, self._n), vector("translations", translations, self._n)
        arm = self._arm_at(self._x, turn, shift)
        return arm, arm.tip_position + self.tip_offset

    def shift(self, nominal: Equilibrium) -> Array:
        """(3,) offset from the nominal tip to the predicted measurement, m.

        To reach p, a servo on the nominal robot aims at p minus this.
        """
        return np.asarray(self.predict(nominal.rotations, nominal.translations)[1] - nominal.tip_position)

    def _joints_at(self, time: float) -> tuple[Array, Array] | None:
        times = [past[0] for past in self._past]
        k = bisect_right(times, time)
        if not times or k == 0 or (k == len(times) and time > times[-1]):
            return None
        if k == len(times):
            return self._past[-1][1:]
        (a, *first), (b, *last) = self._past[k - 1], self._past[k]
        x = (time - a) / (b - a)
        turn, shift = ((1 - x) * one + x * two for one, two in zip(first, last, strict=True))
        return turn, shift

    def _update(self, time: float, measured: Array, joints: tuple[Array, Array], grown: Array) -> Correction:
        x, noise = self._x, self.options.noise**2 * np.eye(3)
        for k in range(LINEARISATIONS):
            arm = self._arm_at(x, *joints)
            slope = self._slope(arm)
            gap = measured - arm.tip_position - x[2 * self._n :]
            # What the tip would be at the old estimate, by the new derivatives.
            expected = gap + slope @ (x - self._x)
            spread = slope @ grown @ slope.T + noise
            gain = np.asarray(np.linalg.solve(spread, slope @ grown).T, dtype=float)
            if k == 0:
                before = gap
                if float(gap @ np.linalg.solve(spread, gap)) > 3 * GATE**2:
                    return Correction(False, "it is farther off than could be", *[float(np.linalg.norm(gap))] * 2)
            x = self._x + gain @ expected
        self._arm = self._arm_at(x, *joints)
        after = measured - self._arm.tip_position - x[2 * self._n :]
        kept = np.eye(len(x)) - gain @ slope
        self._x, self._cov = np.asarray(x), np.asarray(kept @ grown @ kept.T + gain @ noise @ gain.T)
        self._time = max(time, self._time)
        return Correction(True, "", float(np.linalg.norm(before)), float(np.linalg.norm(after)))

    @without_unit_warnings()
    def _robot(self, x: Array) -> ConcentricRobot:
        """The robot with the stiffnesses of parameters (2n + 3,)."""
        factors = np.exp(x[self._n : 2 * self._n]).tolist()
        tubes = tuple(
            replace(
                tube,
                bending_stiffness=float(tube.bending_stiffness) * factor,
                torsional_stiffness=float(tube.torsional_stiffness) * factor,
                pieces=tuple(piece.stiffened(factor) for piece in tube.pieces),
            )
            for tube, factor in zip(self._given.tubes, factors, strict=True)
        )
        return replace(self._given, tubes=tubes)

    def _arm_at(self, x: Array, rotations: Array, translations: Array) -> Equilibrium:
        """The equilibrium of the robot of parameters, on the branch of the last one."""
        robot, turn, shift = self._robot(x), rotations + x[: self._n], tuple(translations.tolist())
        near = one_step(robot, self._arm, turn, shift)
        return forward_kinematics(robot, turn, shift, start=replace(self._arm, robot=robot)) if near is None else near

    def _slope(self, arm: Equilibrium) -> Array:
        """(3, 2n + 3) derivatives of the measured tip by the parameters."""
        turn, bending, torsional = np.split(jacobian(arm, wrt=BY).position, 3, axis=1)
        kb, kt = (np.array([float(getattr(tube, name)) for tube in arm.robot.tubes]) for name in BY[1:])
        stiffness = bending * kb + torsional * kt
        return np.hstack([turn, stiffness, np.eye(3)])

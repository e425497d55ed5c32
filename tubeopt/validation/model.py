"""Residuals of measured tips as a function of a robot's parameters, with the registration eliminated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..equilibrium.jacobian import derivatives_of
from ..equilibrium.result import Equilibrium
from ..errors import InputError, SolveError
from ..robots.breakpoints import dimensions_of
from ..robots.robot import Robot
from ..typing import Array
from .comparison import Progress, predict
from .measurements import Measurements
from .parameters import CommonRobot, Parameter, apply
from .registration import BasePose, Registration, register

STEP = 1e-4
"""Step, in units of a parameter's scale, of the parabolas that tell how the dimensions of the tubes change."""

NUDGE = 1e-6
"""Motion of the tips, m, in which the registration is told to follow."""


class TipModel:
    """Tips and residuals at parameters x; every solve starts from the shapes of the one before.

    Args:
        robot, measurements: as given.   parameters: that x holds; `vary` leaves some of them at their start.
        registration, base: method, as for `register`.   progress: called after each solved shape.
    """

    def __init__(
        self,
        robot: Robot,
        measurements: Measurements,
        parameters: Sequence[Parameter],
        registration: str,
        base: BasePose,
        progress: Progress | None = None,
    ) -> None:
        self.robot, self.measurements, self.parameters = robot, measurements, tuple(parameters)
        self.method, self.base, self.progress = registration, base, progress
        self.free = list(range(len(self.parameters)))
        self._shapes: list[Equilibrium] | None = None
        self._at: Array | None = None
        self._tips = np.empty((0, 3))
        self.registration = Registration("none", np.eye(3), np.zeros(3))

    @property
    def varied(self) -> tuple[Parameter, ...]:
        """The parameters that x holds."""
        return tuple(self.parameters[k] for k in self.free)

    def vary(self, free: Sequence[int]) -> None:
        """Let x hold only the parameters with these indices."""
        self.free, self._at = list(free), None

    def rows(self, index: NDArray[np.intp]) -> TipModel:
        """The same model of some of the measurements, started from the shapes of this one."""
        part = TipModel(
            self.robot, self.measurements.rows(index), self.parameters, self.method, self.base, self.progress
        )
        part.vary(self.free)
        part._shapes = None if self._shapes is None else [self._shapes[k] for k in index]
        return part

    def tips(self, x: Array) -> Array:
        """(N, 3) predicted tips, m; the shapes are kept as guesses for the next."""
        if self._at is None or not np.array_equal(x, self._at):
            self._shapes = self._solve(x)
            self._tips = np.array([shape.tip_position for shape in self._shapes])
            self._at = np.array(x)
        return self._tips

    def residuals(self, x: Array) -> Array:
        """(3N,) registered measured minus predicted tips, m; infinite where there is no such robot or no such shape.

        They have the directions of the device's frame: in the plate's they would turn along with the registration, and
        a change of x that only turns the robot would seem to have an effect.
        The registration is kept in `registration`. At the first x an impossible robot or shape is an error.
        """
        first = self._shapes is None
        try:
            tips = self.tips(x)
        except (InputError, SolveError):
            if first:
                raise
            return np.full(3 * len(self.measurements), np.inf)
        self.registration = self._register(tips)
        return self._difference(self.registration, tips)

    def jacobian(self, x: Array) -> Array:
        """(3N, P) derivatives of `residuals`, the registration, which is a closed form of the tips, following along."""
        tips, columns = self.tips(x), []
        for slope in np.moveaxis(self._tip_slopes(x), 2, 0):
            moved = slope * (NUDGE / max(float(np.abs(slope).max()), 1e-300))
            ends = [self._difference(self._register(tips + side * moved), tips + side * moved) for side in (1, -1)]
            columns.append((ends[0] - ends[1]) * (float(np.abs(slope).max()) / (2 * NUDGE)))
        return np.array(columns).T

    def _tip_slopes(self, x: Array) -> Array:
        """(N, 3, P) derivatives of the tips at x, by the implicit function theorem."""
        assert self._shapes is not None
        by_table, table = self._table_slopes(x), []
        names = [name for name, part in by_table.items() if part.any()]
        if not names:
            return np.zeros((len(self._shapes), 3, len(self.free)))
        change = np.concatenate([by_table[name] for name in names])
        for shape in self._shapes:
            table.append(derivatives_of(shape, names).tip_position @ change)
        return np.array(table)

    def _table_slopes(self, x: Array) -> dict[str, Array]:
        """(n, P) change of the rotations and of every dimension of the tubes with x: parabolas inward."""
        here, columns = self._table(x), []
        for k, parameter in enumerate(self.varied):
            step = np.zeros(len(x))
            step[k] = STEP * parameter.scale * (-1.0 if x[k] > (parameter.low + parameter.high) / 2 else 1.0)
            one, two = self._table(x + step), self._table(x + 2 * step)
            columns.append({name: (4 * one[name] - two[name] - 3 * v) / (2 * step[k]) for name, v in here.items()})
        return {name: np.column_stack([column[name] for column in columns]) for name in here}

    def _table(self, x: Array) -> dict[str, Array]:
        """Offsets of the rotations and dimensions of the tubes at x, (n,) each."""
        robot, offsets = self._robot(x)
        return {"rotations": offsets, **dimensions_of(robot.tubes)}

    def _register(self, tips: Array) -> Registration:
        return register(self.measurements.tip_position, tips, self.method, base=self.base)

    def _difference(self, registration: Registration, tips: Array) -> Array:
        registered = registration.apply(self.measurements.tip_position)
        return np.asarray(((registered - tips) @ registration.rotation).ravel())

    def _solve(self, x: Array) -> list[Equilibrium]:
        robot, offsets = self._robot(x)
        turned = self.measurements.turned(offsets)
        return predict(robot, turned, guesses=self._shapes, progress=self.progress)

    def _robot(self, x: Array) -> tuple[CommonRobot, Array]:
        """The robot at x, and the offsets (n,) of its rotations."""
        values = np.array([parameter.start for parameter in self.parameters])
        values[self.free] = x
        return apply(self.robot, self.parameters, values)

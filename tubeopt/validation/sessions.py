"""Model of the recordings of one robot: tubes, friction and drives in common, the rest shared or of each recording.

A single recording is a list of one. The derivatives have the shape of an arrow: a parameter of one recording moves the
rows of that recording only, so that it costs no solve in the others.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..robots.robot import Robot
from ..solvers.robust_least_squares import RobustDescent
from ..typing import Array, Index, Mask
from .measurements import Measurements, deal, passes
from .model import ArmModel, ParameterState
from .parameters import Parameter
from .registration import SENSOR_FRAME, BasePose, Registration


@dataclass(frozen=True)
class Registrations:
    """Pose of the measuring device in every recording, or one pose for all."""

    parts: tuple[Registration, ...]

    def moved(self, step: Array) -> Registrations:
        """Registrations after a small step in the freedoms of each."""
        return Registrations(
            tuple(
                part.moved(part_step)
                for part, part_step in zip(self.parts, np.split(step, len(self.parts)), strict=True)
            )
        )


class Sessions:
    """Observations of all recordings, one recording after the other.

    Args:
        robot, recordings: as given.   shared: True for one registration of all recordings.
        method, base: of the registration, as for `register`.

    Attributes:
        parameters: that x holds, common ones and those of recordings; none until `with_parameters`.
        models: one model per recording, with its own parameters.   columns: places of these in x.
        row (V,): row of each observation, counted through all recordings.   station, directed, failures: as in a model.

    Raises:
        InputError: a row at which the robot cannot be.
        SolveError: a recording has no row with a stable equilibrium.
    """

    def __init__(
        self,
        robot: Robot,
        recordings: Sequence[Measurements],
        method: str = "rigid",
        base: BasePose = SENSOR_FRAME,
        *,
        shared: bool = False,
    ) -> None:
        self.robot, self.method, self.shared = robot, method, shared
        middle = np.median(np.vstack([m.rotations for m in recordings]), axis=0)
        self.models = tuple(ArmModel(robot, m, (), method, base, middle) for m in recordings)
        self.first = self.models[0].first
        self.length = max(model.length for model in self.models)
        begins = np.cumsum([0, *(len(m) for m in recordings)]).tolist()
        self.begins, self.count = begins[:-1], begins[-1]
        self.failures = tuple((b + k, why) for b, m in zip(begins, self.models, strict=False) for k, why in m.failures)
        self.row = np.concatenate([b + m.row for b, m in zip(begins, self.models, strict=False)])
        self.recording = np.repeat(np.arange(len(self.models)), [len(m.row) for m in self.models])
        # The stations of all recordings, and the number of each observation's among them; -1 for a direction.
        self.stations = np.unique(np.concatenate([m.stations for m in self.models]))
        station = [np.append(np.searchsorted(self.stations, m.stations), -1)[m.station] for m in self.models]
        self.station = np.concatenate(station)
        self.directed: Mask = self.station < 0
        starts = Registrations(tuple(m.start.registration for m in self.models)[: 1 if shared else None])
        self.parameters: tuple[Parameter, ...] = ()
        self.columns: list[Index] = [np.zeros(0, dtype=int)] * len(self.models)
        self.start = (
            self.registered(ParameterState(np.zeros(0), starts), (None, None))
            if shared
            else ParameterState(np.zeros(0), starts)
        )

    def with_parameters(self, parameters: Sequence[Parameter]) -> Sessions:
        """Model of the same observations with other parameters in x; solved equilibria are reused."""
        copied = copy(self)
        copied.parameters = tuple(parameters)
        copied.columns = [
            np.array([j for j, p in enumerate(parameters) if p.recording in (None, k)], dtype=int)
            for k in range(len(self.models))
        ]
        each = zip(self.models, copied.columns, strict=True)
        copied.models = tuple(m.with_parameters([copied.parameters[j] for j in columns]) for m, columns in each)
        copied.start = ParameterState(np.array([p.start for p in parameters]), self.start.registration)
        return copied

    def slopes_with(self, fit: RobustDescent[ParameterState[Registrations]], more: Sequence[Parameter]) -> Array:
        """Derivatives (V, 3, P + Q + F) of a fit by its parameters, Q further ones at their start, and registration."""
        count, every = len(self.parameters), [*self.parameters, *more]
        state = ParameterState(np.append(fit.state.x, [p.start for p in more]), fit.state.registration)
        slopes = self.with_parameters(every).jacobian(state, skip=count)
        slopes[..., :count], slopes[..., len(every) :] = fit.jacobian[..., :count], fit.jacobian[..., count:]
        return slopes

    @property
    def recordings(self) -> tuple[Measurements, ...]:
        """The recordings."""
        return tuple(model.measurements for model in self.models)

    @property
    def freedoms(self) -> int:
        """Number of freedoms of all registrations."""
        return self.models[0].freedoms * len(self.start.registration.parts)

    @property
    def evaluations(self) -> int:
        """Number of solved shapes."""
        return sum(model.evaluations for model in self.models)

    @property
    def bounds(self) -> Array:
        """(2, P) least and greatest value of every parameter."""
        return np.array([[p.low, p.high] for p in self.parameters]).reshape(-1, 2).T

    def part(self, state: ParameterState[Registrations], k: int) -> ParameterState[Registration]:
        """The state of recording k."""
        return ParameterState(state.x[self.columns[k]], state.registration.parts[0 if self.shared else k])

    def parts(self, state: ParameterState[Registrations]) -> list[ParameterState[Registration]]:
        """The states of all recordings."""
        return [self.part(state, k) for k in range(len(self.models))]

    def costly(self, state: ParameterState[Registrations]) -> bool:
        """True if derivatives need a pass along all rows for every parameter."""
        return any(m.costly(part) for m, part in zip(self.models, self.parts(state), strict=True))

    def residuals(self, state: ParameterState[Registrations]) -> Array:
        """(V, 3) measured minus predicted, in the device's frame: m, and unit vectors; raises as `ArmModel`."""
        return np.vstack([m.residuals(part) for m, part in zip(self.models, self.parts(state), strict=True)])

    def jacobian(self, state: ParameterState[Registrations], skip: int = 0) -> Array:
        """(V, 3, P + F) derivatives of `residuals`; those by the first `skip` parameters are left at 0."""
        count = len(self.parameters)
        out = np.zeros((len(self.row), 3, count + self.freedoms))
        for k, (model, columns) in enumerate(zip(self.models, self.columns, strict=True)):
            slopes = model.jacobian(self.part(state, k), skip=int(np.searchsorted(columns, skip)))
            first = count + (0 if self.shared else k) * model.freedoms
            at = np.append(columns, np.arange(first, first + model.freedoms))
            out[np.ix_(np.flatnonzero(self.recording == k), np.arange(3), at)] = slopes
        return out

    def registered(
        self, state: ParameterState[Registrations], noise: tuple[float | None, float | None]
    ) -> ParameterState[Registrations]:
        """The state with the registrations that fit its shapes best; `noise` as for `MeasuredDirections`."""
        parts = self.parts(state)
        if not self.shared or len(self.models) == 1:
            each = (m.registered(part, noise) for m, part in zip(self.models, parts, strict=True))
            return ParameterState(state.x, Registrations(tuple(part.registration for part in each)))
        if not self.models[0].freedoms:
            return state
        predicted = np.vstack([m.in_plate(part.x) for m, part in zip(self.models, parts, strict=True)])
        observed = np.vstack([m.observed for m in self.models])
        return ParameterState(
            state.x, Registrations((self.models[0].register(observed, predicted, self.directed, noise),))
        )

    @cached_property
    def places(self) -> list[Index]:
        """Number of the configuration of each row, by recording, as `deal` reads it."""
        return [passes(m).group for m in self.recordings]

    def fold(self, folds: int) -> Index:
        """(N,) fold of each row: fold k is block k of every recording."""
        return np.concatenate([deal(m, folds, p) for m, p in zip(self.recordings, self.places, strict=True)])

    def blocks(self, most: int) -> Index:
        """(N,) block of each row, at most `most` blocks per recording; no block has rows of two recordings."""
        counts = [min(most, len(np.unique(group))) for group in self.places]
        each = zip(self.recordings, counts, self.places, strict=True)
        return np.concatenate([most * k + deal(m, count, group) for k, (m, count, group) in enumerate(each)])

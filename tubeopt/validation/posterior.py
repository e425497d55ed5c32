"""Covariance of the parameters of a fitted robot that counts what the model lacks.

Three causes are added to the noise of the sensor.

- Effects that were not fitted, such as the shape of the heated part, are considered with the standard deviation of
  their drawing (consider covariance: Schmidt, Advances in Control Systems 3 (1966)). The data narrow it as far as they
  can. What other effects have absorbed widens the intervals of these.
- What no effect explains leaves errors that are alike at similar joint values and at similar times. They are a random
  function (Kennedy and O'Hagan, J. R. Stat. Soc. B 63 (2001)) with two parts of Matern correlation beside white noise,
  of sizes and ranges with the greatest restricted likelihood (Patterson and Thompson, Biometrika 58 (1971)). So the
  rows of a path count for as many as are independent.
- The fitted robot keeps the drawn values of effects that were not fitted. Where the data say that these are others, the
  square of that shift is added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..robots.calibration import Posterior
from ..solvers.robust_least_squares import RobustDescent, Weights, inverse_of, solved, weighted_sums
from ..typing import Array, Index, Mask
from .effects import EFFECTS, MOUNTS
from .model import ParameterState
from .parameters import Parameter, choose_parameters, groups
from .registration import FREEDOMS
from .sessions import Registrations, Sessions

# --- Errors of rows that are alike ------------------------------------------------------------------------------------

# Observations from which sizes and ranges are estimated, in stretches of consecutive ones. The likelihood takes the
# cube of this number; of 300 independent rows it knows a standard deviation to 3 %.
MOST, STRETCH = 300, 15

# Evaluations of the likelihood, which is flat at its maximum.
EVALUATIONS = 80

# Logarithms of sizes relative to the noise, and of ranges relative to their middle, between which they are searched.
SIZES, RANGES = (-7.0, 7.0), (-4.0, 2.0)

# Observations of which the covariance of errors is formed at once.
CHUNK = 1000


@dataclass(frozen=True, eq=False)
class Places:
    """Joint values with the place on the arm (V, k), rad, times (V,), s, and recordings (V,) of observations."""

    joints: Array
    """Translations and places count 20 rad per m, by which an arm bends."""
    time: Array
    recording: Index
    timed: bool
    """False if the times mean nothing."""

    @classmethod
    def of(cls, model: Sessions) -> Places:
        """Places of all observations."""
        recordings = model.recordings
        joints = np.vstack([np.hstack([m.rotations, 20.0 * m.translations]) for m in recordings])[model.row]
        behind = np.append(20.0 * model.stations, 0.0)[model.station]
        time = np.concatenate([np.zeros(len(m)) if m.time is None else m.time for m in recordings])[model.row]
        timed = all(m.time is not None for m in recordings)
        return cls(np.column_stack([joints, behind]), time, model.recording, timed)

    def __getitem__(self, chosen: Index | slice) -> Places:
        return Places(self.joints[chosen], self.time[chosen], self.recording[chosen], self.timed)


@dataclass(frozen=True)
class Misfit:
    """Errors of positions (m), or of directions: white noise, and parts that depend on joint values and on time."""

    noise: float
    """Standard deviation of the white part of a coordinate."""
    smooth: float
    """Standard deviation of the part that depends on joint values."""
    smooth_range: float
    """Range of its correlation, rad."""
    drift: float
    """Standard deviation of the part that depends on time."""
    drift_range: float
    """Range of its correlation, s."""

    @property
    def size(self) -> float:
        """Standard deviation of both correlated parts together."""
        return float(np.hypot(self.smooth, self.drift))

    def covariance(self, a: Places, b: Places) -> Array:
        """Covariance of one coordinate between two sets of observations, without the white part."""
        out = self.smooth**2 * matern(scipy.spatial.distance.cdist(a.joints, b.joints) / self.smooth_range)
        if a.timed:
            apart = np.abs(a.time[:, None] - b.time) / self.drift_range
            out += self.drift**2 * matern(apart) * (a.recording[:, None] == b.recording)
        return np.asarray(out)

    def spread(self, places: Places, gains: Array) -> Array:
        """(Q, Q) covariance of estimates that are `gains` (Q, V, 3) times these errors."""
        out = self.noise**2 * np.einsum("qva,rva->qr", gains, gains)
        for first in range(0, len(places.time), CHUNK):
            part = slice(first, first + CHUNK)
            shared = np.tensordot(gains, self.covariance(places, places[part]), axes=(1, 0))
            out += np.einsum("qav,rva->qr", shared, gains[:, part])
        return np.asarray(out)


def matern(distance: Array) -> Array:
    """Matern correlation of smoothness 3/2 at distances in units of the range."""
    scaled = np.sqrt(3) * distance
    return np.asarray((1 + scaled) * np.exp(-scaled))


def estimate_misfit(places: Places, residuals: Array, jacobian: Array) -> Misfit:
    """Misfit of greatest restricted likelihood, from residuals (V, 3) and their derivatives (V, 3, Q) by all unknowns.

    The likelihood is that of what no unknown can absorb.
    """
    every = max(1, -(-len(residuals) // MOST))
    stretches = np.array_split(np.arange(len(residuals)), max(1, len(residuals) // STRETCH))
    chosen = np.concatenate(stretches[::every]) if places.timed else np.arange(0, len(residuals), every)
    at, n, q = places[chosen], len(chosen), jacobian.shape[2]
    columns = jacobian[chosen].reshape(3 * n, q)
    left, singular, _ = np.linalg.svd(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300), False)
    absorbed = left[:, singular > 1e-9 * singular[0]]
    data = np.concatenate([residuals[chosen][..., None], absorbed.reshape(n, 3, -1)], axis=2).reshape(n, -1)
    degrees = max(3 * n - absorbed.shape[1], 1)
    # Half the spread of the joint values, and a fiftieth of a recording.
    spread = np.sqrt(((at.joints - at.joints.mean(0)) ** 2).sum(1).mean())
    duration = max(np.ptp(at.time[at.recording == k]) for k in np.unique(at.recording))
    middle = np.log([max(0.5 * spread, 1e-6), max(0.02 * duration, 1e-6)])
    low, high = np.repeat([SIZES, RANGES], 2, axis=0).T

    def likely(z: Array) -> tuple[float, Misfit]:
        """Minus twice the logarithm of the likelihood, and the misfit."""
        sizes, ranges = np.exp(z[:2]), np.exp(middle + z[2:])
        unit = Misfit(1.0, float(sizes[0]), float(ranges[0]), float(sizes[1]) * at.timed, float(ranges[1]))
        factor = np.linalg.cholesky(unit.covariance(at, at) + np.eye(n))
        white = scipy.linalg.solve_triangular(factor, data, lower=True).reshape(n, 3, -1)
        basis, upper = np.linalg.qr(white[..., 1:].reshape(3 * n, -1))
        seen = white[..., 0].ravel()
        rest = max(float(seen @ seen - ((basis.T @ seen) ** 2).sum()), 1e-300)
        sigma = np.sqrt(rest / degrees)
        value = degrees * np.log(rest) + 6 * np.log(np.diag(factor)).sum() + 2 * np.log(np.abs(np.diag(upper))).sum()
        return float(value), Misfit(sigma, sigma * unit.smooth, unit.smooth_range, sigma * unit.drift, unit.drift_range)

    def cost(z: Array) -> float:
        inside = np.clip(z, low, high)
        # Where the data say little about a range it stays near its middle.
        return likely(inside)[0] + float((inside[2:] ** 2).sum()) + 100 * float(((z - inside) ** 2).sum())

    start = np.array([0.0, -1.0, 0.0, 0.0])
    simplex = np.vstack([start, start - np.diag([2.0, 2.0, 1.0, 1.0])])
    options = {"maxfev": EVALUATIONS, "initial_simplex": simplex}
    found = scipy.optimize.minimize(cost, start, method="Nelder-Mead", options=options).x
    return likely(np.clip(found, low, high))[1]


# --- Effects that were not fitted -------------------------------------------------------------------------------------


def considered(model: Sessions, chosen: Sequence[Parameter], per_recording: Sequence[str]) -> list[Parameter]:
    """Parameters of tubes and drives that were not chosen and that these data could determine.

    Effects of history are left out: they show in the correlations of the residuals. Plate and sensor are where they are
    said to be.
    """
    taken = {(name, place) for p in chosen for name in (p.kind, *p.effect.sets) for place in p.which}
    # A turn of the plate's frame is a rotation of all tubes: that of one tube is none of the robot's.
    rotations = [k for k in range(model.robot.n_tubes) if ("rotation", k) not in taken]
    if FREEDOMS[model.method] and rotations:
        taken.add(("rotation", rotations[0]))
    known = groups(model.robot, model.recordings, model.method, ("dead_length",))
    static = {kind: names for kind, names in known.items() if not EFFECTS[kind].history and kind not in MOUNTS}
    names = [name for group in static.values() for name in group]
    every = choose_parameters(model.robot, model.recordings, names, model.method, per_recording)
    return [
        p
        for p in every
        if not p.idle and not {(name, place) for name in (p.kind, *p.effect.sets) for place in p.which} & taken
    ]


PLATE = ("plate_tilt_x", "plate_tilt_y", "plate_yaw", "plate_shift_x", "plate_shift_y", "plate_shift_z")
"""Turns (rad) and shifts (m) of the plate against its registration, about and along its axes."""


@dataclass(frozen=True, eq=False)
class PosteriorFit:
    """Posterior of a fitted robot with standard deviations."""

    posterior: Posterior
    """The posterior that its file keeps."""
    errors: Array
    """(P,) standard deviations of the fitted parameters."""
    bands: Array
    """(V, 3) standard deviations of held-out positions, with misfit and noise, m."""


# Kinds with factors on the fitted tubes, which are 1 in the file of the fitted robot.
FACTORS = ("torsional_stiffness", "bending_stiffness")


def posterior_of(
    model: Sessions,
    fit: RobustDescent[ParameterState[Registrations]],
    weights: Weights,
    chosen: Sequence[Parameter],
    per_recording: Sequence[str],
    noise: float | None,
    fold: Index,
    *,
    at_minimum: bool = True,
) -> PosteriorFit:
    """Posterior of the robot of the last recording, with its standard deviations.

    Args:
        model, fit, weights: with the fitted parameters.   chosen: those that were asked for, fitted or fixed.
        noise: standard deviation of a measured coordinate, m; None for the white part of the residuals.
        fold: (N,) fold of each row, for the bands; empty without folds.
        at_minimum: False for a mean over fits. Its distance from the minimum of all parameters then counts as
            uncertainty.
    """
    count, more = len(model.parameters), considered(model, chosen, per_recording)
    every = [*model.parameters, *more]
    slopes = model.slopes_with(fit, more)
    w = weights.of(fit.residuals)
    prior, pull = np.zeros(slopes.shape[2]), np.zeros(slopes.shape[2])
    prior[: len(every)] = [*weights.prior**-2.0, *(p.prior**-2.0 for p in more)]
    pull[:count] = prior[:count] * (fit.state.x - model.start.x)
    fitted = np.r_[:count, len(every) : len(prior)]
    places, trusted = Places.of(model), np.sqrt(w * weights.sigma**2)[:, None]  # below 1 where a loss doubts a row
    kinds = [kind for kind in (np.flatnonzero(model.directed), np.flatnonzero(~model.directed)) if len(kind)]
    misfits = [estimate_misfit(places[kind], (trusted * fit.residuals)[kind], slopes[kind]) for kind in kinds]

    def covariance_of(used: Mask) -> Array:
        """Second moments of all unknowns about the state, or a fit to the observations `used` (V,)."""
        square, gradient = weighted_sums(slopes[used], fit.residuals[used], w[used])
        square, gradient = square + np.diag(prior), gradient + pull
        if at_minimum:  # a fit to fewer rows moves what was fitted
            gradient = gradient - square[:, fitted] @ solved(square[np.ix_(fitted, fitted)], gradient[fitted])
        inverse = inverse_of(square)
        gains, shift = np.einsum("qr,var,v->qva", inverse, slopes, w * used), -inverse @ gradient
        spread = [each.spread(places[kind], gains[:, kind]) for each, kind in zip(misfits, kinds, strict=True)]
        return np.asarray((inverse * prior) @ inverse + np.outer(shift, shift) + sum(spread))

    covariance, tips = covariance_of(np.ones(len(w), dtype=bool)), misfits[-1]
    sizes = np.sqrt(np.diag(covariance))
    white = tips.noise if noise is None else noise
    misfit = np.sqrt(tips.size**2 + max(tips.noise**2 - white**2, 0.0))
    last = len(model.models) - 1
    own = [k for k, p in enumerate(every) if p.recording in (None, last) and sizes[k] > 0]
    x = [*fit.state.x.tolist(), *(p.start for p in more)]
    named = [(*_in_fitted(every[k], x[k]), k) for k in own]
    motion = fit.state.registration.parts[-1]
    first = len(every) + (0 if model.shared else last) * model.models[0].freedoms
    # Turns and shifts of the plate, which the tips follow in its frame.
    rates = [motion.rates(k) for k in range(model.models[0].freedoms)]
    plate = [np.concatenate([motion.rotation @ turn, motion.rotation @ along]) for turn, along in rates]
    rows = np.zeros((len(named) + 6, len(covariance)))
    for row, (_, _, factor, k) in enumerate(named):
        rows[row, k] = factor
    rows[len(named) :, first : first + len(plate)] = np.array(plate).reshape(-1, 6).T
    kept = rows @ covariance @ rows.T
    certain = np.diag(kept) > 0
    taken = {name for name, *_ in named}
    names = [*(name for name, *_ in named), *PLATE]
    units = [*(unit for _, unit, *_ in named), *["rad"] * 3, *["m"] * 3]
    chosen_rows = [k for k in np.flatnonzero(certain) if k < len(named) or names[k] not in taken]
    posterior = Posterior.of(
        [names[k] for k in chosen_rows],
        [units[k] for k in chosen_rows],
        kept[np.ix_(chosen_rows, chosen_rows)],
        float(misfit),
        float(white),
    )
    rotations, translations = (
        [(float(low), float(high)) for low, high in zip(table.min(0), table.max(0), strict=True)]
        for table in (np.vstack([getattr(m, name) for m in model.recordings]) for name in ("rotations", "translations"))
    )
    posterior = replace(posterior, rotations=tuple(rotations), translations=tuple(translations))
    bands = np.empty(fit.residuals.shape)
    for k in np.unique(fold):  # none without folds
        rows_of_fold = fold[model.row] == k
        part = slopes[rows_of_fold]
        predicted = np.einsum("var,rs,vas->va", part, covariance_of(~rows_of_fold), part)
        bands[rows_of_fold] = np.sqrt(predicted + misfit**2 + white**2)
    return PosteriorFit(posterior, sizes[:count], bands)


def _in_fitted(p: Parameter, value: float) -> tuple[str, str, float]:
    """Name, unit and factor of the deviation of a parameter, counted from the fitted robot in its place."""
    name = p.name.partition("@")[0]
    if p.kind == "nu":  # GJ = EI / (1 + nu)
        return name.replace("nu", "torsional_stiffness"), "", -1 / (1 + value)
    if p.kind in FACTORS or (p.kind == "curvature" and p.index is None):
        return name, "", 1 / value
    return name, p.unit, 1.0

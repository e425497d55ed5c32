"""Distances between measured and predicted tips, summed up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..typing import Array


@dataclass(frozen=True)
class ErrorSummary:
    """Mean, root mean square, 95th percentile (interpolated) and greatest of `count` distances, m."""

    count: int
    mean: float
    rms: float
    p95: float
    max: float

    @classmethod
    def of(cls, errors: Array) -> ErrorSummary:
        """The summary of errors (N,), m; NaN are left out, and there must be others."""
        errors = errors[np.isfinite(errors)]
        return cls(
            count=len(errors),
            mean=float(errors.mean()),
            rms=float(np.sqrt((errors**2).mean())),
            p95=float(np.percentile(errors, 95)),
            max=float(errors.max()),
        )


@dataclass(frozen=True)
class ErrorGroup:
    """The errors of all configurations with one direction, or one separation (`value`, rad)."""

    value: float
    summary: ErrorSummary


def group_errors(values: Array | None, errors: Array) -> tuple[ErrorGroup, ...]:
    """Errors (N,), m, by values (N,), rad, in ascending order; nothing where there are no values."""
    if values is None:
        return ()
    labels = np.round(values / 1e-6).astype(int)
    groups = []
    for label in np.unique(labels):
        inside = labels == label
        if np.isfinite(errors[inside]).any():
            groups.append(ErrorGroup(float(values[inside].mean()), ErrorSummary.of(errors[inside])))
    return tuple(groups)


@dataclass(frozen=True, eq=False)
class ErrorTable:
    """A published table of tip errors over direction and separation, with the means that were printed beside it.

    direction (D,), separation (S,): rad.  error (S, D): m.  mean_by_direction (D,), mean_by_separation (S,), mean: m.
    """

    direction: Array
    separation: Array
    error: Array
    mean_by_direction: Array
    mean_by_separation: Array
    mean: float

    @property
    def summary(self) -> ErrorSummary:
        """Of all errors in the table."""
        return ErrorSummary.of(self.error.ravel())

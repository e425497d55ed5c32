"""What a laboratory measures: joint values, and where sensors saw the tip."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ..errors import InputError
from ..typing import Array


@dataclass(frozen=True, eq=False)
class Measurements:
    """N configurations with the tip positions that S sensors measured.

    The tip is the mean over the sensors. For an eccentric robot that is the sheath's centreline where one sensor sits
    in each of its three tubes; a single sensor there is off by the tube's distance from the centreline.

    Args:
        rotations, translations: (N, n) joint values, rad and m; translations from home.
        sensors: (N, S, 3) positions in the frame of the measuring device, m; (N, 3) is one sensor.
        direction, separation: (N,) mirror actuation that the rotations come from, rad; None where there is none.
        source: where the data are from, for messages and pictures.

    Raises:
        InputError: arrays that do not fit each other, no configuration, or a number that is not finite.
    """

    rotations: Array
    translations: Array
    sensors: Array
    direction: Array | None = None
    separation: Array | None = None
    source: str = ""

    def __post_init__(self) -> None:
        rotations = _finite("rotations", self.rotations, 2)
        count, n = rotations.shape
        if not rotations.size:
            raise InputError("there are no measurements; at least one configuration is needed")
        translations = _finite("translations", self.translations, 2)
        if translations.shape != (count, n):
            raise InputError(f"translations have shape {translations.shape}; rotations have {rotations.shape}")
        sensors = np.array(self.sensors, dtype=float)
        sensors = _finite("sensors", sensors[:, None] if sensors.ndim == 2 else sensors, 3)
        if sensors.shape[0] != count or sensors.shape[1] < 1 or sensors.shape[2] != 3:
            raise InputError(f"sensors have shape {sensors.shape}; it must be ({count}, sensors, 3)")
        for name in ("direction", "separation"):
            if getattr(self, name) is not None:
                label = _finite(name, getattr(self, name), 1)
                if len(label) != count:
                    raise InputError(f"{name} has {len(label)} numbers; it must be {count}, one per configuration")
                object.__setattr__(self, name, label)
        for name, array in (("rotations", rotations), ("translations", translations), ("sensors", sensors)):
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.rotations)

    @property
    def n_tubes(self) -> int:
        """Number of tubes n."""
        return int(self.rotations.shape[1])

    @property
    def tip_position(self) -> Array:
        """(N, 3) mean over the sensors, m."""
        return np.asarray(self.sensors.mean(1))

    @property
    def sensor_spread(self) -> Array:
        """(N,) root mean square distance of the sensors from their mean, m; 0 for one sensor."""
        return np.asarray(np.sqrt(((self.sensors - self.tip_position[:, None]) ** 2).sum(2).mean(1)))

    def rows(self, index: ArrayLike) -> Measurements:
        """The configurations with these indices, or where this mask is true."""
        k = np.asarray(index)
        return replace(
            self,
            rotations=self.rotations[k],
            translations=self.translations[k],
            sensors=self.sensors[k],
            direction=None if self.direction is None else self.direction[k],
            separation=None if self.separation is None else self.separation[k],
        )

    def turned(self, offsets: Array) -> Measurements:
        """The same tips at rotations with `offsets` (n,), rad, added."""
        return replace(self, rotations=self.rotations + offsets)


def _finite(name: str, value: ArrayLike, dimensions: int) -> Array:
    """`value` as a float array with so many dimensions, else InputError naming the first bad place."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} are not an array of numbers") from None
    if array.ndim != dimensions:
        raise InputError(f"{name} have shape {array.shape}; they must have {dimensions} dimensions")
    if not np.isfinite(array).all():
        place = np.argwhere(~np.isfinite(array))[0].tolist()
        raise InputError(f"{name}{place} is {array[tuple(place)]}; every number must be finite")
    return array

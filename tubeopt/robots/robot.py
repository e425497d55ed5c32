"""Base class of all tube robots, and warnings of tubes that do not fit into each other."""

from __future__ import annotations

import reprlib
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from itertools import pairwise
from os import PathLike
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from ..display import Displayed
from ..errors import InputError, vector, without_unit_warnings
from ..files.units import TO_MM
from ..typing import Array, lazy_import
from .assembly import Assembly
from .calibration import Calibration, Posterior, check_calibration, limits_of
from .limits import FAR, MOST_TURN, JointLimits, check_reach, check_turn
from .materials import Material
from .order import home_translations
from .tubes import Tube, slots_unknown, warn_of_units

Kept = TypeVar("Kept")


class Robot(Displayed, ABC):
    """Tubes, their carriages, and the sections that they form.

    Robots are frozen dataclasses, so that results can be cached.
    """

    _asked_for = "a robot; tubeopt.load_robot reads one from a file"

    name: str
    """Name in tables and pictures."""
    tubes: tuple[Tube, ...]
    """Tubes, inner to outer, one per joint rotation."""
    joint_limits: JointLimits | None
    """Given joint limits; None for those that follow from the lengths."""
    calibration: Calibration | None
    """Conversion of drive readings to joint values; None if readings are joint values."""
    posterior: Posterior | None
    """Uncertainty of the parameters after a fit; None if unknown."""
    fixed_sections: bool = True
    """True if sections lie at arc lengths that the translations determine; False if they depend on the shape."""
    nested_curves: bool = True
    """True if the curved part of a tube may lie inside the tube around it."""

    @property
    def home_translations(self) -> Array:
        """Translations (n,) at home, m: 0 if limits and order allow it.

        Otherwise they are closest to 0, from the outermost tube inwards.
        """
        return self._home.copy()

    @property
    def home_rotations(self) -> Array:
        """Rotations (n,) at home, rad: 0, or the nearest values within the limits."""
        low, high = np.array(self.limits.rotations).T
        return np.clip(np.zeros(self.n_tubes), low, high)

    @property
    def home_readings(self) -> Array:
        """Readings (n,) of the carriages at home, m, if no carriage yields."""
        calibration = self.calibration
        return self.home_translations if calibration is None else calibration.to_readings(0.0, self._home)[1]

    @cached_property
    def _home(self) -> Array:
        return home_translations(self)

    @property
    @abstractmethod
    def moving_together(self) -> tuple[tuple[int, ...], ...]:
        """Tubes, from 0, that one carriage translates: a partition."""

    @property
    @abstractmethod
    def nested_pairs(self) -> tuple[tuple[int, int], ...]:
        """Tubes, from 0, that run inside another one: (inner, the next around it)."""

    @property
    def axes(self) -> Array:
        """Places (n, 2) of the tube axes in the cross-section of the arm, m: 0 on the centreline."""
        return np.zeros((self.n_tubes, 2))

    @abstractmethod
    def assembly(self, translations: Array) -> Assembly:
        """Sections at `translations` (n,), m; raises InputError if they are not admissible."""

    def admit(self, translations: Array) -> None:
        """Raise InputError if translations (n,), m, are not admissible."""
        self.assembly(translations)

    def check_drives(self, *, yields: bool = False) -> None:
        """Raise InputError if limits or calibration do not fit the number of tubes or the carriages."""
        for tube in self.tubes:
            warn_of_units(tube)
        limits = self.joint_limits
        if limits is not None and len(limits.rotations) != len(self.tubes):
            raise InputError(f"limits are given for {len(limits.rotations)} tubes; the robot has {len(self.tubes)}")
        for i, tube in enumerate(self.tubes if limits is not None else ()):
            assert limits is not None
            low, high = limits.translations[i]
            if low < -FAR * tube.length or high > FAR * tube.length:
                raise InputError(
                    f"limits of the translation of tube {i + 1} are {low:g} to {high:g} m, and the tube is "
                    f"{tube.length:g} m long; they must lie within {FAR:g} times that: translations are in m"
                )
            turn = max(map(abs, limits.rotations[i]))
            if turn > MOST_TURN:
                raise InputError(
                    f"limits of the rotation of tube {i + 1} reach {turn:g} rad; they must lie within "
                    f"{MOST_TURN:g} rad (159 turns)"
                )
        check_calibration(self.calibration, len(self.tubes), yields=yields)

    @cached_property
    def even(self) -> bool:
        """True if stiffnesses, and the curvature of the curved part, are constant along each tube."""
        return all(tube.even for tube in self.tubes)

    @property
    def n_tubes(self) -> int:
        """Number of tubes n, and of rotations and translations."""
        return len(self.tubes)

    @cached_property
    def limits(self) -> JointLimits:
        """Range of every joint value; by default a turn to either side, and the range that the tube lengths allow."""
        return limits_of(self.joint_limits, self.calibration, self.tubes)

    @property
    def buffer_warnings(self) -> list[str]:
        """Warnings of tubes between drive and plate; none for concentric robots."""
        return []

    def save(self, path: str | PathLike[str]) -> None:
        """Write the robot as YAML that `load_robot` reads back."""
        lazy_import("tubeopt.robots.file.save_robot")(self, path)

    def fk(self, rotations: ArrayLike, translations: ArrayLike | None = None, **options: Any) -> Any:
        """Equilibrium at rotations (n,) rad and translations (n,) m, by default home.

        A vector of 2n numbers contains both, rotations first. `options` are those of `tubeopt.forward_kinematics`.

        Examples:
            >>> import tubeopt
            >>> robot = tubeopt.load_robot("two_tube")
            >>> round(1e3 * float(robot.fk([0.5, 0.0]).tip_position[2]), 3)
            76.151
        """
        known: Any = rotations
        shape = (
            np.shape(known)
            if isinstance(known, np.ndarray)
            else (len(known),)
            if isinstance(known, list | tuple)
            else ()
        )
        if translations is None and shape == (2 * self.n_tubes,):
            rotations, translations = known[: self.n_tubes], known[self.n_tubes :]
        return lazy_import("tubeopt.equilibrium.kinematics.forward_kinematics")(
            self, rotations, translations, **options
        )

    def ik(self, position: ArrayLike, **options: Any) -> Any:
        """Joint values of a stable equilibrium with its tip at `position` (3,), m: a `tubeopt.InverseSolution`.

        `options` are those of `tubeopt.inverse_kinematics`, as `direction`.
        """
        return lazy_import("tubeopt.inverse.solving.inverse_kinematics")(self, position, **options)

    def jacobian(self, rotations: ArrayLike, translations: ArrayLike | None = None, **options: Any) -> Any:
        """Derivatives of tip pose, margin and energy with respect to the joint values: a `tubeopt.Jacobian`.

        Its `matrix` (6, 2n) is the geometric Jacobian of the tip, per rad and per m. Arguments as for `fk`.
        """
        return self.fk(rotations, translations, **options).jacobian()

    def tip_pose(self, rotations: ArrayLike, translations: ArrayLike | None = None, **options: Any) -> Array:
        """(4, 4) homogeneous transformation from the tip to the plate, m; arguments as for `fk`."""
        return np.asarray(self.fk(rotations, translations, **options).tip_pose)

    def plot(
        self,
        rotations: ArrayLike | None = None,
        translations: ArrayLike | None = None,
        path: str | PathLike[str] | None = None,
        **options: Any,
    ) -> Any:
        """Figure of the shape at joint values, by default home, saved at `path`; other arguments as for `fk`."""
        where = self.home_rotations if rotations is None else rotations
        return self.fk(where, translations, **options).plot(path)


def check_robot(robot: object) -> None:
    """Raise InputError for other objects, such as the path of a robot file."""
    if not hasattr(robot, "assembly"):
        raise InputError(
            f"robot is {reprlib.repr(robot)}; it must be a robot; tubeopt.load_robot reads one from a file"
        )


def shifts(robot: Robot, translations: ArrayLike | None) -> Array:
    """Translations (n,), m, None for home; raises InputError if they are not n finite numbers."""
    return vector("translations", robot.home_translations if translations is None else translations, robot.n_tubes)


def joint_values(robot: Robot, rotations: ArrayLike, translations: ArrayLike | None) -> tuple[Array, Array]:
    """Rotations (n,), rad, and translations (n,), m, None for home.

    Raises:
        InputError: not n finite numbers, or numbers in another unit.
    """
    shift, alpha = shifts(robot, translations), vector("rotations", rotations, robot.n_tubes)
    check_turn(alpha)
    check_reach(robot.tubes, shift.tolist())
    return alpha, shift


def keeps_hash(cls: type[Kept]) -> type[Kept]:
    """Decorate a frozen dataclass so that its objects compute their hash once, for frequent cache look-ups.

    The hash is not pickled, since strings have other hashes in every process.
    """
    compute: Any = cls.__hash__

    def cached_hash(self: Any) -> int:
        if "_hash" not in self.__dict__:
            object.__setattr__(self, "_hash", compute(self))
        value: int = self._hash
        return value

    def state(self: Any) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items() if name != "_hash"}

    cls.__hash__, cls.__getstate__ = cached_hash, state  # type: ignore[method-assign]
    return cls


@without_unit_warnings()
def resized(robot: Robot, tube: int, name: str, value: float) -> Any:
    """Robot with another dimension of a tube, SI; see `Tube.resized`."""
    tubes = [each.resized(name, value) if i == tube else each for i, each in enumerate(robot.tubes)]
    return replace(robot, tubes=tuple(tubes))  # type: ignore[type-var]


@lru_cache(maxsize=64)
def is_general(robot: Robot) -> bool:
    """True if a tube of the robot is made of pieces."""
    return any(tube.general for tube in robot.tubes)


# Radial clearance below which tubes bind: what drawn tubing and its ovality already use up.
TIGHT_MM = 0.01

# Radial clearance above which the inner tube lies visibly off the centreline that the model gives both.
LOOSE_MM = 0.1


def clearances(robot: Robot) -> dict[int, tuple[int, float]]:
    """Tube around each nested tube, by number from 0, and the radial clearance, mm."""
    return {i: (o, round(_clearance(robot.tubes[i], robot.tubes[o]) * TO_MM, 9)) for i, o in robot.nested_pairs}


def drawn_clearance(tubes: Sequence[Tube]) -> tuple[float, ...]:
    """Radial clearances (n - 1,) of the tubes in the next tubes, from their diameters, m."""
    return tuple(_clearance(inner, outer) for inner, outer in pairwise(tubes))


def _clearance(inner: Tube, outer: Tube) -> float:
    return (outer.inner_diameter - inner.outer_diameter) / 2


def passed_limit(material: Material, strain: float) -> str:
    """Text of the limit of a material that a strain is beyond; "" for none."""
    if strain > material.superelastic_strain:
        return f"beyond the {material.superelastic_strain * 100:.3g} % limit of superelasticity of {material.name}"
    if strain > material.working_strain:
        return f"beyond the {material.working_strain * 100:.3g} % limit of {material.name} for repeated bending"
    return ""


def fit_warnings(robot: Robot) -> list[str]:
    """Warnings of tubes with too much strain, and of tubes that fit too tightly or too loosely."""
    warnings = robot.buffer_warnings
    for i, tube in enumerate(robot.tubes, start=1):
        if passed := passed_limit(tube.material, tube.straightened_strain):
            warnings.append(f"tube {i} is strained {tube.straightened_strain * 100:.2f} % when straightened, {passed}")
        unknown = [str(j) for j, piece in enumerate(tube.pieces, start=1) if slots_unknown(tube, piece)]
        if unknown:
            warnings.append(
                f"tube {i} is softer in piece{'s' * (len(unknown) > 1)} {', '.join(unknown)} than elsewhere. The "
                "strain at slots is larger than shown here. Give the fraction with slots by slots: {share: ...}"
            )
    for i, (around, clearance) in clearances(robot).items():
        fit = f"tube {i + 1} has {clearance:.3g} mm of radial clearance in tube {around + 1},"
        if clearance < TIGHT_MM:
            warnings.append(f"{fit} less than the {TIGHT_MM:g} mm that sliding needs: friction will wind the tubes up")
        elif clearance > LOOSE_MM:
            warnings.append(f"{fit} more than {LOOSE_MM:g} mm: its axis may lie beside the outer tube's")
    return warnings

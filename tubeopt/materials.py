"""Linear-elastic tube materials (SI)."""

from __future__ import annotations

from dataclasses import dataclass

from .errors import InputError, positive


@dataclass(frozen=True)
class Material:
    """An isotropic, linear-elastic tube material.

    Args:
        name: what to call it.
        youngs_modulus: E in Pa.
        shear_modulus: G in Pa; E/3 < G <= E/2, so that Poisson's ratio lies in [0, 1/2).
        working_strain: strain up to which a tube may be cycled without thought.
        superelastic_strain: strain beyond which a tube does not spring back.

    Raises:
        InputError: a modulus or strain is not positive, or Poisson's ratio lies outside [0, 1/2).
    """

    name: str
    youngs_modulus: float
    shear_modulus: float
    working_strain: float = 0.01
    superelastic_strain: float = 0.06

    def __post_init__(self) -> None:
        for field in ("youngs_modulus", "shear_modulus", "working_strain", "superelastic_strain"):
            object.__setattr__(self, field, positive(f"{field} of material {self.name!r}", getattr(self, field)))
        if not -1e-9 <= self.poisson_ratio < 0.5:
            raise InputError(
                f"shear_modulus of material {self.name!r} is {self.shear_modulus:g} Pa, which makes Poisson's ratio "
                f"{self.poisson_ratio:.3g}; it must lie in [0, 0.5), so the modulus between E/3 and E/2 "
                f"({self.youngs_modulus / 3:g} to {self.youngs_modulus / 2:g} Pa)"
            )

    @property
    def poisson_ratio(self) -> float:
        """nu = E / (2 G) - 1."""
        return self.youngs_modulus / (2.0 * self.shear_modulus) - 1.0

    @classmethod
    def from_poisson_ratio(cls, name: str, youngs_modulus: float, poisson_ratio: float) -> Material:
        """The material with shear modulus E / (2 (1 + nu)); raises InputError as the constructor does."""
        if not 0.0 <= poisson_ratio < 0.5:
            raise InputError(f"poisson_ratio of material {name!r} is {poisson_ratio:g}; it must lie in [0, 0.5)")
        return cls(name, youngs_modulus, youngs_modulus / (2.0 * (1.0 + poisson_ratio)))


NITINOL = Material("nitinol", youngs_modulus=58e9, shear_modulus=21.5e9)
"""Superelastic nitinol with the moduli of the thesis' Tables 2.1 and 3.1 (nu = 0.3488).

The working strain of 1 % and the recoverable strain of 6 % are the usual figures for superelastic nitinol in fatigue
and in a single loading (Pelton et al., J. Mech. Behav. Biomed. Mater. 1 (2008); Duerig et al., Mater. Sci. Eng. A
273-275 (1999))."""

"""How an equilibrium is solved for: method, settings, tolerance."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

from ..errors import InputError, choice
from ..robots.load import Load
from ..solvers.settings import NEWTON, Ipopt, Newton
from .problem import DEFAULT_DISCRETISATION, Discretisation

METHODS = ("newton", "ipopt", "energy")

TOLERANCE = 1e-8
"""Wanted accuracy of theta(s), rad, and of the tip, as a fraction of the length of the arm."""


@dataclass(frozen=True)
class Method:
    """One of METHODS with the settings of its solver."""

    name: str
    newton: Newton = NEWTON
    ipopt: Ipopt | None = None


NAMED = {name: Method(name) for name in METHODS}


@dataclass(frozen=True)
class Asked:
    """By which method, to which tolerance (see TOLERANCE), and since when (s)."""

    method: Method = NAMED["newton"]
    tolerance: float = TOLERANCE
    began: float = field(default_factory=time.perf_counter)

    def of_kernel(self, load: Load | None, discretisation: Discretisation) -> bool:
        """Whether a compiled kernel solves what is asked: by its own method, on its own points. Under a load the
        settings of Newton's method that hold there are the kernel's, too."""
        if load is not None:
            return self.method.name == "newton"
        return self.method is NAMED["newton"] and discretisation == DEFAULT_DISCRETISATION


def method_of(given: str | Newton | Ipopt, load: Load | None, discretisation: Discretisation) -> Method:
    """Behind a name or the settings of a solver; raises InputError where it is neither, or cannot solve under the
    load."""
    if isinstance(given, Newton):
        by = Method("newton", newton=given)
    elif isinstance(given, Ipopt):
        by = Method("ipopt", ipopt=given)
    else:
        by = NAMED[choice("method", given, METHODS)]
    if isinstance(load, Load):
        _must_bear(by, load, discretisation)
    return by


def _must_bear(by: Method, load: Load, discretisation: Discretisation) -> None:
    """Raise InputError for what there is not under a load."""
    if replace(by.newton, margin_tolerance=NEWTON.margin_tolerance) != NEWTON:
        raise InputError("method has settings other than margin_tolerance; only this one applies under load")
    if by.name != "newton" and not load.has_energy:
        raise InputError(
            f"method is {by.name!r}; under a moment or a follower force, which have no energy, it must be 'newton'"
        )
    if discretisation != DEFAULT_DISCRETISATION:
        raise InputError("discretisation is given; under load it is chosen automatically")

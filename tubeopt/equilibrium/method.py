"""By which method an equilibrium is solved for, with which settings."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..errors import InputError, choice
from ..robots.load import Load
from ..solvers.settings import NEWTON, Ipopt, Newton
from .solving import DEFAULT_DISCRETISATION, Discretisation

METHODS = ("newton", "ipopt", "energy")


@dataclass(frozen=True)
class Method:
    """One of METHODS with the settings of its solver."""

    name: str
    newton: Newton = NEWTON
    ipopt: Ipopt | None = None


NAMED = {name: Method(name) for name in METHODS}


def method_of(given: str | Newton | Ipopt) -> Method:
    """Behind a name or the settings of a solver; raises InputError where it is neither."""
    if isinstance(given, Newton):
        return Method("newton", newton=given)
    if isinstance(given, Ipopt):
        return Method("ipopt", ipopt=given)
    return NAMED[choice("method", given, METHODS)]


def only_plain(by: Method, load: Load, discretisation: Discretisation) -> None:
    """Raise InputError for what there is not under load."""
    own = {name: getattr(NEWTON, name) for name in ("loaded_refinements", "margin_tolerance")}
    if by.newton is not NEWTON and replace(by.newton, **own) != NEWTON:
        raise InputError(
            f"method has settings of Newton's method other than {' and '.join(own)}, which hold under load"
        )
    if by.name != "newton" and not load.has_energy:
        raise InputError(
            f"method is {by.name!r}; under a moment or a force that turns with the tip, which have no energy to be "
            "made least, it must be 'newton'"
        )
    if discretisation != DEFAULT_DISCRETISATION:
        raise InputError("discretisation is given; under load it is chosen for you")

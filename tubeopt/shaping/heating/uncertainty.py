"""Uncertainty of a rig and its tube, and ensembles of uncertain rigs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Annotated, Self

import numpy as np
import scipy

from ...display import Displayed
from ...errors import InputError, without_unit_warnings
from ...files.field_metadata import NOT_NEGATIVE, Range, Typical, check_fields, unit
from ...physics.heat import Resolution
from ...robots.tubes import Tube
from ...typing import Array
from .calibration import FACTORS
from .rig import Rig
from .thermal import ThermalModel, stack, thermal_data, thermal_model, uniform_gap_of

PART = Range(minimum=0.0, maximum=0.99)
"""Range of half-widths that are fractions."""


# 20 cells, the fine grid has 46: hundreds of members are simulated, and the difference of the fine grid is nearly the
# same in all. It is taken from the nominal one.
ENSEMBLE = Resolution(2, 4, 6, 8, 6)
"""Grid of uncertain rigs."""


@dataclass(frozen=True, eq=False)
class Ensemble:
    """Rigs that are simulated together: the nominal one as the first member, and S sampled ones."""

    model: ThermalModel
    """Thermal model of the 1 + S members."""
    draws: Array
    """(S, number of `Uncertainty.unknown`) samples in -1 to 1."""
    bias: Array
    """(1 + S,) bias of each sensor where the tube is hot, K; 0 for the nominal one."""


@dataclass(frozen=True)
class Uncertainty(Displayed):
    """Half-widths of the uncertain parameters of a rig and its tube, uniformly distributed and independent; 0 is exact.

    Raises:
        InputError: a half-width is out of its range.
    """

    loss: Annotated[float, unit("percent"), PART, "uncertainty of the heat loss of the tube to mold and air"] = 0.15
    contact_resistance: Annotated[
        float, unit("percent"), PART, "uncertainty of the contact resistance of the clamps"
    ] = 0.3
    resistivity: Annotated[float, unit("percent"), PART, "uncertainty of the resistivity of the tube"] = 0.02
    resistivity_slope: Annotated[
        float, unit("percent"), PART, "uncertainty of the temperature coefficient of the resistivity"
    ] = 0.0
    gap: Annotated[float, unit("percent"), PART, "uncertainty of the uniform air gap between tube and groove"] = 0.0
    conductivity: Annotated[float, unit("percent"), PART, "uncertainty of the thermal conductivity of the mold"] = 0.0
    board: Annotated[bool, "any board of the mold material: its ranges of conductivity and density"] = False
    slope: Annotated[bool, "any change of its conductivity with temperature that boards of the mold material have"] = (
        False
    )
    heat_capacity: Annotated[
        float, unit("percent"), PART, "uncertainty of the heat capacity of the tube, latent heat included"
    ] = 0.0
    inner_diameter: Annotated[
        float, unit("um"), NOT_NEGATIVE, Typical(1e-7, 1e-3), "uncertainty of the inner diameter of the tube"
    ] = 0.0
    ambient: Annotated[
        float, unit("K"), NOT_NEGATIVE, Typical(1e-2, 50.0), "uncertainty of the ambient temperature"
    ] = 0.0
    charge: Annotated[float, unit("percent"), PART, "largest overestimate of the state of charge"] = 0.0
    lost_on_time: Annotated[
        float,
        unit("us"),
        NOT_NEGATIVE,
        Typical(1e-8, 1e-3),
        "largest additional time loss per pulse, relative to the rig file",
    ] = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "the uncertainty")

    @classmethod
    def of_a_workshop(cls) -> Self:
        """Uncertainty of a rig without any measurement: assumed."""
        return cls(
            loss=0.15, contact_resistance=0.3, resistivity=0.1, resistivity_slope=0.2, gap=0.5, conductivity=0.2,
            board=True, slope=True, heat_capacity=0.06, inner_diameter=20e-6, ambient=5.0, charge=0.2,
            lost_on_time=10e-6,
        )  # fmt: skip

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of the uncertain parameters."""
        return tuple(item.name for item in fields(self) if getattr(self, item.name) > 0)

    def draws(self, samples: int, seed: int = 0) -> Array:
        """(samples, number of `unknown`) samples in -1 to 1: a Latin hypercube."""
        if not self.unknown:
            return np.zeros((samples, 0))
        return np.asarray(2 * scipy.stats.qmc.LatinHypercube(d=len(self.unknown), rng=seed).random(samples) - 1)

    @without_unit_warnings()
    def member(self, tube: Tube, rig: Rig, draw: Sequence[float]) -> tuple[Tube, Rig]:
        """Tube and rig of one sample (entries in the order of `unknown`)."""
        by = dict.fromkeys((item.name for item in fields(self)), 0.0)
        by |= {name: getattr(self, name) * float(x) for name, x in zip(self.unknown, draw, strict=True)}
        data = thermal_data(tube)
        data = replace(
            data,
            heat_capacity=data.heat_capacity * (1 + by["heat_capacity"]),
            resistivity_slope=data.resistivity_slope * (1 + by["resistivity_slope"]),
        )
        # A solid wire has no bore.
        inner = tube.inner_diameter + by["inner_diameter"] if tube.inner_diameter > 0 else 0.0
        if not 0 <= inner < tube.outer_diameter:
            raise InputError(
                f"inner_diameter of the uncertainty is {1e6 * self.inner_diameter:g} um; it "
                f"must be less than the wall allows (diameters {1e3 * tube.inner_diameter:g} "
                f"and {1e3 * tube.outer_diameter:g} mm)"
            )
        material = rig.mold.material.sloped(by["slope"]) if self.slope else rig.mold.material
        if self.board and material.conductivity_range is not None:
            material = material.board(by["board"])
        else:
            spread = material.conductivity * (1 + by["conductivity"])
            material = replace(material, conductivity=spread, conductivity_range=None)
        lost = rig.circuit.lost_on_time + 0.5 * (self.lost_on_time + by["lost_on_time"])
        member = replace(
            rig.with_charge(rig.battery.state_of_charge * (1 - 0.5 * (self.charge + by["charge"]))),
            circuit=replace(rig.circuit, lost_on_time=lost),
            mold=replace(rig.mold, gap=uniform_gap_of(tube, rig), material=material),
            ambient=rig.ambient + by["ambient"],
        )
        for name in ("loss", "gap", "contact_resistance", "resistivity"):
            member = FACTORS[name](member, 1 + by[name])
        return replace(tube, inner_diameter=inner, material=replace(tube.material, thermal=data)), member

    def ensemble(self, tube: Tube, rig: Rig, samples: int, *, sensor_bias: float = 0.0, seed: int = 0) -> Ensemble:
        """Nominal rig and `samples` random ones; `sensor_bias` is the half-width of the bias of their sensors, K."""
        draws = self.draws(samples, seed)
        bias = sensor_bias * np.random.default_rng(seed).uniform(-1, 1, samples)
        model = stack([thermal_model(tube, rig, ENSEMBLE), self.model(tube, rig, draws)])
        return Ensemble(model, draws, np.concatenate([[0.0], bias]))

    def model(self, tube: Tube, rig: Rig, draws: Array) -> ThermalModel:
        """Thermal model of the rigs of given samples (S, number of `unknown`)."""
        return stack([thermal_model(*self.member(tube, rig, draw), ENSEMBLE) for draw in draws])

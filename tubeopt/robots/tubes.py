"""Pre-curved tube: a straight part, then a part of constant precurvature, or a chain of pieces (SI)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, NamedTuple

import numpy as np

from ..display import Displayed
from ..errors import InputError, finite, instance, items, positive, warn_implausible
from ..files.field_metadata import NOT_NEGATIVE, POSITIVE, Typical, check_size, check_typical, unit
from ..physics.strain import surface_strain
from .materials import NITINOL, Material, modulus_doubts
from .pieces import TWIST, Piece, Precurvature, Quantity, Series, extremes

# m: no tube is so thick, and the fourth power of one that is may be no number.
LARGEST = 1e6

STIFFNESSES = ("bending_stiffness", "torsional_stiffness")


def second_moment(outer_diameter: Any, inner_diameter: Any) -> Any:
    """Second moment of area I = pi/64 (OD^4 - ID^4), m^4, of numbers, arrays or expressions."""
    return math.pi / 64 * (outer_diameter**4 - inner_diameter**4)


class OfCrossSection(float):
    """Stiffness computed from material and cross-section; `dataclasses.replace` of these computes it again."""

    def __reduce__(self) -> tuple[type[OfCrossSection], tuple[float]]:
        return OfCrossSection, (float(self),)


@dataclass(frozen=True)
class Tube(Displayed):
    """Tube that is straight from its clamped end, then curved: with one radius, or piece by piece (`of_pieces`).

    For a tube of pieces `curved_length` is the sum of their lengths, and `curvature` the largest |u*_xy|: another value
    scales all pieces. The stiffnesses are those of the straight part and of pieces without their own. Omitted or None
    they are E I and G J, also after `dataclasses.replace` changes diameters or material. Explicit values stay.

    Raises:
        InputError: a field is not finite or out of its range, or the curve is tighter than the tube is thick.
    """

    outer_diameter: Annotated[float, unit("mm"), POSITIVE, Typical(1e-4, 0.1)]
    inner_diameter: Annotated[float, unit("mm"), NOT_NEGATIVE, Typical(2e-5, 0.1), "smaller than the outer diameter"]
    straight_length: Annotated[
        float, unit("mm"), NOT_NEGATIVE, Typical(1e-3, 10.0), "length of the straight part, from the clamped end"
    ]
    curved_length: Annotated[
        float, unit("mm"), NOT_NEGATIVE, Typical(1e-3, 10.0), "length of the curved part, after the straight part"
    ]
    curvature: Annotated[
        float,
        unit("per_m"),
        Typical(0.1, 2000.0),
        "precurvature; 0 for a straight tube, negative for the opposite direction",
    ]
    material: Material = NITINOL
    """Material; default for stiffnesses and mass."""
    # None only as an argument: a tube that exists has its stiffnesses.
    bending_stiffness: Annotated[float, unit("N_mm2"), POSITIVE, "measured value; default E I"] = field(
        default=None,  # type: ignore[assignment]
        kw_only=True,
    )
    torsional_stiffness: Annotated[float, unit("N_mm2"), POSITIVE, "measured value; default G J"] = field(
        default=None,  # type: ignore[assignment]
        kw_only=True,
    )
    mass_per_length: Annotated[
        float | None, unit("g_per_m"), POSITIVE, Typical(1e-6, 1.0), "mass per length, for weight"
    ] = field(default=None, kw_only=True)
    pieces: tuple[Piece, ...] = field(default=(), kw_only=True)
    """Pieces behind the straight part, up to the tip; empty for a tube of one radius."""

    def __post_init__(self) -> None:
        set_field = object.__setattr__
        instance("material", self.material, Material)
        set_field(self, "pieces", items("pieces", self.pieces, Piece, "pieces of a tube"))
        set_field(self, "outer_diameter", positive("outer_diameter", self.outer_diameter))
        for name in ("inner_diameter", "straight_length", "curved_length"):
            set_field(self, name, positive(name, getattr(self, name), zero=True))
        set_field(self, "curvature", finite("curvature", self.curvature))
        if self.outer_diameter >= LARGEST:
            raise InputError(f"outer_diameter is {self.outer_diameter:g} m; it must be less than {LARGEST:g} m")
        if self.inner_diameter >= self.outer_diameter:
            raise InputError(
                f"inner_diameter is {self.inner_diameter:g} m; it must be less than outer_diameter "
                f"({self.outer_diameter:g} m)"
            )
        if self.length == 0:
            raise InputError("straight_length and curved_length are both 0; a tube must have a length")
        if self.mass_per_length is not None:
            set_field(self, "mass_per_length", positive("mass_per_length", self.mass_per_length))
        self._derive_stiffness()
        if self.pieces:
            self._join_pieces()
        # The inner side of the bend has length 1 - r kappa per length: none is left at 1.
        if self.outer_diameter / 2 * abs(self.curvature) >= 1:
            raise InputError(
                f"curvature is {self.curvature:g} per m; its radius must exceed half the outer_diameter "
                f"({self.outer_diameter / 2:g} m)"
            )

    def _derive_stiffness(self) -> None:
        moduli = {
            "bending_stiffness": self.material.youngs_modulus,
            "torsional_stiffness": 2 * self.material.shear_modulus,
        }
        for name, modulus in moduli.items():
            stiffness = getattr(self, name)
            from_section = stiffness is None or isinstance(stiffness, OfCrossSection)
            value = OfCrossSection(modulus * self.second_moment) if from_section else positive(name, stiffness)
            object.__setattr__(self, name, value)

    def _join_pieces(self) -> None:
        """Bend the pieces to the given `curvature`, and set curvature and curved length to the exact values of the
        pieces.
        """
        total = math.fsum(piece.length for piece in self.pieces)
        if abs(total - self.curved_length) > 1e-9 * total:
            raise InputError(
                f"curved_length is {self.curved_length:g} m; of a tube of pieces it is the sum of their lengths, "
                f"{total:g} m"
            )
        largest = max(piece.largest_curvature for piece in self.pieces)
        pieces = tuple(self.pieces)
        if self.curvature != largest:
            if largest == 0:
                raise InputError(
                    f"curvature is {self.curvature:g} per m; all pieces of the tube are straight, so it is 0"
                )
            pieces = tuple(piece.scaled(self.curvature / largest) for piece in pieces)
        for k, piece in enumerate(pieces, start=1):
            if self.outer_diameter / 2 * piece.largest_curvature >= 1:
                raise InputError(
                    f"piece {k} is curved by {piece.largest_curvature:g} per m; its radius must exceed half the "
                    f"outer_diameter ({self.outer_diameter / 2:g} m)"
                )
            # A line on the surface is inclined by atan(r u*_z), 45 deg where r u*_z = 1.
            twist = max(map(abs, extremes([piece.precurvature[2]], piece.length)))
            if self.outer_diameter / 2 * twist >= 1:
                raise InputError(
                    f"piece {k} is twisted by {twist:g} rad per m ({np.degrees(twist) * 1e-3:g} deg per mm); half the "
                    f"outer_diameter ({self.outer_diameter / 2:g} m) times that must be less than 1"
                )
        object.__setattr__(self, "pieces", pieces)
        object.__setattr__(self, "curved_length", total)
        object.__setattr__(self, "curvature", max(piece.largest_curvature for piece in pieces))

    @classmethod
    def of_pieces(
        cls,
        outer_diameter: float,
        inner_diameter: float,
        pieces: Iterable[Piece],
        *,
        straight_length: float = 0.0,
        material: Material = NITINOL,
        bending_stiffness: float | None = None,
        torsional_stiffness: float | None = None,
        mass_per_length: float | None = None,
    ) -> Tube:
        """A tube that is a chain of pieces behind a straight part; one circular arc about x is the ordinary tube.

        Args:
            pieces: from the straight part to the tip.
            straight_length, material, bending_stiffness, torsional_stiffness, mass_per_length: as of a `Tube`.
        """
        chain = tuple(pieces)
        if not chain:
            raise InputError("pieces is empty; a tube needs at least one piece")
        for piece in chain:
            instance("a piece", piece, Piece)
        total = math.fsum(piece.length for piece in chain)
        overrides: dict[str, Any] = {
            "bending_stiffness": bending_stiffness,
            "torsional_stiffness": torsional_stiffness,
            "mass_per_length": mass_per_length,
        }
        if len(chain) == 1 and chain[0].plain:
            curvature = float(chain[0].precurvature[0])
        else:
            curvature, overrides["pieces"] = max(piece.largest_curvature for piece in chain), chain
        return cls(outer_diameter, inner_diameter, straight_length, total, curvature, material, **overrides)

    def resized(self, name: str, value: float) -> Tube:
        """Tube with another dimension.

        Pieces change in proportion: a longer curved part stretches each of them, and a stiffness scales those of all.

        Args:
            name: a field that is a number, as "curvature" or "bending_stiffness".
            value: SI.
        """
        factor = value / getattr(self, name) if self.pieces and name in ("curved_length", *STIFFNESSES) else 1.0
        pieces = self.pieces
        match name:
            case "curved_length":
                pieces = tuple(piece.stretched(factor) for piece in pieces)
            case "bending_stiffness":
                pieces = tuple(piece.stiffened(factor, 1.0) for piece in pieces)
            case "torsional_stiffness":
                pieces = tuple(piece.stiffened(1.0, factor) for piece in pieces)
        return replace(self, **{name: value}, pieces=pieces)  # type: ignore[arg-type]

    @property
    def general(self) -> bool:
        """True for a tube made of pieces: precurvature and stiffness are not one number each."""
        return bool(self.pieces)

    @property
    def even(self) -> bool:
        """True if the stiffnesses are constant along the tube, and the curvature along its curved part, about x."""
        if not self.pieces:
            return True
        if isinstance(self.arc, Series):  # it varies along a piece
            return False
        stiffnesses = float(self.bending_stiffness), float(self.torsional_stiffness)
        return all(
            precurvature == (self.arc, 0.0, 0.0) and (bending, torsional) == stiffnesses
            for _, precurvature, bending, torsional in stretches(self)[self.straight_length > 0 :]
        )

    @property
    def arc(self) -> Any:
        """Signed curvature about x at the start of the curved part, 1/m, constant along an even tube."""
        return self.pieces[0].precurvature[0] if self.pieces else self.curvature

    @property
    def chain(self) -> tuple[Piece, ...]:
        """Pieces of the tube; for a tube of one curvature a single piece, its curved part."""
        if self.pieces or self.curved_length == 0:
            return self.pieces
        return (Piece(self.curved_length, self.curvature),)

    @property
    def length(self) -> float:
        """Overall length, m."""
        return self.straight_length + self.curved_length

    @property
    def cross_section(self) -> float:
        """Cross-sectional area of the metal, m^2."""
        return math.pi / 4 * (self.outer_diameter**2 - self.inner_diameter**2)

    @property
    def second_moment(self) -> float:
        """Second moment of area I = pi/64 (OD^4 - ID^4), m^4."""
        return float(second_moment(self.outer_diameter, self.inner_diameter))

    @property
    def polar_moment(self) -> float:
        """Polar moment of area J = 2 I, m^4."""
        return 2 * self.second_moment

    @property
    def straightened_strain(self) -> float:
        """Largest surface strain if the curved part is straightened: r kappa / (1 - r kappa).

        For slotted pieces it is the bound of their `slots`, or without these the strain of the tube without slots.
        """
        if not self.pieces:
            return float(surface_strain(self.outer_diameter / 2, abs(self.curvature), self.curvature))
        return max(piece_strain(self, piece) for piece in self.pieces)


# Pa; a modulus above that of diamond is a model's.
HARDEST = 1.3e12

# Strain of a tube held straight beyond which it was probably meant otherwise, where the material does not state more:
# nitinol recovers 8 to 10 %, and published robots reach 3 %. `robot.fit_warnings` states what a robot's materials
# spring back from, and may be cycled to.
MAX_STRAIN = 0.10


def warn_of_units(tube: Tube) -> None:
    """Warn of numbers outside the typical ranges of their fields, such as mm for m, and of `material_doubts`.

    A tube with its own stiffness, or with the modulus of no solid, may be a model in other units: it is not checked.
    """
    if not _is_model(tube):
        check_typical(tube)
        for k, piece in enumerate(tube.pieces, start=1):
            check_size(f"twist of piece {k}", extremes([piece.precurvature[2]], piece.length), TWIST, "rad_per_m")
    for doubt in material_doubts(tube):
        warn_implausible(doubt)


def _is_model(tube: Tube) -> bool:
    return not isinstance(tube.bending_stiffness, OfCrossSection) or tube.material.youngs_modulus > HARDEST


def material_doubts(tube: Tube) -> Iterator[str]:
    """Warnings of a modulus that the metal does not have, and of a strain that the material does not recover."""
    if _is_model(tube):
        return
    yield from modulus_doubts(tube.material)
    strain = 0.0 if tube.pieces else tube.straightened_strain
    max_strain = max(MAX_STRAIN, tube.material.superelastic_strain)
    if strain > max_strain:
        yield (
            f"curvature is {tube.curvature:g} per m, which strains the tube by {100 * strain:.3g} % when it is "
            f"straightened; {tube.material.name} springs back from at most {100 * max_strain:g} %"
        )


def piece_strain(tube: Tube, piece: Piece) -> float:
    """Largest surface strain of a piece of a tube if it is straightened, with its `slots` if they are defined."""
    curvature = piece.largest_curvature
    strain = surface_strain(tube.outer_diameter / 2, curvature, curvature)
    return piece.strain_ratio(float(tube.bending_stiffness)) * float(strain)


def slots_unknown(tube: Tube, piece: Piece) -> bool:
    """Return whether a piece is softer in bending than its tube, as by slots, but does not define them."""
    return piece.slots is None and piece.bending_factor(float(tube.bending_stiffness)) < 1 - 1e-9


def must_be_plain(tubes: Iterable[Tube], what: str) -> None:
    """Raise InputError if a tube is made of pieces, which `what` does not support."""
    for i, tube in enumerate(tubes, start=1):
        if tube.general:
            raise InputError(f"tube {i} is made of pieces; {what} supports tubes of one constant curvature only")


class TubeStretch(NamedTuple):
    """Straight part or piece of a tube."""

    length: float
    """Arc length, m."""
    precurvature: Precurvature
    """Components in the frame of the tube."""
    bending_stiffness: Quantity
    """Bending stiffness EI, N m^2."""
    torsional_stiffness: Quantity
    """Torsional stiffness GJ, N m^2."""


def stretches(tube: Tube) -> list[TubeStretch]:
    """Stretches of a tube from its clamped end, the straight part first."""
    kb, kt = float(tube.bending_stiffness), float(tube.torsional_stiffness)
    out = [TubeStretch(tube.straight_length, (0.0, 0.0, 0.0), kb, kt)] if tube.straight_length > 0 else []
    for piece in tube.chain:
        bending = kb if piece.bending_stiffness is None else piece.bending_stiffness
        torsional = kt if piece.torsional_stiffness is None else piece.torsional_stiffness
        out.append(TubeStretch(piece.length, piece.precurvature, bending, torsional))
    return out


def mass_per_length(tube: Tube) -> float | None:
    """Mass per length of a tube, kg/m: its own, else by the density of its material; None if both are unknown."""
    thermal = tube.material.thermal
    if tube.mass_per_length is not None or thermal is None:
        return tube.mass_per_length
    return thermal.density * tube.cross_section

"""Checks of a mold: a number, its limit and the message of a violation (SI)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ...errors import InputError
from ...robots.tubes import Tube
from .groove import Point
from .layout import SLACK, Blank
from .spec import EndMill, MoldSpec
from .springback import bend_direction, tube_in_mold

OVERRUN = 1e-3
"""Distance of the cutter's edge from the plate before it plunges or retracts, m."""

HOLDER = 5e-3
"""Space next to a tool for its holder, m."""

LEAST_TOLERANCE = 1e-5
"""Smallest tolerance of a groove, m: that of the cutter's path."""

THROUGH = 0.5e-3
"""Depth of cuts through a plate into the board below, m."""


@dataclass(frozen=True)
class Check:
    """Condition on a mold."""

    name: str
    """Checked quantity, in words."""
    value: float
    """Value of the quantity, in `unit`."""
    limit: float
    """Limit of the quantity, in `unit`."""
    unit: str
    """Unit of value and limit: "m", "1" or "K"."""
    at_most: bool
    """True for an upper limit, False for a lower one."""
    failure: str
    """Message of a failed check."""

    @property
    def passed(self) -> bool:
        """True if the condition is satisfied."""
        reserve = self.limit - self.value if self.at_most else self.value - self.limit
        return reserve >= -SLACK


def refuse_failed(checks: Iterable[Check]) -> None:
    """Raise InputError with a line for every failed check."""
    failures = [check.failure for check in checks if not check.passed]
    if failures:
        raise InputError("\n".join(failures))


def choose_mill(number: int, tube: Tube, spec: MoldSpec) -> tuple[EndMill, float]:
    """End mill for the groove of a tube, and width of the groove, m.

    The smallest mill between the smallest and the largest clearance cuts the groove in one pass. Without such a mill,
    the largest smaller one cuts a groove of the smallest clearance along both walls.
    """
    min_width = tube.outer_diameter + spec.groove.clearance
    max_width = max(tube.outer_diameter + spec.groove.most_clearance, min_width)
    mills = spec.milling.end_mills
    for mill in mills:
        if min_width - SLACK <= mill.diameter <= max_width + SLACK:
            return mill, mill.diameter
    smaller = [mill for mill in mills if mill.diameter < min_width]
    if smaller:
        return smaller[-1], min_width
    raise InputError(
        f"the smallest available end mill ({mills[0].diameter * 1e3:g} mm) is wider than the "
        f"groove of tube {number}: outer diameter {tube.outer_diameter * 1e3:g} mm and at "
        f"most {spec.groove.most_clearance * 1e3:g} mm of clearance"
    )


def fit_tolerance(spec: MoldSpec) -> float:
    """Allowed deviation (m) of width and depth of a groove from the programmed ones, to both sides.

    Half the clearance: at the lower limit the other half is left around the tube.
    """
    return max(0.5 * spec.groove.clearance, LEAST_TOLERANCE)


def groove_depth(tube: Tube, spec: MoldSpec) -> float:
    """Depth of the groove, m: tube and clearance, rounded up to the step of depths, so that the lid lies flat."""
    step = spec.groove.depth_step
    return math.ceil((tube.outer_diameter + spec.groove.clearance) / step - 1e-9) * step


def strain_check(number: int, held: Tube, spec: MoldSpec, process: str, occasion: str, remedy: str) -> Check:
    """Check of the strain of a straight tube that is bent to its shape in the mold.

    Args:
        held: tube as the mold holds it.
        process: such as "pressed into the groove".
        occasion: clause on the process for the message.
        remedy: advice for the message.
    """
    strain, limit = pressing_strain(held, held.curvature), spec.most_strain or held.material.superelastic_strain
    failure = (
        f"tube {number} is strained {strain * 100:.3g} % {occasion}, beyond the {limit * 100:.3g} % that "
        f"{held.material.name} springs back from; {remedy}"
    )
    return Check(
        name=f"tube {number}: strain when {process}", value=strain, limit=limit, unit="1", at_most=True, failure=failure
    )


def pressing_strain(tube: Tube, mold_curvature: float) -> float:
    """Largest surface strain of a straight tube pressed into a groove of this curvature (1/m): OD/2 * curvature."""
    return tube.outer_diameter / 2 * abs(mold_curvature)


def tube_checks(blank: Blank, spec: MoldSpec) -> tuple[Check, ...]:
    """Checks of one groove that do not depend on its position on the plate."""
    number, tube, mill, width = blank.number, blank.held, blank.mill, blank.width
    depth = groove_depth(tube, spec)
    radius = min(piece.radius for piece in blank.bend)
    pressed = f"when it is pressed straight into the mold (radius {radius * 1e3:.4g} mm)"
    remedy = "set it in steps, in molds of smaller and smaller radius"
    floor = spec.plate.thickness - depth
    return (
        strain_check(number, tube, spec, "pressed into the groove", pressed, remedy),
        Check(
            name=f"tube {number}: radius of the bend over that of its inner wall's cutter",
            value=radius,
            limit=max(width / 2, mill.diameter / 2),
            unit="m",
            at_most=False,
            failure=f"the mold radius for tube {number} is {radius * 1e3:.4g} mm, below half the groove's width "
            f"({width / 2 * 1e3:.4g} mm) and the end mill's own radius ({mill.diameter / 2 * 1e3:.4g} mm); it cannot "
            "be milled",
        ),
        Check(
            name=f"tube {number}: depth of the groove within the end mill's reach",
            value=depth,
            limit=mill.reach,
            unit="m",
            at_most=True,
            failure=f"the groove of tube {number} is {depth * 1e3:.4g} mm deep, deeper than the "
            f"{mill.diameter * 1e3:g} mm end mill cuts ({mill.reach * 1e3:.4g} mm)",
        ),
        Check(
            name=f"tube {number}: material below the groove",
            value=floor,
            limit=spec.groove.floor,
            unit="m",
            at_most=False,
            failure=f"the plate is too thin: {spec.plate.thickness * 1e3:.4g} mm. The groove of tube {number} is "
            f"{depth * 1e3:.4g} mm deep; {spec.groove.floor * 1e3:.4g} mm must stay below it",
        ),
    )


def wall_check(min_wall: float, spec: MoldSpec) -> Check:
    """Check of the thinnest wall between grooves, m."""
    return Check(
        name="least wall between grooves",
        value=min_wall,
        limit=spec.groove.wall,
        unit="m",
        at_most=False,
        failure=f"the wall between grooves is {min_wall * 1e3:.4g} mm; it must be at least "
        f"{spec.groove.wall * 1e3:.4g} mm",
    )


def as_held(number: int, tube: Tube, spec: MoldSpec) -> Tube:
    """Tube in the shape of its mold; errors name the number of the tube."""
    try:
        return tube_in_mold(tube, spec.springback)
    except InputError as error:
        raise InputError(f"tube {number}: {error}") from None


def held_in_plane(number: int, tube: Tube, spec: MoldSpec, limitation: str) -> Tube:
    """Tube in the shape of a planar mold.

    Raises:
        InputError: a straight tube, or a space curve; `limitation` begins the reason, such as "a plate is for".
    """
    if tube.curved_length == 0:
        raise InputError(f"tube {number} has no curved part; it needs no mold")
    if bend_direction(tube) is None:
        raise InputError(f"tube {number} is a space curve; {limitation} planar bends only: use a mandrel")
    return as_held(number, tube, spec)


def springback_remarks(spec: MoldSpec) -> list[str]:
    """Remarks on a spring-back that is not from trials."""
    if spec.springback.calibrated:
        return []
    return ["the spring-back is not calibrated: tubes will come out straighter; set one, then `tubeopt mold calibrate`"]


def stiffness_remarks(tube: Tube) -> list[str]:
    """Remarks on a tube with pieces of their own stiffness."""
    if not any(piece.bending_stiffness or piece.torsional_stiffness for piece in tube.pieces):
        return []
    return ["the stiffnesses of its pieces are given, not derived: the slots that make them are not drawn"]


def material_remarks(spec: MoldSpec) -> tuple[str, ...]:
    """Remarks on the mold's material at the set temperature."""
    remarks, material = [], spec.material
    if spec.heat.set_temperature > material.limit_temperature:
        remarks.append(
            f"{material.name} {material.failure} above {material.limit_temperature_degC:.0f} degC: the groove changes "
            "its shape after a few tubes"
        )
    if not material.electrically_insulating:
        remarks.append(
            f"{material.name} conducts: current leaves the tube through the mold; set the tube in an oven, or take an "
            "insulating mold"
        )
    return tuple(remarks)


def overrun(width: float) -> float:
    """Length (m) of the cutter path beyond the plate's edge, enough for grooves that leave it at a small angle."""
    return 3 * width + OVERRUN


def beyond_edge(widths: Sequence[float], spec: MoldSpec) -> float:
    """Smallest distance (m) of the stock's clamps from the plate's edges, for grooves of `widths` (m)."""
    outline = spec.workshop.outline_diameter + HOLDER if spec.workshop.cut_out else 0.0
    return max([outline, *(overrun(width) + 0.5 * width + HOLDER for width in widths)])


def machining_remarks(size: Point, widths: Sequence[float], spec: MoldSpec) -> tuple[str, ...]:
    """Remarks on a stock that is too small, and on an end mill too short for the outline."""
    shop, remarks = spec.workshop, []
    if not shop.cut_out:
        return ()
    thickness = max(spec.plate.thickness, spec.plate.lid_thickness)
    if shop.outline_reach < thickness + THROUGH:
        remarks.append(
            f"the end mill that cuts plates out reaches {shop.outline_reach * 1e3:g} mm deep, the plate is "
            f"{thickness * 1e3:g} mm thick: take a longer one, or stock in the plates' size (cut_out: false)"
        )
    needed = [side + 2 * beyond_edge(widths, spec) for side in size]
    if shop.stock is not None and any(s < n for s, n in zip(shop.stock, needed, strict=True)):
        required, actual = (" x ".join(f"{1e3 * side:.0f}" for side in sides) for sides in (needed, shop.stock))
        remarks.append(f"the stock is {actual} mm; with room for tools and clamps it must be {required} mm")
    return tuple(remarks)

"""What is said and saved about an equilibrium."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..equilibrium.clearance import clearance_correction
from ..equilibrium.file import save_equilibrium
from ..equilibrium.result import Equilibrium, Verification
from ..files.units import TO_MILLI, TO_MM
from ..robots.concentric import ConcentricRobot, friction_of
from ..typing import Array
from .formatting import counted, margin_in_words, millimetres, order_remarks, tip_in_words, tip_number
from .load_words import LOADED
from .quantities import Quantity, described, line, of_field
from .readings import readings
from .report import Report

NOTICED = 1e-3
"""Seconds of getting a kernel ready from which on they are told: in a process that has it, finding it takes less."""

VERIFICATION = described(Verification, "tip_position tip_rotation rotation end_torsion end_curvature base_rotation")

EQUILIBRIUM = described(
    Equilibrium,
    Quantity("robot", "name of the robot", lambda e: e.robot.name),
    "rotations translations",
    *readings(lambda e: e),
    Quantity("status", "result of the solve", lambda e: e.status.name),
    Quantity("stable", "true if it is stable"),
    Quantity("tip_position_mm", "tip position in the frame of the plate", form=".4f", label="tip position"),
    Quantity("tip_tube",
             "number of the tube at the tip: the one that ends farthest from the plate, of several the innermost; "
             "null if all are withdrawn", lambda e: tip_number(e), label="the tip is",
             words=lambda e: tip_in_words(e.robot, e.tube_end) or None),
    Quantity("remarks", "carriages that are out of order; absent if none is",
             lambda e: order_remarks(e.robot, e.translations) or None, optional=True),
    Quantity("tip_by_history_mm",
             "largest displacement of the tip by friction along x, y and z, for any history, to first order; absent "
             "without friction", lambda e: by_history(e), optional=True),
    line("friction holds it", lambda e: _held_within(e)),
    Quantity("tip_by_clearance_mm",
             "tip position after tilting by the clearance between the tubes, to first order; absent without clearance",
             lambda e: _tilted(e, "tip_position"), optional=True),
    Quantity("tip_clearance_radius_mm",
             "largest distance of that from the tip position, estimated; a first-order bound for tubes bent in one "
             "plane; absent without clearance", lambda e: _tilted(e, "tip_radius"), optional=True),
    line("clearance", lambda e: _loose(e)),
    Quantity("tip_direction", "direction of the tip", lambda e: e.tip_rotation[:, 2], form=".4f",
             label="pointing along"),
    "tip_rotations",
    of_field(Equilibrium, "margin", label="margin", words=lambda e: margin_in_words(e.margin)),
    "energy",
    *LOADED,
    "residual mesh_error tip_error",
    line("estimated error", "{mesh_error_rad:.1e} rad along the tubes, {tip_error_mm:.1e} mm at the tip"),
    of_field(Equilibrium, "verification", of=VERIFICATION, label="re-integration differs",
             words="{verification[tip_position_mm]:.1e} mm at the tip, {verification[rotation_rad]:.1e} rad"),
    Quantity("statistics", "method, mesh, iterations and time", lambda e: dict(vars(e.statistics)), label="solved",
             words=lambda e: _how(e)),
)  # fmt: skip


def by_history(e: Equilibrium) -> Array | None:
    """(3,) half widths (m) to first order of where friction can hold the tip; None where the robot tells of none."""
    friction = friction_of(e.robot)
    if friction is None or e.friction is not None or not e.stable:
        return None
    from ..stability import friction_band  # with all of stability, which forward kinematics starts without

    return friction_band(e, friction).tip_half_widths


def _held_within(e: Equilibrium) -> str | None:
    half = by_history(e)
    return None if half is None else f"within ± {millimetres(half, '.3f')} along x, y, z, to first order"


def _tilted(e: Equilibrium, name: str) -> Any:
    """Of the correction for clearance; None where the robot's file tells of none."""
    if not isinstance(e.robot, ConcentricRobot) or not any(e.robot.clearance or ()):
        return None
    return getattr(clearance_correction(e), name)


def _loose(e: Equilibrium) -> str | None:
    place = _tilted(e, "tip_position")
    if place is None:
        return None
    moved = millimetres(place - e.tip_position, ".3f")
    return f"tilts the tip by {moved} to first order, at worst some {_tilted(e, 'tip_radius') * TO_MM:.3f} mm"


def _how(e: Equilibrium) -> str:
    s = e.statistics
    loading = f", after {s.loading * TO_MILLI:.0f} ms to get its kernel ready" if s.loading > NOTICED else ""
    work = f"{s.method}, {counted(s.iterations, 'iteration')}"
    return f"in {s.seconds * TO_MILLI:.2f} ms by {work}, from {s.start}{loading}"


class EquilibriumReport(Report[Equilibrium]):
    command = "fk"
    quantities = EQUILIBRIUM
    drawn = (("shape", "shape.plot_shape"), ("torsion", "torsion.plot_torsion"))

    def save(self, directory: Path) -> list[Path]:
        """Write result.json and arrays.npz."""
        return save_equilibrium(self.answer, directory)

    def tables(self) -> dict[str, Any]:
        return {"arm": self.answer}

    def solids(self) -> dict[str, Equilibrium]:
        return {"arm": self.answer}

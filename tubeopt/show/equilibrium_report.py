"""Reports on a robot and on an equilibrium of it."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Group
from rich.text import Text

from ..equilibrium.clearance import clearance_correction
from ..equilibrium.file import save_equilibrium
from ..equilibrium.result import Equilibrium, Verification, WallForce
from ..files.units import TO_MILLI, TO_MM
from ..robots.concentric import ConcentricRobot, friction_of
from ..robots.eccentric import (
    SAME_AXIS,
    BufferedTube,
    BundleRobot,
    EccentricRobot,
    SegmentedEccentricRobot,
    buffered_tubes,
    free_channel,
    model_text,
    room_in_sheath,
)
from ..robots.file import AnyRobot
from ..robots.order import ends_inside
from ..robots.robot import Robot, clearances, fit_warnings
from ..robots.tubes import OfCrossSection, Tube
from ..typing import Array
from .formatting import counted, ends_text, margin_text, millimetres, order_remarks, tip_number, tip_text
from .quantities import LOADED, SNAP_DISTANCE, Quantity, described, line, of_field, readings, within
from .report import Report, grid, remarks

if TYPE_CHECKING:
    from ..validation.certainty import Uncertainty


def _poisson_ratio(tube: Tube) -> float | None:
    """Poisson's ratio of the material; None if a stiffness was entered, which is independent of it."""
    derived = all(isinstance(k, OfCrossSection) for k in (tube.bending_stiffness, tube.torsional_stiffness))
    return tube.material.poisson_ratio if derived else None


TUBE: tuple[Quantity[Tube], ...] = (
    Quantity("outer_diameter_mm", "outer diameter", digits=9, form=".6g"),
    Quantity("inner_diameter_mm", "inner diameter", digits=9, form=".6g"),
    Quantity("straight_length_mm", "straight length", digits=9, form=".6g"),
    Quantity("curved_length_mm", "curved length", digits=9, form=".6g"),
    Quantity("length_mm", "overall length", digits=9, form=".6g"),
    Quantity("curvature_per_m", "precurvature", form=".6g"),
    Quantity("material", "material", lambda tube: tube.material.name, text="{material}"),
    Quantity("bending_stiffness_N_mm2", "bending stiffness EI", form=".6g"),
    Quantity("torsional_stiffness_N_mm2", "torsional stiffness GJ", form=".6g"),
    Quantity(
        "poisson_ratio",
        "Poisson's ratio",
        _poisson_ratio,
        text=lambda tube: "–" if (ratio := _poisson_ratio(tube)) is None else f"{ratio:.6g}",
    ),
    Quantity(
        "straightened_strain_percent", "strain of the straightened tube", form=".6g", label="strain when straightened"
    ),
)


NESTED: tuple[Quantity[tuple[Tube, float | None]], ...] = (
    *within(TUBE, lambda nested: nested[0]),
    Quantity("radial_clearance_mm", "radial clearance in the next tube", lambda nested: nested[1], digits=9),
)
"""Quantities of a tube and its radial clearance, m, in the next outer one; None without one."""

BUFFERED: tuple[Quantity[BufferedTube], ...] = (
    Quantity("shift_mm", "distance of the axis at the drive from that in the sheath", digits=9),
    Quantity("slope_deg", "largest angle to the axis of the arm"),
    Quantity("radius_mm", "smallest radius of the bends", lambda tube: tube.radius if tube.shift else None),
    Quantity("strain_percent", "largest bending strain at the surface"),
    Quantity("length_mm", "length of straight tube in the buffer", digits=9),
    Quantity("force_N", "force across the axis"),
    Quantity("push_N", "force that pushes drive and sheath apart"),
    Quantity("turn_play_deg", "half width of the turn of the drive that friction at the sheath takes up"),
    Quantity("slide_play_mm", "change of length in the buffer between both sides of the room", digits=9),
)

SHEATH: tuple[Quantity[BundleRobot | EccentricRobot | SegmentedEccentricRobot], ...] = (
    Quantity("diameter_mm", "inner diameter", lambda robot: room_in_sheath(robot).diameter, digits=9),
    Quantity("room_mm", "free distance between the tubes and the sheath, on each side",
             lambda robot: room_in_sheath(robot).width, digits=9),
    Quantity("turns",
             "turns of the tubes around each other for which this is enough; null unless equal tubes touch all around",
              lambda robot: room_in_sheath(robot).turns),
    Quantity("stiffness_N_mm2", "bending stiffness", lambda robot: getattr(robot, "sheath_stiffness", 0.0)),
    Quantity("rigid_length_mm", "length of the rigid part at the plate",
             lambda robot: getattr(robot, "sheath_rigid_length", 0.0), digits=9),
    Quantity("rigid_from_mm", "length in front of the rigid tip; null without one",
             lambda robot: getattr(robot, "sheath_rigid_from", None), digits=9),
)  # fmt: skip

ROBOT: tuple[Quantity[Robot], ...] = (
    Quantity("robot", "name of the robot", lambda robot: robot.name),
    Quantity("tubes", "the tubes, inner to outer", lambda robot: _tubes(robot), of=NESTED),
    Quantity("home_translations_mm", "translations at home", digits=9),
    Quantity(
        "channel_mm",
        "diameter of the largest free circle along the robot, between its tubes or in one; absent of concentric robots",
        lambda robot: _channel(robot),
        digits=9,
        optional=True,
    ),
    Quantity(
        "model",
        "model of an eccentric robot: thesis (balance of moments) or energy; absent of concentric robots",
        lambda robot: model_name(robot),
        optional=True,
    ),
    Quantity(
        "sheath",
        "the sheath of an eccentric robot; absent of concentric robots",
        lambda robot: _sheath(robot),
        of=SHEATH,
        optional=True,
    ),
    Quantity(
        "buffer",
        "the tubes between drive and plate, inner to outer; absent without a buffer",
        lambda robot: _buffered(robot) or None,
        of=BUFFERED,
        optional=True,
    ),
    Quantity("warnings", "possible problems in making and using it", lambda robot: fit_warnings(robot)),
)


def _buffered(robot: Robot) -> list[BufferedTube]:
    """Tubes in the buffer section; [] without one."""
    return [] if isinstance(robot, ConcentricRobot) else buffered_tubes(robot)  # type: ignore[arg-type]


def _buffer_text(robot: Robot) -> str:
    """Text of the tube that bends most in the buffer section; "" without one."""
    if not (tubes := _buffered(robot)):
        return ""
    number, most = max(enumerate(tubes, start=1), key=lambda pair: pair[1].strain)
    turn, slide = (max(getattr(tube, name) for tube in tubes) for name in ("turn_play", "slide_play"))
    plays = [f"{np.degrees(turn):.3g} deg of a turn"] if turn > 0 else []
    plays += [f"{slide * TO_MM:.3g} mm of a stroke"] if slide > 0 else []
    return (
        f"buffer: tube {number} moves aside by {most.shift * TO_MM:.4g} mm, at up to {np.degrees(most.slope):.3g} deg "
        f"and {100 * most.strain:.3g} % strain, and takes {most.length * TO_MM:.4g} mm of straight tube. It pushes "
        f"with {most.push:.3g} N, across with {most.force:.3g} N"
    ) + (f". Play: up to {' and '.join(plays)}" if plays else "")


def _sheath(robot: Robot) -> Robot | None:
    """Robot with a sheath to describe; None for concentric robots."""
    return None if isinstance(robot, ConcentricRobot) else robot


def _sheath_text(robot: Robot) -> str:
    """Text of the sheath, and how far the tubes can spiral in it; "" for concentric robots."""
    if isinstance(robot, ConcentricRobot):
        return ""
    room, words = room_in_sheath(robot), []  # type: ignore[arg-type]
    if isinstance(robot, BundleRobot):
        words += [f"{robot.sheath_stiffness * 1e6:.4g} N mm² stiff"] if robot.sheath_stiffness else []
        words += [f"rigid up to {robot.sheath_rigid_length * TO_MM:.4g} mm"] if robot.sheath_rigid_length else []
        words += [f"rigid from {robot.sheath_rigid_from * TO_MM:.4g} mm on"] if robot.sheath_rigid_from else []
    if room.width > SAME_AXIS:
        words.append(f"with {room.width * TO_MM:.3g} mm of room on each side")
    else:
        words.append("without room")
    spiral = f". In it the tubes can spiral by {room.turns:.2g} turns" if room.turns else ""
    return f"sheath: inner diameter {room.diameter * TO_MM:.4g} mm, {', '.join(words)}{spiral}"


def model_name(robot: Robot) -> str | None:
    """Name of the model of an eccentric robot; None for concentric robots."""
    return None if isinstance(robot, ConcentricRobot) else "energy" if isinstance(robot, BundleRobot) else "thesis"


def _channel(robot: Robot) -> float | None:
    """Diameter of the free channel, m; None for concentric robots."""
    return None if isinstance(robot, ConcentricRobot) else free_channel(robot).diameter  # type: ignore[arg-type]


def _channel_text(robot: Robot) -> str:
    """Text of the free channel; "" for concentric robots."""
    if isinstance(robot, ConcentricRobot):
        return ""
    channel = free_channel(robot)  # type: ignore[arg-type]
    where = "between the tubes" if channel.inside is None else f"in tube {channel.inside + 1}"
    return f"free channel: {channel.diameter * TO_MM:.4g} mm, {where}"


def _tubes(robot: Robot) -> list[tuple[Tube, float | None]]:
    """Tubes with their radial clearances in the next outer one, m."""
    of_tube = clearances(robot)
    return [(tube, of_tube[i][1] / TO_MM if i in of_tube else None) for i, tube in enumerate(robot.tubes)]


class RobotReport(Report[AnyRobot]):
    command = "robot show"
    quantities = ROBOT
    file = "robot.json"

    def title(self) -> str:
        return self.answer.name or "robot"

    def table(self) -> Group:
        """A row per property, a column per tube; then why the translations at home are not 0, and the warnings."""
        tubes = self.record()["tubes"]
        cells = []
        for quantity in NESTED:
            if all(tube[quantity.key] is None for tube in tubes):
                continue
            name = f"{quantity.about} ({quantity.sign})" if quantity.unit else quantity.about
            cells.append([name, *(_cell(tube[quantity.key]) for tube in tubes)])
        carriages = self.answer.home_translations * TO_MM
        cells.append(["translation at home (mm)", *(_cell(float(shift)) for shift in carriages)])
        numbers = [f"{i} >" for i in range(1, len(tubes) + 1)]
        lines = remarks(fit_warnings(self.answer), what="warning")
        properties = grid(("tube", *numbers), cells, title=self.title(), key=True)
        home = [Text(reason)] if (reason := _home_reason(self.answer)) else []
        channel = [Text(text)] if (text := _channel_text(self.answer)) else []
        buffer = [Text(text)] if (text := _buffer_text(self.answer)) else []
        sheath = [Text(text)] if (text := _sheath_text(self.answer)) else []
        model = [] if isinstance(self.answer, ConcentricRobot) else [Text(f"model: {model_text(self.answer)}")]
        return Group(
            properties, *model, *channel, *sheath, *buffer, *home, *(lines or [Text("no warnings", style="green")])
        )


def _home_reason(robot: Robot) -> str:
    """Reason why the home translations are not 0, as text; "" if they are 0."""
    if not robot.home_translations.any():
        return ""
    inside = ends_inside(robot, np.array([tube.curved_length for tube in robot.tubes]))
    if inside and robot.nested_curves:
        return f"the translations at home are not 0: at 0, {ends_text(inside)}"
    return "the translations at home are not 0: limits or order of the tubes do not allow 0"


def _cell(value: float | str | None) -> str:
    """Text of a cell; a dash for no value."""
    if value is None:
        return "–"
    return value if isinstance(value, str) else f"{value:.4g}"


NOTICED = 1e-3
"""Smallest reported loading time of a kernel, s; a process with a loaded kernel needs less."""

VERIFICATION = described(Verification, "tip_position tip_rotation rotation end_torsion end_curvature base_rotation")


def _bounds_text(u: Uncertainty, k: int) -> str:
    """Bounds at a probability in words."""
    words = [f"tip within {u.tip_radius[k] * TO_MM:.2f} mm", f"margin at least {u.margin[k]:.4f}"]
    turn = u.snap_distance[k]
    if not np.isnan(turn):
        words.append("no turn snaps" if turn == np.inf else f"no snap within {np.degrees(turn):.1f} deg")
    return f"{', '.join(words)} (estimated)"


REAL: tuple[Quantity[Uncertainty], ...] = (
    Quantity("probabilities", "probabilities of the next bounds on the real robot; these are absent without posterior",
             optional=True),
    Quantity("real_tip_half_widths_mm", "the tip is within this along x, y and z, a row for each probability",
             lambda u: u.tip_half_widths, optional=True),
    Quantity("real_tip_radius_mm", "the tip is within this distance", lambda u: u.tip_radius, optional=True),
    Quantity("real_margin", "the margin is at least this, to first order", lambda u: u.margin, optional=True),
    Quantity("real_snap_distance_deg", "all tubes can turn by at least this without a snap, to first order",
             lambda u: u.snap_distance, optional=True),
    Quantity("outside_recorded", "true if a reading is outside of the recorded ranges", lambda u: u.outside,
             optional=True, label="recorded ranges", text=lambda u: "the readings are outside" if u.outside else None),
    line("real robot, 95 %", lambda u: _bounds_text(u, 0)),
    line("real robot, 99.9 %", lambda u: _bounds_text(u, 1)),
)  # fmt: skip
"""Bounds on the real robot of a calibrated one."""


@lru_cache(maxsize=8)
def _real(e: Equilibrium) -> Uncertainty | None:
    """Bounds on the real robot; None without a posterior, with a history, and of unstable equilibria."""
    if e.robot.posterior is None or e.friction is not None or not e.stable:
        return None
    from ..validation.certainty import uncertainty  # with all of validation, which forward kinematics starts without

    return uncertainty(e)


CONTACT: tuple[Quantity[Equilibrium], ...] = (
    Quantity("clearance_mm", "smallest distance of the arm's surface from the walls; absent without walls",
             lambda e: e.walls and e.walls.clearance, optional=True),
    Quantity("contacts", "contacts with walls, base to tip; absent without walls",
             lambda e: e.walls and list(e.walls.contacts), of=described(WallForce), optional=True),
    line("contacts", lambda e: _contact_text(e)),
)  # fmt: skip
"""Contacts with walls."""


def _contact_text(e: Equilibrium) -> str | None:
    """Contacts with walls, as text; None without walls."""
    if e.walls is None:
        return None
    if not e.walls.contacts:
        return f"none; the nearest wall is {e.walls.clearance * TO_MM:.3f} mm away"
    return "\n".join(
        f"body {contact.body} at {contact.arc_length * TO_MM:.2f} mm with {contact.size * TO_MILLI:.4g} mN"
        for contact in e.walls.contacts
    )


EQUILIBRIUM = described(
    Equilibrium,
    Quantity("robot", "name of the robot", lambda e: e.robot.name),
    Quantity("model", "model of an eccentric robot: thesis or energy; absent of concentric robots",
             lambda e: model_name(e.robot), optional=True, label="model", text=lambda e: _model_of(e)),
    "rotations translations",
    *readings(lambda e: e),
    Quantity("status", "result of the solve", lambda e: e.status.name),
    Quantity("stable", "true if it is stable"),
    Quantity("tip_position_mm", "tip position in the frame of the plate", form=".4f", label="tip position"),
    Quantity("tip_tube",
             "number of the tube at the tip: the one that ends farthest from the plate, of several the innermost; "
             "null if all are withdrawn", lambda e: tip_number(e), label="the tip is",
             text=lambda e: tip_text(e.robot, e.tube_end) or None),
    Quantity("remarks", "carriages that are out of order; absent if none is",
             lambda e: order_remarks(e.robot, e.translations) or None, optional=True),
    Quantity("tip_by_history_mm",
             "largest displacement of the tip by friction along x, y and z, for any history, to first order; absent "
             "without friction", lambda e: by_history(e), optional=True),
    line("effect of friction", lambda e: _history_text(e)),
    Quantity("tip_by_clearance_mm",
             "tip position after tilting by the clearance between the tubes, to first order; absent without clearance",
             lambda e: _tilted(e, "tip_position"), optional=True),
    Quantity("tip_clearance_radius_mm",
             "largest distance of that from the tip position, estimated; a first-order bound for tubes bent in one "
             "plane; absent without clearance", lambda e: _tilted(e, "tip_radius"), optional=True),
    line("clearance", lambda e: _clearance_text(e)),
    Quantity("tip_direction", "direction of the tip", lambda e: e.tip_rotation[:, 2], form=".4f",
             label="pointing along"),
    "tip_rotations",
    of_field(Equilibrium, "margin", label="margin", text=lambda e: margin_text(e.margin)),
    *CONTACT,
    *SNAP_DISTANCE,
    *within(REAL, lambda e: _real(e)),
    "energy",
    *LOADED,
    "residual mesh_error tip_error",
    line("estimated error", "{mesh_error_rad:.1e} rad along the tubes, {tip_error_mm:.1e} mm at the tip"),
    of_field(Equilibrium, "verification", of=VERIFICATION, label="re-integration differs",
             text="{verification[tip_position_mm]:.1e} mm at the tip, {verification[rotation_rad]:.1e} rad"),
    Quantity("statistics", "method, mesh, iterations and time", lambda e: dict(vars(e.statistics)), label="solved",
             text=lambda e: _solver_text(e)),
)  # fmt: skip


def _model_of(e: Equilibrium) -> str | None:
    """Model of an equilibrium and the reason for it, as text; None for concentric robots."""
    if isinstance(e.robot, ConcentricRobot):
        return None
    return model_text(e.robot) + (", under a load" if e.load is not None else "")  # type: ignore[arg-type]


def by_history(e: Equilibrium) -> Array | None:
    """(3,) half-widths (m) of the range of tip positions under friction, to first order; None without friction."""
    friction = friction_of(e.robot)
    # A state from a path with friction has a known history; the range is for unknown histories.
    if friction is None or e.friction is not None or not e.stable:
        return None
    from ..stability import friction_band  # with all of stability, which forward kinematics starts without

    return friction_band(e, friction).tip_half_widths


def _history_text(e: Equilibrium) -> str | None:
    """Range of tip positions under friction, as text."""
    half = by_history(e)
    return None if half is None else f"within ± {millimetres(half, '.3f')} along x, y, z, to first order"


def _tilted(e: Equilibrium, name: str) -> Any:
    """Value from the clearance correction of an equilibrium; None for a robot without clearance."""
    if not isinstance(e.robot, ConcentricRobot) or not any(e.robot.clearance or ()):
        return None
    return getattr(clearance_correction(e), name)


def _clearance_text(e: Equilibrium) -> str | None:
    """Displacement of the tip by the clearance between the tubes, as text."""
    tip = _tilted(e, "tip_position")
    if tip is None:
        return None
    displacement = millimetres(tip - e.tip_position, ".3f")
    return f"tilts the tip by {displacement} to first order, at worst some {_tilted(e, 'tip_radius') * TO_MM:.3f} mm"


def _solver_text(e: Equilibrium) -> str:
    """Time, method and iterations of the solve, as text."""
    s = e.statistics
    loading = f", after {s.loading * TO_MILLI:.0f} ms to get its kernel ready" if s.loading > NOTICED else ""
    work = f"{s.method}, {counted(s.iterations, 'iteration')}"
    return f"in {s.seconds * TO_MILLI:.2f} ms by {work}, from {s.start}{loading}"


class EquilibriumReport(Report[Equilibrium]):
    command = "fk"
    quantities = EQUILIBRIUM
    drawn = (("shape", "shape.plot_shape"), ("torsion", "shape.plot_torsion"))

    def save(self, directory: Path) -> list[Path]:
        """Write result.json and arrays.npz."""
        return save_equilibrium(self.answer, directory)

    def tables(self) -> dict[str, Any]:
        return {"arm": self.answer}

    def solids(self) -> dict[str, Equilibrium]:
        return {"arm": self.answer}

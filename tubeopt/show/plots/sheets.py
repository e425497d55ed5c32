"""Sheets for the workshop, one page A4 each: setting up molds and mandrels, and heating a tube."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager

import numpy as np

from ...constants import ZERO_CELSIUS
from ...files.units import TO_MM
from ...robots.tubes import Tube
from ...shaping.clamp_body import CRUSHING, OPEN, largest_force
from ...shaping.firmware.boards import Part, cable_of, fuse_of, root_mean_square
from ...shaping.firmware.sketch_files import CHARGES
from ...shaping.heating.controller import MOST_EXCESS, wilson
from ...shaping.heating.cutout import cut_out, largest_count
from ...shaping.heating.oven import Oven, warming
from ...shaping.heating.plan import AGEING_DEGC, LEFT, SHORTEST_AGEING, HeatingPlan, LeftInMold, left_in_mold
from ...shaping.heating.rig import COUNTS, LEAD_ACID, MoldBed
from ...shaping.heating.sensors import Thermocouple
from ...shaping.heating.thermocouple import FILM
from ...shaping.materials import GLASS_MICA, MoldMaterial
from ...shaping.mold.checks import THROUGH, fit_tolerance
from ...shaping.mold.files import halves
from ...shaping.mold.gcode import (
    PER_MINUTE,
    POINT,
    REAMED,
    Stage,
    clamp_distance,
    drill_diameter,
    hole_depth,
    is_milled,
    placed_holes,
    programs,
    slot_paths,
    stages_of,
    stock_size,
)
from ...shaping.mold.groove import Arc
from ...shaping.mold.layout import Hole
from ...shaping.mold.mandrel import (
    SHANK,
    Block,
    Cylinder,
    Mandrel,
    deepest_point,
    exits_of,
    mandrel_cutter,
    mandrel_time,
    slot_depths,
    slot_wall,
)
from ...shaping.mold.mold import PARTS, Groove, Mold, clamp_corners
from ...shaping.mold.spec import MoldSpec
from ...shaping.tube_fabrication import TubeFabrication
from ..page import WIDTH
from .heating import draw_duty, draw_temperature
from .mold import (
    axis_height,
    behind_clamp,
    draw_lid,
    draw_mold,
    draw_plan,
    draw_side,
    draw_slot,
    draw_space,
    extent,
    mold_heading,
    radius_text,
    strips,
)
from .style import INK, Figure, new_figure, picture

A4 = (297.0, 210.0)
"""Width and height of a sheet, mm."""

EDGE = 12.0
"""Empty border, mm."""

ROW = 3.9
"""Distance of two rows of numbers, mm."""

BETWEEN = 10.0
"""Space between the drawings of base and lid, mm."""

TOOL_COLUMNS = 0.0, 17.0, 47.0, 57.0, 68.0, 82.0, 95.0, 104.0, 114.0, 137.0
"""Columns of the table of tools, mm."""

STEP_SIZES = 7.5, 6.8, 6.2, 5.6, 5.0
"""Sizes of the letters of the steps, points: the largest with which they fit the page."""

STEP_LETTERS, LINE_LETTERS = 78, 84
"""Letters per line of the steps, and of the lists of a heating sheet."""


@contextmanager
def _own_size() -> Iterator[None]:
    """Context in which a sheet has its own size, whatever the width of other pictures."""
    token = WIDTH.set(None)
    try:
        yield
    finally:
        WIDTH.reset(token)


def new_sheet(heading: str) -> Figure:
    """A4 page with a heading; its panels have positions of their own."""
    with _own_size():
        figure = new_figure(A4[0] / 25.4, A4[1] / 25.4, layout=None)
    write_at(figure, EDGE, A4[1] - EDGE, heading, size=13, weight="bold")
    return figure


def write_at(
    figure: Figure, x: float, y: float, text: str, *, size: float = 7.5, weight: str = "normal", color: str = INK
) -> None:
    """Write text with its upper left corner at x, y, mm."""
    # Words of a row have one baseline, 0.8 of the size below their upper edge; a point is 0.353 mm.
    several = "\n" in text
    at = y if several else y - 0.353 * 0.8 * size
    va = "top" if several else "baseline"
    figure.text(x / A4[0], at / A4[1], text, fontsize=size, fontweight=weight, va=va, ha="left", linespacing=1.35,
                color=color)  # fmt: skip


def _write_table(figure: Figure, columns: Sequence[float], top: float, *values: dict[str, str]) -> None:
    """Write a table below `top`, mm: names and the values of each tube, in columns that start at given x, mm."""
    for row, name in enumerate(values[0]):
        for x, text in zip(columns, (name, *(each[name] for each in values)), strict=True):
            write_at(figure, x, top - ROW * row, text)


def _write_tools(figure: Figure, top: float, rows: Sequence[Sequence[str]]) -> None:
    """Write the table of tools below `top`, mm."""
    for k, row in enumerate(rows):
        for x, text in zip(TOOL_COLUMNS, row, strict=True):
            write_at(figure, EDGE + x, top - ROW * k, text, weight="normal" if k else "bold")


def write_steps(figure: Figure, x: float, top: float, steps: Sequence[str], remarks: Sequence[str]) -> None:
    """Write numbered steps, and the remarks below them."""
    marked = [*((f"{k}.", step) for k, step in enumerate(steps, start=1)), *(("!", remark) for remark in remarks)]
    for size in STEP_SIZES:
        letters = int(STEP_LETTERS * STEP_SIZES[0] / size)
        lines = [f"{mark}  {textwrap.fill(text, letters, subsequent_indent='      ')}" for mark, text in marked]
        # A point is 0.353 mm, a line 1.35 of its size.
        if "\n".join(lines).count("\n") * 0.353 * 1.45 * size < top - EDGE:
            break
    write_at(figure, x, top, "\n".join(lines), size=size)


SCALES = (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 10.0)
"""Reductions of the drawing of a mold."""

MAX_COLUMNS = 3
"""Largest number of tubes in the table of a mold."""


@picture
def plot_setup_sheet(part: Mold | Mandrel, *, title: str = "") -> Figure:
    """Set-up sheet for the workshop: one page A4 with drawings, a table of numbers, and the steps."""
    from matplotlib.path import Path as MplPath

    if isinstance(part, Mandrel):
        figure = new_sheet(f"Set-up sheet: {title or f'mandrel of tube {part.number}'}")
        draw_space(figure.add_axes((0.03, 0.5, 0.42, 0.42), projection="3d"), part)
        draw_plan(figure.add_axes((0.55, 0.56, 0.4, 0.34)), part)
        top = 0.46 * A4[1]
        facts = mandrel_numbers(part)
        _write_table(figure, (EDGE, 95.0), top, facts)
        if isinstance(part.body, Cylinder):
            minutes = f"{math.ceil(mandrel_time(part) / 60)}"
            rows = (TOOL_HEADING, _tool_row("mandrel.nc", mandrel_cutter(part), part.width, minutes))
            _write_tools(figure, top - (len(facts) + 1) * ROW, rows)
        elif part.body.slot > part.width:
            write_at(figure, EDGE, 54.0, "section of the slot, the tube on its floor (mm)", weight="bold")
            draw_slot(figure.add_axes((EDGE / A4[0], 0.05, 60.0 / A4[0], 38.0 / A4[1])), part)
        write_steps(figure, 150.0, top, mandrel_steps(part), part.remarks)
        return figure
    figure = new_sheet(f"Set-up sheet{': ' + title if title else ''}")
    shown, tools = part.grooves[:MAX_COLUMNS], tool_rows(part)
    tables = [groove_numbers(groove, part) for groove in shown]
    low, high = extent(part)
    plate = np.array(part.size) * TO_MM
    # Base and lid side by side; what the tables need is below them.
    sizes = np.array([high[0] - low[0] + plate[0], max(high[1] - low[1], plate[1])])
    below = EDGE + 1.5 * ROW + ROW * (len(tables[0]) + len(tools) + 3)
    available = np.array([A4[0] - 2 * EDGE - BETWEEN, A4[1] - EDGE - 16 - below])
    # A round reduction, so that lengths can be measured on the sheet.
    fitting = [scale for scale in SCALES if (sizes <= available * scale).all()]
    scale = fitting[0] if fitting else SCALES[-1]
    (wide, tall), base = (high - low) / scale, EDGE - low[0] / scale
    # Heights of the lower edges of both plates are the same.
    bottom = A4[1] - EDGE - 13 - tall
    axes = figure.add_axes((EDGE / A4[0], bottom / A4[1], wide / A4[0], tall / A4[1]))
    draw_mold(axes, part)
    axes.set_axis_off()
    left, foot = EDGE + wide + BETWEEN, bottom - low[1] / scale
    lid = figure.add_axes((left / A4[0], foot / A4[1], plate[0] / scale / A4[0], plate[1] / scale / A4[1]))
    draw_lid(lid, part)
    lid.set_axis_off()
    # A clamp may cover the place to the left of the corner.
    place = np.array([(x, y) for x in (-2.5, -1.5, -0.5) for y in (-2.5, -1.0, 0.5)]) * scale / TO_MM
    clamps = [clamp for groove in part.grooves for clamp in groove.clamps]
    covered = any(MplPath(clamp_corners(clamp, part.spec.clamps)).contains_points(place).any() for clamp in clamps)
    at_base = (base + 3.5, foot - 0.5) if covered else (base - 2.6, foot + 1.0)
    for x, y in (at_base, (left - 2.6, foot + 1.0)):
        write_at(figure, x, y, "0", size=9, weight="bold")
    turned = "lower face up as milled, turned over about its left edge" if part.slots else "from above"
    write_at(
        figure,
        EDGE,
        A4[1] - EDGE - 6,
        f"{mold_heading(part)}, drawn 1:{scale:g}. 0: zero of X and Y, Z = 0 on the face.",
    )
    head = foot + plate[1] / scale + 4.5
    write_at(figure, base, head, "base, from above", weight="bold")
    write_at(figure, left, head, f"lid, {turned}", weight="bold")
    marks = (
        "White: bolts; dark: dowels" if part.hinge is None else "White: latches; dark: screws of hinges; dashed: cut"
    )
    key = f"{marks}; ringed: vents of the lid; coloured: its slots; grey: clamps, with an arrow where one slides."
    write_at(figure, EDGE, EDGE + 3, key)
    top = bottom - 3
    columns = [EDGE, *(EDGE + 52.0 + 30.0 * k for k in range(len(shown)))]
    for x, heading in zip(columns, ("mm, tubes cold", *(f"tube {groove.number}" for groove in shown)), strict=True):
        write_at(figure, x, top, heading, weight="bold")
    _write_table(figure, columns, top - ROW, *tables)
    if len(part.grooves) == 1 and part.spec.material.electrically_insulating:
        x, y = columns[1] + 28.0, top - 66.0
        write_at(figure, x, top, "from the side, mold shortened", weight="bold")
        draw_side(figure.add_axes((x / A4[0], y / A4[1], 62.0 / A4[0], 62.0 / A4[1])), part)
    lowest = top - (len(tables[0]) + 1.6) * ROW
    if len(part.grooves) > len(shown):
        numbers = ", ".join(str(groove.number) for groove in part.grooves[len(shown) :])
        write_at(figure, columns[0], lowest + 0.7 * ROW, f"tubes {numbers}: see mold.json")
    _write_tools(figure, lowest, tools)
    write_steps(figure, 158.0, top, mold_steps(part), part.remarks)
    if any(remark.startswith("do not") for remark in part.remarks):
        write_at(figure, 190.0, A4[1] - EDGE, "DO NOT USE IT: see the lines with !", size=11, weight="bold", color=STOP)
    return figure


HOLE_COLUMNS = 0.0, 7.0, 18.0, 29.0, 38.0, 46.0, 56.0
"""Columns of a table of holes, mm."""

TABLE_WIDTH = 91.0
"""Distance of two tables of holes, mm."""

HOLE_SIZES = 7.0, 6.0, 5.0, 4.0, 3.0
"""Sizes of the letters of tables of holes, points: the largest with which they fit the page."""


@picture
def plot_hole_sheet(mold: Mold, *, part: str, title: str = "") -> Figure:
    """Drawing of a plate, "base" or "lid", as it lies on the machine, with its holes, grooves and slots in numbers."""
    of_robot, paths = f"{title}, " if title else "", path_rows(mold, part)
    cut = "" if not paths else " and grooves" if part == "base" else " and slots"
    figure = new_sheet(f"Holes{cut}: {of_robot}{part}")
    zero = "Zero of X and Y in corner 0, Z = 0 on the upper face as it lies, mm"
    if part == "lid" and mold.slots:
        zero += "; lower face up, turned over about its left edge: corner 0 is the lower right one of the closed mold"
    write_at(figure, EDGE, A4[1] - EDGE - 6, mold_heading(mold))
    plate, rows = np.array(mold.size) * TO_MM, hole_rows(mold, part)
    available = np.array([A4[0] - 2 * EDGE - 8, 0.36 * A4[1]])
    scale = next((scale for scale in SCALES if (plate <= available * scale).all()), SCALES[-1])
    wide, tall = plate / scale
    bottom = A4[1] - EDGE - 14 - tall
    axes = figure.add_axes(((EDGE + 4) / A4[0], bottom / A4[1], wide / A4[0], tall / A4[1]))
    if part == "base":
        draw_mold(axes, mold, clamps=False)
    else:
        draw_lid(axes, mold)
    axes.set_axis_off()
    write_at(figure, EDGE, bottom + 1.0, "0", size=9, weight="bold")
    write_at(figure, EDGE, A4[1] - EDGE - 9.5, f"{zero}. Drawn 1:{scale:g}, numbers as in the table.")
    for k, hole in enumerate(ordered_holes(mold, part), start=1):
        x, y = (np.array(hole.centre) + 0.4 * hole.diameter) * TO_MM
        axes.text(x, y, str(k), fontsize=5, ha="left", va="bottom")
    top = bottom - 4
    notes = hole_notes(mold, part)
    for size in HOLE_SIZES:
        step = 0.353 * 1.45 * size
        length = int((top - EDGE - step * (len(notes) + 1)) / step) - 1
        if length > 0 and len(rows) + len(paths) + 2 <= length * 3:
            break
    lines = [*rows, *(((), *paths) if paths else ())]
    for k in range(0, len(lines), length):
        column = EDGE + TABLE_WIDTH * (k // length)
        for j, row in enumerate([HOLE_HEADING, *lines[k : k + length]]):
            for x, text in zip(HOLE_COLUMNS, row, strict=False):
                write_at(figure, column + x * size / HOLE_SIZES[0], top - step * j, text, size=size,
                       weight="normal" if j else "bold")  # fmt: skip
    for k, note in enumerate(notes):
        write_at(figure, EDGE, EDGE + step * (len(notes) - k), note, size=size)
    return figure


HOLE_HEADING = ("no.", "X", "Y", "diam.", "fit", "Z", "purpose, tool")
"""Heading of a table of holes: Z at the point of the tool."""

FITS = {"bolt": "+0.2", "vent": "+0.1", "wire": "+0.1", "hinge": "+0.1", "latch": "+0.2"}
"""Tolerances of diameters above nominal, mm; a dowel has one for each plate."""

DOWEL_FITS = {"base": "H7", "lid": "F7"}
"""Fits of the holes of dowels: pins stay in the base, and the lid slides."""


def ordered_holes(mold: Mold, part: str) -> list[Hole]:
    """Holes of a plate as it lies on the machine: by drill, then from left to right."""
    return sorted(placed_holes(mold, part), key=lambda hole: (drill_diameter(hole), hole.purpose, hole.centre))


def hole_rows(mold: Mold, part: str) -> list[tuple[str, ...]]:
    """Rows of the table of holes of a plate, as it lies on the machine, mm."""
    plate = mold.spec.plate
    thickness = plate.thickness if part == "base" else plate.lid_thickness
    rows: list[tuple[str, ...]] = []
    for k, hole in enumerate(ordered_holes(mold, part), start=1):
        drill = drill_diameter(hole)
        tool = f"{hole.purpose}, drill {drill * TO_MM:g}"
        if is_milled(hole, mold.spec):
            tool = f"{hole.purpose}, end mill {mold.spec.workshop.outline_diameter * TO_MM:g}"
        if hole.purpose == "dowel":
            tool += f", ream {hole.diameter * TO_MM:g}"
        # Heads are in the lower faces of lid and base: on the strip between base and leaf there is none.
        if hole.purpose == "hinge" and mold.hinge:
            headless = part == "lid" and hole.centre[1] > mold.hinge.pin
            tool += ", no countersink" if headless else f", sunk {countersink_text(hole.diameter)}, lower face"
        x, y = (f"{value * TO_MM:.2f}" for value in hole.centre)
        fit = FITS.get(hole.purpose, DOWEL_FITS[part])
        rows.append(
            (
                str(k),
                x,
                y,
                f"{hole.diameter * TO_MM:g}",
                fit,
                f"-{hole_depth(hole, thickness, mold.spec) * TO_MM:.4g}",
                tool,
            )
        )
    return rows


def path_rows(mold: Mold, part: str) -> list[tuple[str, ...]]:
    """Rows of a table of centrelines as a plate lies: of the grooves of the base, of the slots of the lid; mm."""
    rows: list[tuple[str, ...]] = []
    slots = iter(slot_paths(mold))
    for groove in mold.grooves:
        if part == "base":
            width, depth = (f"{size * TO_MM:.3f}" for size in (groove.width, groove.depth))
            tolerance = f"both ±{fit_tolerance(mold.spec) * TO_MM:.3f}"
            rows.append((f"groove of tube {groove.number}: {width} wide, {depth} deep, {tolerance}, centreline:",))
            pieces: Sequence[Arc] = groove.centreline.pieces
        elif groove.slot is None:
            continue
        else:
            pieces, slot = next(slots), groove.slot
            sizes = f"{slot.mill.diameter * TO_MM:g} wide, {slot.depth * TO_MM:g} deep (+{SLOT_FIT:g})"
            rows.append((f"slot over tube {groove.number} for the thermocouple: {sizes}, centreline:",))
        for k, piece in enumerate(pieces):
            (x0, y0), (x1, y1) = ((x * TO_MM, y * TO_MM) for x, y in (piece.start, piece.end))
            text = f"line ({x0:.2f}, {y0:.2f}) to ({x1:.2f}, {y1:.2f})"
            if piece.curvature:
                x, y = (value * TO_MM for value in piece.centre)
                start = f"from ({x0:.2f}, {y0:.2f}) " if k == 0 else ""
                text = f"arc {start}to ({x1:.2f}, {y1:.2f}), R {piece.radius * TO_MM:.3f}, centre ({x:.2f}, {y:.2f})"
            rows.append(("", text))
    if part == "lid" and mold.hinge:
        low, high = (edge * TO_MM for edge in (halves(mold)[0][1], halves(mold)[1][0]))
        rows.append((f"cut between lid and strip: Y {low:.2f} to {high:.2f}, through",))
    return rows


SLOT_FIT = 0.1
"""Tolerance of width and depth of a slot above nominal, mm: cement fills it."""


def countersink_text(hole: float) -> str:
    """Countersink for the head of a screw in a hole of this diameter (m), as text."""
    return f"90° to {2 * hole * TO_MM:g}, {hole / 2 * TO_MM:g} deep"


def zero_text(mold: Mold, part: str) -> str:
    """Position of corner 0 on the stock, as text."""
    if not mold.spec.workshop.cut_out:
        return "Corner 0 is the lower left corner of the plate, which is cut to size before"
    beside = [0.5 * (s - size) * TO_MM for s, size in zip(stock_size(mold, part), mold.size, strict=False)]
    return (
        f"Corner 0: square the stock to X. Its left edge is at X = {-beside[0]:g}, its lower edge at Y = "
        f"{-beside[1]:g}, and further out by what clamps hold there"
    )


def hole_notes(mold: Mold, part: str) -> list[str]:
    """Notes below a table of holes."""
    notes = [
        f"{zero_text(mold, part)}.",
        "All holes go through; Z is at the point of the tool, which runs into the waste board. Diameters as in the "
        "table; the rest ISO 2768-m.",
        "Positions: bolts, vents, wires, hinges, latches ± 0.1 mm"
        + (
            "; dowels ± 0.1 mm too, but the same distance in base and lid within 0.02 mm. On a coarser machine clamp "
            "the lid on the base, and drill and ream both at once."
            if mold.hinge is None
            else "."
        ),
    ]
    if mold.hinge is not None:
        notes.append(
            "Countersinks for the heads of the hinges' screws, by hand: no program cuts them."
            + (" Dashed: the cut of the lid above." if part == "base" else "")
        )
    return notes


def groove_numbers(groove: Groove, mold: Mold) -> dict[str, str]:
    """Table of one groove for the workshop; mm and deg."""
    tube, back = groove.tube, mold.spec.springback
    lost = 1 - abs(tube.curvature / groove.curvature) if groove.curvature else 0.0
    end, travel = groove.before_bend + groove.bend_length, max(clamp.travel for clamp in groove.clamps)
    tolerance = fit_tolerance(mold.spec)
    # Without the tolerance, a depth of whole steps would take one pass more by round-off.
    passes = math.ceil(groove.depth / mold.spec.milling.step_down - 1e-9)
    return {
        "tube, outer / inner diameter": f"{tube.outer_diameter * TO_MM:.3f} / {tube.inner_diameter * TO_MM:.3f}",
        "required radius": radius_text(tube, ".2f"),
        "mold radius": radius_text(groove.held, ".3f"),
        "spring-back of the curvature": f"{100 * (1 - back.obtained(1.0) if back.slope == 0 else lost):.2f} %",
        "bend, length / angle": f"{groove.bend_length * TO_MM:.2f} / {math.degrees(groove.bend_angle):.2f}°",
        "groove, width / depth": f"{groove.width * TO_MM:.3f} / {groove.depth * TO_MM:.3f}",
        "limits of its width": _limits_text(groove.width, tolerance),
        "limits of its depth": _limits_text(groove.depth, tolerance),
        "mean radius by the tube's play": play_text(groove, tolerance),
        "radius that comes out (95 %)": coming_text(groove, mold),
        "end mill / passes": f"{groove.mill.diameter * TO_MM:g} / {passes} × {len(groove.cutter_offsets)}",
        "slot in the lid, width / depth / length": "none"
        if groove.slot is None
        else f"{groove.slot.mill.diameter * TO_MM:g} / {groove.slot.depth * TO_MM:g} / "
        f"{groove.slot.centreline.length * TO_MM:.1f}",
        "strain when pressed in": f"{groove.strain * 100:.2f} %",
        "cut the tube to": f"{groove.stock_length * TO_MM:.1f}",
        "mark: bend begins at / ends at": f"{groove.before_bend * TO_MM:.1f} / {end * TO_MM:.1f}",
        "plate to clamp, proximal / distal": f"{groove.gaps[0] * TO_MM:.1f} / {groove.gaps[1] * TO_MM:.1f}",
        "tube behind the proximal clamp": f"{behind_clamp(groove) * TO_MM:.1f}",
        "cold end from the clamp": f"{groove.cold.length * TO_MM:.1f}",
        "growth / travel of the sliding clamp": f"{groove.growth * TO_MM:.2f} / {travel * TO_MM:.1f}",
        "trim, proximal / distal": f"{groove.trim[0] * TO_MM:.1f} / {groove.trim[1] * TO_MM:.1f}",
    }


def coming_text(groove: Groove, mold: Mold) -> str:
    """95 % interval of the radius (mm) of the tube by the trials of the spring-back, as text."""
    interval = mold.spec.springback.interval(groove.curvature)
    if interval is None or not groove.curvature:
        return "no trials" if groove.curvature else "straight"
    low, high = interval
    return f"{TO_MM / high:.2f} to {TO_MM / low:.2f}" if low > 0 else f"above {TO_MM / high:.2f}"


def _limits_text(size: float, tolerance: float) -> str:
    """Limits (mm) of a size with a tolerance to both sides, m, as text."""
    return f"{(size - tolerance) * TO_MM:.3f} to {(size + tolerance) * TO_MM:.3f}"


def play_text(groove: Groove, tolerance: float) -> str:
    """Smallest and largest mean radius (mm) of a tube that uses its play, as text; tolerance: of the width, m."""
    curvature, change = abs(groove.curvature), groove.curvature_play(tolerance)
    if curvature <= change:
        return "more than the bend"
    return f"{TO_MM / (curvature + change):.1f} to {TO_MM / (curvature - change):.1f}"


def tool_rows(mold: Mold) -> list[tuple[str, ...]]:
    """Rows of the table of tools, with a heading, for all programs of both plates."""
    rows: list[tuple[str, ...]] = [TOOL_HEADING]
    for part in PARTS:
        files, stages = programs(mold, part), stages_of(mold, part)
        for k, stage in enumerate(stages):
            # With a touch plate, all tools are in one program.
            each, own = files[min(k, len(files) - 1)], len(files) == len(stages)
            minutes = f"{math.ceil(each.time / 60)}" if own or k == 0 else '"'
            rows.append(_tool_row(each.file, stage, stage.depth, minutes))
    return rows


TOOL_HEADING = ("program", "tool", "rpm", "m/min", "mm/min", "plunge", "step", "depth", "flute length", "min")
"""Heading of the table of tools: cutting speed in m/min, feeds in mm/min, largest step, depth and least length of the
flutes in mm.
"""


def _tool_row(file: str, stage: Stage, depth: float, minutes: str) -> tuple[str, ...]:
    """Row of the table of tools; depth: of the deepest cut, m."""
    feed, plunge = (f"{value * TO_MM * PER_MINUTE:.0f}" for value in (stage.feed, stage.plunge))
    return (
        file, stage.tool, f"{stage.spindle * PER_MINUTE:.0f}", f"{stage.cutting_speed * PER_MINUTE:.1f}", feed,
        "-" if stage.tool.startswith("drill") else plunge, f"{stage.step * TO_MM:g}", f"{depth * TO_MM:.4g}",
        f"{math.ceil(depth * TO_MM + 0.5)}", minutes,
    )  # fmt: skip


THREADS = {2.2: 2.0, 2.7: 2.5, 3.2: 3.0, 4.3: 4.0, 5.3: 5.0, 6.4: 6.0, 8.4: 8.0, 10.5: 10.0, 13.0: 12.0}
"""Fine clearance hole and nominal diameter of metric threads, mm (ISO 273, from memory)."""

SCREW_LENGTHS = (*range(4, 11, 2), 12, 16, *range(20, 71, 5), *range(80, 201, 10))
"""Lengths of screws, mm (ISO 4017, from memory)."""

PIN_LENGTHS = (*range(4, 33, 2), *range(35, 101, 5))
"""Lengths of dowel pins, mm (ISO 2338, from memory)."""

LEAF = 1.0
"""Thickness of a leaf of a hinge, mm (assumed)."""


CORE_PLAY = 0.05e-3
"""Play of a core wire in the bore of a tube, m (assumed)."""

WASHER = 1.5
"""Thickness of a slotted washer, mm: steel then bends by less than 50 MPa over the hole of a latch at the torque of a
board."""

BEARING = 2e6
"""Largest pressure of a washer on a board, Pa (assumed: boards are crushed by several MPa)."""

HELD_HEAD = "a drop of ceramic cement that keeps it from turning and falling"

WASHERS = f"flat washers (ISO 7089) under head and nut; on each head {HELD_HEAD}"

THREAD_STRESS = 200e6
"""Largest stress in a thread on plates of metal, Pa: a third of the yield point of class 8.8."""


def thread_of(hole: float) -> float:
    """Nominal diameter (m) of the thread for a clearance hole, m."""
    return max((size for least, size in THREADS.items() if least <= hole * TO_MM + 1e-9), default=hole * TO_MM) / TO_MM


def screw_text(hole: float, grip: float) -> str:
    """Screw of a clearance hole with the next length for plates of `grip`, as text; m.

    Nut and two washers with two turns beyond take 1.7 diameters.
    """
    nominal = thread_of(hole) * TO_MM
    length = next((each for each in SCREW_LENGTHS if each >= grip * TO_MM + 1.7 * nominal), SCREW_LENGTHS[-1])
    return f"M{nominal:g} × {length}"


def torque_of(hole: float, material: MoldMaterial) -> float:
    """Largest tightening torque (N m) of the screw of a clearance hole (m), with flat washers on both plates.

    Friction of thread and nut: T = 0.2 F d. A washer is twice as wide as its screw (ISO 7089, about).
    """
    nominal = thread_of(hole)
    force = THREAD_STRESS * 0.72 * math.pi / 4 * nominal**2  # the core of a coarse thread is 0.72 of its circle
    if material.electrically_insulating:
        force = min(force, BEARING * math.pi / 4 * ((2 * nominal) ** 2 - hole**2))
    return 0.2 * force * nominal


def torque_text(hole: float, material: MoldMaterial) -> str:
    """Torque of the screw of a clearance hole (m), as text."""
    torque = f"at most {torque_of(hole, material):.1g} N m"
    return f"finger-tight ({torque}: more crushes the board)" if material.electrically_insulating else torque


def mold_steps(mold: Mold) -> list[str]:
    """Steps, as text, from the stock to the finished tube."""
    spec = mold.spec
    heat, clamps, shop = spec.heat, spec.clamps, spec.workshop
    degrees = heat.set_temperature - ZERO_CELSIUS
    fixed = "distal" if clamps.sliding_end == "proximal" else "proximal"
    widening = f", then widens at 45° to {clamps.width * TO_MM:g} mm" if clamps.width > clamps.face_width else ""
    return [
        f"Stock, at least: base {_stock_text(mold, 'base')}, lid {_stock_text(mold, 'lid')} mm (base.dxf, "
        "lid.dxf: from above, closed). "
        f"Add what the clamps hold: they stay {math.ceil(clamp_distance(mold) * TO_MM)} mm or more from the plate. "
        f"Waste board {_waste_board(mold):g} mm. Each face flat within "
        f"{FLAT_SHARE * least_play(mold) * TO_MM:.2g} mm, both together less than the tube's least play over its "
        f"height ({least_play(mold) * TO_MM:.2g} mm); thickness up to +{THROUGH * TO_MM:g} mm; "
        f"{_path_text(spec)}; the rest ISO 2768-m.",
        "Positions, depths and fits of holes, grooves and slots: base_holes.pdf, lid_holes.pdf.",
        f"{zero_text(mold, 'base')}.",
        f"Programs of the table in its order (for {spec.workshop.dialect}), Z = 0 on the upper "
        f"face with each tool. {cooling_text(spec.material)}.{_router_text(mold)} Break the edges of grooves and "
        "holes by hand"
        + (f"; cut the tabs ({shop.tab_height * TO_MM:g} mm) and file them flush." if shop.cut_out else "."),
        "Cut a test groove: the programs aim at the middle of the limits of width and depth. A cutter under size makes "
        "the groove narrower by as much. Outside the limits take another one; for the depth correct Z = 0.",
        f"{_fasteners(mold)}."
        + (f" {len(mold.vents)} vents of {spec.vents.diameter * TO_MM:g} mm in the lid." if mold.vents else ""),
        *_slot_steps(mold),
        *_hinge_steps(mold),
        "Cut the tube and mark the bend. Press it into the groove, marks on the ends of the bend; "
        + ("lid down, washers in, nuts on." if mold.hinge else "dowels, lid, bolts."),
        *(
            (
                f"Clamps at the distances of the table from the plate, {clamps.grip * TO_MM:g} mm of tube in each. "
                f"Their face is {clamps.face_width * TO_MM:g} mm wide{widening}. {_jaws_text(mold)} The {fixed} one is "
                f"fixed; the {clamps.sliding_end} one must slide outwards by the travel in the table, or the hot tube "
                "buckles.",
                f"Heat the bend to {degrees:.0f} ± {heat.tolerance:.0f} °C for {heat.hold_time:g} s, then quench in "
                f"water: {opening_text(mold)}, tube out by "
                "tongs. Until then it cools slowly; the heating sheet has the temperatures.",
            )
            if spec.material.electrically_insulating
            else (
                f"No clamps and no current: this mold conducts. The tube, free to grow at both ends, at {degrees:.0f} "
                f"± {heat.tolerance:.0f} °C for {heat.hold_time:g} s in an oven; `tubeopt heat oven` has the soak "
                "time, the quench, and the radius of the groove for the hot mold.",
            )
        ),
        "Trim the ends. Scan the tube: `tubeopt mold measure SCAN.png`, then `tubeopt mold calibrate TRIALS.csv`.",
    ]


FLAT_SHARE = 0.4
"""Allowed unevenness of each of two faces, as a fraction of the least play of a tube between them."""

PATH_SHARE, ROUTER = 0.6, 0.03e-3
"""Allowed deviation of a machine from its path, as a fraction of the tolerance of a groove; and that of routers, m."""


def least_play(mold: Mold) -> float:
    """Least play (m) of the tubes over the depth of their grooves, at the lower limits of these."""
    return min(g.depth - fit_tolerance(mold.spec) - g.tube.outer_diameter for g in mold.grooves)


def _path_text(spec: MoldSpec) -> str:
    """Tolerance of the cutter's path, as text."""
    allowed = PATH_SHARE * fit_tolerance(spec)
    if allowed < ROUTER:
        return f"grooves as in a test cut, corrected by the cutter's offset: routers keep {ROUTER * TO_MM:g} mm only"
    return f"cutter's path within {allowed * TO_MM:.2g} mm"


def _jaws_text(mold: Mold) -> str:
    """Jaws of the clamps, height of the tube above the support, and what sticks out behind them, as text."""
    groove = mold.grooves[0]
    diameter, behind = groove.tube.outer_diameter, behind_clamp(groove)
    bore = (groove.tube.inner_diameter - CORE_PLAY) * TO_MM
    force = largest_force(groove.tube, groove.grip)
    through = (
        f" {behind * TO_MM:.0f} mm of tube stick out behind the proximal clamp: a through hole, and a "
        "sleeve over the live tube."
        if behind
        else ""
    )
    pressure = force / (diameter * groove.grip)
    below = (mold.spec.plate.thickness - axis_height(mold)) * TO_MM
    core = (
        f" A steel core wire of {bore:.2f} mm in each end keeps the bore round if a screw is too tight; it ends at the "
        "clamp's face, or it carries current."
        if bore > 0
        else ""
    )
    return (
        f"Jaws: two halves with a round groove of {diameter * TO_MM:g} mm, "
        f"{(0.5 * diameter - OPEN) * TO_MM:.2f} deep in each: closed, they are {2 * OPEN * TO_MM:g} mm apart; flat "
        "jaws crush the tube. `tubeopt fabricate` draws clamps (clamps.pdf). Their axis is "
        f"{below:.2f} mm below the upper face of the base: measure the plate; nominally "
        f"{axis_height(mold) * TO_MM:.2f} mm above its lower face. The base lies on strips of "
        f"{strips(mold):g} mm, clear of the bolts' heads. Supports insulate: the mold's board. "
        f"Press by at most {force:.0f} N (a screw gives T / (0.2 d)). "
        f"That is {pressure / 1e6:.0f} MPa on the tube, {CRUSHING / 1e6:.0f} MPa in its wall.{core}{through}"
    )


def opening_text(mold: Mold) -> str:
    """Steps that open the mold after the hold, as text: first the current is off."""
    opened = (
        "half a turn of each nut, washers out, lid up, clamps off" if mold.hinge else "clamps and bolts off, lid off"
    )
    return f"main switch off, {opened}"


def cooling_text(material: MoldMaterial) -> str:
    """Cooling of the tools in a material, as text."""
    if material.cutting_speed is None:
        return "Cut dry, with an extractor and an FFP3 mask"
    return f"Cut wet, at {material.cutting_speed * PER_MINUTE:g} m/min at most"


def _router_text(mold: Mold) -> str:
    """Cutting data of drills for a router that cannot turn as slowly as the programs say, as text."""
    drills = [stage for part in PARTS for stage in stages_of(mold, part) if stage.tool.startswith("drill")]
    slow = [drill for drill in drills if drill.spindle * PER_MINUTE < ROUTER_RPM]
    if not slow:
        return ""
    widest, fastest = max(drill.diameter for drill in slow), mold.spec.material.cutting_speed
    if fastest is not None and math.pi * widest * ROUTER_RPM / PER_MINUTE > fastest:
        return f" A router that turns at {ROUTER_RPM} rpm or more cannot drill this material: use a drill press."
    # The feed per turn is the same.
    feeds: dict[str, list[str]] = {}
    for drill in slow:
        feed = f"{drill.feed / drill.spindle * TO_MM * ROUTER_RPM:.0f}"
        of_feed, size = feeds.setdefault(feed, []), f"{drill.diameter * TO_MM:g}"
        of_feed += [] if size in of_feed else [size]
    words = ", ".join(f"F{feed} (drill {', '.join(sizes)})" for feed, sizes in feeds.items())
    return (
        f" A router that turns at {ROUTER_RPM} rpm at least: S{ROUTER_RPM} in programs of drills, and for the same "
        f"feed per turn {words}."
    )


ROUTER_RPM = 8000
"""Least speed of common routers, rpm."""


def _waste_board(mold: Mold) -> int:
    """Least thickness (mm) of the waste board: 1 mm more than tools reach into it."""
    holes = (hole for hole in (*mold.base_holes, *mold.lid_holes) if not is_milled(hole, mold.spec))
    widest = max((drill_diameter(hole) for hole in holes), default=0.0)
    return math.ceil((THROUGH + POINT * widest) * TO_MM + 1)


def _stock_text(mold: Mold, part: str) -> str:
    """Width, height and thickness of a plate's stock, mm, as text."""
    return " × ".join(f"{side * TO_MM:g}" for side in stock_size(mold, part))


def _fasteners(mold: Mold) -> str:
    """Number, size and length of bolts and dowels, or of hinges and latches, with their fits, as text."""
    plate, hinge = mold.spec.plate, mold.hinge
    grip = plate.thickness + plate.lid_thickness
    bolt = screw_text(plate.bolt_diameter, grip)
    if hinge is None:
        bolts, pin = sum(hole.purpose == "bolt" for hole in mold.holes), plate.dowel_diameter * TO_MM
        length = max((each for each in PIN_LENGTHS if each <= grip * TO_MM), default=PIN_LENGTHS[0])
        return (
            f"{bolts} bolts {bolt}, nuts on top, holes {plate.bolt_diameter * TO_MM:g} mm; "
            f"{WASHERS}, "
            f"{torque_text(plate.bolt_diameter, mold.spec.material)}. 2 dowels {pin:g} m6 × "
            f"{length}: drilled {pin - REAMED * TO_MM:g} mm, reamed {pin:g} {DOWEL_FITS['base']} in the base (pins "
            f"stay: cement them) and {pin:g} {DOWEL_FITS['lid']} in the lid (it slides)"
        )
    screw = mold.spec.hinge.screw_diameter
    leaf = LEAF / TO_MM
    return (
        f"{len(hinge.on_lid) // 2} hinges: {len(hinge.on_lid)} screws {screw_text(screw, plate.lid_thickness + leaf)} "
        f"in the lid, {len(hinge.on_strip)} screws {screw_text(screw, grip + leaf)} through strip and base, "
        f"countersunk {countersink_text(screw)}. Heads in the lower faces of lid and base, "
        f"{torque_text(screw, mold.spec.material)}. {len(hinge.latches)} latches: "
        f"bolts {bolt}, holes {plate.bolt_diameter * TO_MM:g} mm, "
        f"in the lid {mold.spec.hinge.latch_diameter * TO_MM:g} mm"
    )


def _hinge_steps(mold: Mold) -> list[str]:
    """Step, as text, that mounts hinges and latches; empty for a bolted lid."""
    if mold.hinge is None:
        return []
    spec, bolt = mold.spec.hinge, mold.spec.plate.bolt_diameter
    return [
        "Hinges: the strip cut off the lid stays on the base. One leaf on it, one on the lid, pin over the cut, screws "
        f"{spec.screw_distance * TO_MM:g} mm apart and {spec.reach * TO_MM:g} mm from the pin, heads below, nuts on "
        "the leaves. Latches: bolts from below through the base, a flat washer (ISO 7089) under each head. On "
        f"each head {HELD_HEAD}. On the lid a slotted washer of at least "
        f"{1.6e3 * spec.latch_diameter:.0f} mm, {WASHER:g} mm thick, slot {bolt * TO_MM:g} mm, and a nut, "
        f"{torque_text(bolt, mold.spec.material)}. Nuts pass through the holes of the lid.",
    ]


def _slot_steps(mold: Mold) -> list[str]:
    """Step, as text, that places the thermocouple in its slot; empty without a slot."""
    if not mold.slots:
        return []
    slot, wire = mold.slots[0], mold.spec.slot.wire * TO_MM
    width, depth, length = (x * TO_MM for x in (slot.mill.diameter, slot.depth, slot.centreline.length))
    return [
        f"Mill the lid with its lower face up, as drawn (mirrored programs): its zero is the lower right corner of the "
        f"closed mold. A thermocouple of {wire:g} mm goes into its slot: junction in the middle, butt-welded since no "
        "bead fits, a leg to each side, out by the holes at its ends. Cement (ceramic) the junction and 3 mm of each "
        f"leg, and fix the legs in the slot at its ends, all at least {FILM * TO_MM:g} mm below the face. "
        f"A strip of mica over them, {FILM * TO_MM:g} × {width:g} × {length:.1f} mm, lies in the slot: wire and mica "
        f"are {FILM * TO_MM + wire:.2f} mm of {depth:.2f}. Nothing may stand above the face (straight edge): the "
        "tube would jam. Bare legs are at its voltage where they touch it.",
    ]


def mandrel_numbers(mandrel: Mandrel) -> dict[str, str]:
    """Table of a mandrel for the workshop; mm."""
    body, tube, held, fit = mandrel.body, mandrel.tube, mandrel.held, mandrel.spec.groove
    numbers = {"tube, outer / inner diameter": f"{tube.outer_diameter * TO_MM:.3f} / {tube.inner_diameter * TO_MM:.3f}"}
    if isinstance(body, Cylinder):
        helix = f"{body.helix_radius * TO_MM:.3f} / {body.pitch * TO_MM:.3f}, {body.handed}-handed"
        numbers["cylinder, diameter / length"] = f"{2 * body.radius * TO_MM:.3f} / {body.length * TO_MM:.1f}"
        numbers["helix, radius / pitch"] = helix
        # A helix of radius r and advance c per rad has the radius (r^2 + c^2) / r.
        off = fit.clearance
        radii = (r + body.advance**2 / r for r in (body.helix_radius - off, body.helix_radius + off))
        low, high = sorted(radius * TO_MM for radius in radii)
        numbers[f"radius in a groove {off * TO_MM:g} mm too deep or shallow"] = f"{low:.2f} to {high:.2f}"
    else:
        numbers["block"] = " × ".join(f"{size * TO_MM:.1f}" for size in body.size)
        least, greatest = (depth * TO_MM for depth in slot_depths(mandrel))
        numbers["slot above the groove, width / depth of its floor"] = (
            f"{body.slot * TO_MM:.3g} / {least:.0f} to {greatest:.0f}"
        )
        wall = slot_wall(body, mandrel.winding)
        numbers["least wall between turns of the slot"] = f"{wall * TO_MM:.1f}" if math.isfinite(wall) else "one turn"
    first, last = mandrel.envelope
    numbers["with the straight ends, X / Y / Z"] = " / ".join(f"{size * TO_MM:.0f}" for size in last - first)
    start = mandrel.tube_leads[0]
    end = start + held.curved_length
    numbers |= {
        "groove, width, round below": f"{mandrel.width * TO_MM:.3f}",
        "limits of its width": f"{(tube.outer_diameter + fit.clearance) * TO_MM:.2f} to "
        f"{max(tube.outer_diameter + fit.most_clearance, mandrel.width) * TO_MM:.2f}",
        "least radius, required / in the groove": f"{TO_MM / tube.curvature:.2f} / {TO_MM / held.curvature:.3f}",
        "cut the tube to": f"{mandrel.stock_length * TO_MM:.1f}",
        "mark: bend begins at / ends at": f"{start * TO_MM:.1f} / {end * TO_MM:.1f}",
    }
    return numbers


def mandrel_steps(mandrel: Mandrel) -> list[str]:
    """Steps, as text, from the stock to the finished tube."""
    heat, spec, body = mandrel.spec.heat, mandrel.spec, mandrel.body
    if isinstance(body, Cylinder):
        diameter, material = 2 * body.radius * TO_MM, spec.material
        steps = [
            f"Stock: {material.name.replace('_', ' ')}, above {diameter:.1f} mm in diameter and "
            f"{body.length * TO_MM:.0f} mm long, {SHANK * TO_MM:g} mm of it in the chuck"
            + (", a centre at its free end" if body.length - SHANK > 4 * body.radius else "")
            + f". Turn it to {diameter:.3f} ± {spec.groove.clearance * TO_MM:g} mm, concentric within "
            f"{spec.groove.clearance * TO_MM:g} mm; the rest ISO 2768-m. {cooling_text(material)}.",
            "Mill the groove on a fourth axis (mandrel.nc), or by hand from mandrel.csv (feed, rotation, tip). Zero: "
            f"X {SHANK * TO_MM:g} at the face of the jaws, Z {diameter / 2:.3f} on the cylinder, A anywhere. "
            f"Tolerance: {_path_text(spec)}. Break the edges.",
        ]
        fixing = "wire over every half turn"
    else:
        size = " × ".join(f"{length * TO_MM:.2f}" for length in body.size)
        steps = [
            "Print the block (mandrel.stl, mm) with its open side up. Measure "
            f"it when fired: {size} mm. A block smaller by 1 % gives radii smaller by 1 %: scale the print. The groove "
            f"is drawn in the middle of its limits: a wire of {least_width(mandrel) * TO_MM:.2f} mm must pass all of "
            "it; otherwise print it wider.",
            _slot_text(mandrel),
        ]
        fixing = f"ceramic cord pressed into the slot by the strip, and {_lid_text(mandrel)}"
    return [
        *steps,
        f"Cut the tube and mark the bend. Wind it into the groove, marks on the ends of the bend; fix it by {fixing}. "
        f"No clamps: both ends are free to grow.{_stand_text(mandrel)}",
        f"Set it in a furnace at {heat.set_temperature - ZERO_CELSIUS:.0f} °C, mandrel and all: the tube at "
        f"{heat.set_temperature - ZERO_CELSIUS:.0f} ± {heat.tolerance:.0f} °C for {heat.hold_time:g} s, counted from "
        f"when a thermocouple is there. {_thermocouple_text(mandrel)} {warming_text(mandrel)} "
        f"{mandrel_cooling(mandrel)}. No heating by current is planned: the heat that a mandrel takes off a "
        "tube is not known.",
        "Trim the ends. Measure the tube; `tubeopt mold mandrel` prints the expected tube.",
    ]


STRIP_PLAY = 0.15e-3
"""Play of a strip that presses a tube into a printed groove, m (assumed)."""


def least_width(mandrel: Mandrel) -> float:
    """Smallest width (m) of the groove of a mandrel: tube and least clearance."""
    return mandrel.tube.outer_diameter + mandrel.spec.groove.clearance


def _slot_text(mandrel: Mandrel) -> str:
    """Shape and cleaning of the slot above the groove of a printed mandrel, as text."""
    assert isinstance(mandrel.body, Block)
    slot, deep = mandrel.body.slot, slot_depths(mandrel)[1]
    strip = (least_width(mandrel) - STRIP_PLAY) * TO_MM
    if slot > mandrel.width:
        return (
            f"From the top of the tube the slot widens at 45° to {slot * TO_MM:g} mm, and is up to "
            f"{deep * TO_MM:.0f} mm deep. Before firing, clear it and the groove of powder by air and a brush. The "
            f"slopes lead the tube into the groove; a strip of at most {strip:.2f} mm presses it to the floor."
        )
    return (
        f"The slot is {slot * TO_MM:.2f} mm wide and up to {deep * TO_MM:.0f} mm deep: turns pass too near each other "
        f"for a wider one. Before firing, clear it by air and a strip of sheet, at most {strip:.2f} mm thick. The "
        "same strip presses the tube to the floor."
    )


STAND = 5.0
"""Distance of a straight end from the shelf of a furnace, mm."""


def _stand_text(mandrel: Mandrel) -> str:
    """Text on the stand of a mandrel with a tube that ends below it; empty for others."""
    beneath = -float(mandrel.envelope[0][2]) * TO_MM
    if not isinstance(mandrel.body, Block) or beneath < 0.01:
        return ""
    return (
        f" An end of the tube reaches {beneath:.0f} mm below the block: put the block on a stand of "
        f"{math.ceil(beneath + STAND)} mm or more, or over the edge of the shelf."
    )


def _thermocouple_text(mandrel: Mandrel) -> str:
    """Place of the thermocouple of a mandrel, as text."""
    if isinstance(mandrel.body, Cylinder):
        return "Its junction is wired to the tube in the middle of the bend."
    x, y, _ = deepest_point(mandrel) * TO_MM
    return (
        f"Its junction is on the deepest part of the tube (X {x:.0f}, Y {y:.0f}), under the cord. Its legs leave "
        "by the slot, in a sleeve."
    )


def warming_text(mandrel: Mandrel) -> str:
    """Time that a mandrel takes to warm in a hot furnace, and what it does to the tube, as text."""
    heat, body, material = mandrel.spec.heat, mandrel.body, mandrel.spec.material
    # No board is printed: a dense ceramic is the nearest whose data are known.
    material = material if isinstance(body, Cylinder) else GLASS_MICA
    sides = body.size if isinstance(body, Block) else (body.length, *2 * (math.sqrt(math.pi) * body.radius,))
    long, wide, tall = sorted(sides, reverse=True)
    oven = Oven(
        heat.set_temperature,
        method="furnace",
        mold=MoldBed(material=material, width=wide, thickness=tall),
        mold_length=long,
    )
    straight = Tube(mandrel.tube.outer_diameter, mandrel.tube.inner_diameter, 0.0, 0.1 * long, 0.0)
    warm = warming(oven, straight, heat.set_temperature - heat.tolerance)
    name, minutes = material.name.replace("_", " "), warm.ageing / 60
    ages = (
        f"longer than the shortest published ageing ({SHORTEST_AGEING / 60:g} min): its Af rises, measure it."
        if warm.ageing > SHORTEST_AGEING
        else f"less than the shortest published ageing ({SHORTEST_AGEING / 60:g} min)."
    )
    return (
        f"A full block of {name}, put cold into still air of that temperature, takes about {warm.time / 60:.0f} min. "
        f"Meanwhile the tube is at {AGEING_DEGC[0]:g} to {AGEING_DEGC[1]:g} °C for {minutes:.0f} min, {ages}"
    )


def _lid_text(mandrel: Mandrel) -> str:
    """Lid of a printed mandrel, as text: with an opening where an end of the tube leaves the upper face."""
    opened = [
        "from X {:.0f}, Y {:.0f} to the edge at X {:.0f}, Y {:.0f}".format(*(end.notch * TO_MM).ravel())
        for end in exits_of(mandrel)
        if end.notch is not None
    ]
    if not opened:
        return "a flat lid"
    wide = math.ceil(2 * mandrel.width * TO_MM)
    return f"a flat lid with a notch {wide} mm wide for the end that rises out, {' and '.join(opened)}"


def mandrel_cooling(mandrel: Mandrel) -> str:
    """Cooling of a tube on its hot mandrel, as text."""
    if isinstance(mandrel.body, Cylinder) and not mandrel.spec.material.electrically_insulating:
        return "Then quench the mandrel with the tube in water, by long tongs: steam"
    return (
        "Never put a hot mandrel of ceramic or board into water: it cracks, and steam throws pieces. Let it cool in a "
        "draught of air. The tube passes 400 to 500 °C slowly, which changes its Af: measure it. A mandrel of metal "
        "can be quenched"
    )


QUARTERS = (0.25, 0.5, 0.75)
"""Fractions of the temperature rise on the time line: they show early whether the tube follows the plan."""


@picture
def plot_fabrication_sheet(
    fabrication: TubeFabrication,
    *,
    title: str = "",
    success: str = "",
    faults: Sequence[str] = (),
    remarks: Sequence[str] = (),
) -> Figure:
    """Heating sheet for the operator: one page A4 that begins with the probability of success.

    Args:
        fabrication: mold and heating of a tube. title: its name. success: probability of success, as text.
        faults: violated conditions: with any, the sheet says "do not run" at its top. remarks: on its tube.
    """
    plan = fabrication.heating
    stops = [*faults, *cut_out(plan).problems]
    figure = new_sheet(f"Heating sheet: {title or f'tube {fabrication.groove.number}'}")
    left, wide, top = 0.09, 0.37, 0.47 * A4[1]
    over_time = figure.add_axes((left, 0.68, wide, 0.185))
    duty = figure.add_axes((left, 0.53, wide, 0.105), sharex=over_time)
    draw_temperature(over_time, plan)
    draw_duty(duty, plan)
    over_time.tick_params(labelbottom=False)
    duty.set_xlabel("time (s)")
    write_at(figure, EDGE, A4[1] - EDGE + 5, success or "success: not known", weight="bold")
    write_at(figure, EDGE, A4[1] - EDGE - 6, f"{plan.rig.name or 'rig'}, mold of {plan.rig.mold.material.name}")
    numbers = heating_numbers(fabrication)
    _write_table(figure, (EDGE, EDGE + 62.0), top, numbers)
    if stops:
        write_at(figure, SECOND, A4[1] - EDGE, "DO NOT RUN THIS HEATING", size=13, weight="bold", color=STOP)
    lists = {"Do not run, because": stops} if stops else {}
    lists |= {
        "Before": preparation(fabrication),
        "Heating": running(fabrication),
        "Time line": time_line(fabrication),
        "Safety": safety(plan),
    }
    _write_lists(figure, SECOND, A4[1] - EDGE - 6, lists)
    if remarks:
        _write_lists(figure, EDGE, top - (len(numbers) + 1) * ROW, {"This tube": remarks})
    return figure


SECOND = 152.0
"""Left edge of the lists of a heating sheet, mm."""

STOP = "#B00020"
"""Colour of what forbids a heating."""


@picture
def plot_parts_sheet(parts: Sequence[Part], *, title: str = "") -> Figure:
    """List of electrical parts: one page A4."""
    figure = new_sheet(f"Electrical parts: {title}")
    write_at(
        figure,
        EDGE,
        A4[1] - EDGE - 6,
        "One circuit heats all tubes, one after the other; every tube has its own sketch. Wiring: firmware/wiring.png.",
    )
    texts = [f"{part.name}: {part.rating}" for part in parts]
    # About as many letters in both columns.
    lengths = np.cumsum([len(text) for text in texts])
    middle = int(np.searchsorted(lengths, 0.5 * lengths[-1]))
    for x, half in ((EDGE, texts[:middle]), (SECOND, texts[middle:])):
        _write_lists(figure, x, A4[1] - EDGE - 14, {"Part: rating": half})
    return figure


def _write_lists(figure: Figure, x: float, top: float, lists: Mapping[str, Sequence[str]]) -> None:
    """Write lists below each other, each with a heading, in the largest letters with which they fit the page."""
    for size in STEP_SIZES:
        step = 0.353 * 1.35 * size
        letters = int(LINE_LETTERS * STEP_SIZES[0] / size)
        wrapped = {
            head: [textwrap.fill(line, letters, initial_indent="- ", subsequent_indent="  ") for line in lines]
            for head, lines in lists.items()
        }
        heights = [step * (1.5 + sum(text.count("\n") + 1 for text in texts)) + GAP for texts in wrapped.values()]
        if sum(heights) < top - EDGE:
            break
    for (head, texts), height in zip(wrapped.items(), heights, strict=True):
        write_at(figure, x, top, head, size=size, weight="bold")
        write_at(figure, x, top - 1.5 * step, "\n".join(texts), size=size)
        top -= height


GAP = 2.0
"""Space between two lists, mm."""


def heating_numbers(fabrication: TubeFabrication) -> dict[str, str]:
    """Table of a heating: settings, and values to measure and to watch; mm, s, degC, V, A."""
    plan, groove, tube = fabrication.heating, fabrication.groove, fabrication.groove.tube
    low, high = plan.spec.window_degC
    on = plan.duty > 0
    hold = plan.duty[plan.in_hold][:-1]
    hottest_clamp, hottest_wall = plan.clamp_temperature.max(), plan.mold_temperature.max()
    return {
        "tube, outer / inner diameter (mm)": f"{tube.outer_diameter * TO_MM:.3f} / {tube.inner_diameter * TO_MM:.3f}",
        "cut to / between the clamps (mm)": f"{groove.stock_length * TO_MM:.1f} / {groove.free_length * TO_MM:.1f}",
        "window / limit (°C)": f"{low:g} to {high:g} / {plan.spec.limit:g}",
        "curved part in the hold (°C)": f"{plan.lowest:.1f} to {plan.highest:.1f}",
        "ramp / hold (s)": f"{plan.hold_start:g} / {plan.spec.hold_time:g}",
        "counts of 255, ramp at most / hold": f"{plan.duty.max()} / {hold.max()} to {hold.min()}",
        "slot (s) / pulses (Hz)": f"{plan.spec.slot:g} / {plan.rig.circuit.pwm_frequency:.4g}",
        "battery at rest / least under load (V)": f"{plan.rig.battery.voltage:.2f} / {plan.voltage[on].min():.2f}",
        "current while on / rms of 10 s (A)": f"{plan.peak_current:.0f} / {root_mean_square(plan):.1f}",
        "fuse (A) / copper cable at least (mm²)": f"{fuse_of(plan)} / {cable_of(plan):g}",
        "energy (kJ) / charge left (%)": f"{plan.energy / 1e3:.1f} / {100 * plan.charge[-1]:.0f}",
        "clamps / wall of the groove at most (°C)": f"{hottest_clamp:.0f} / {hottest_wall:.0f}",
        "growth of the hot tube (mm)": f"{plan.growth * TO_MM:.2f}",
        "quench, out of the mold (s)": f"{plan.quench_time:.2f} in {plan.spec.quench}",
    }


def time_line(fabrication: TubeFabrication) -> list[str]:
    """Steps of a heating as text: time, s, after switching on, and temperature of the middle of the curved part."""
    plan, hinged = fabrication.heating, fabrication.mold.hinge is not None
    middle = plan.temperature[:, plan.temperature.shape[1] // 2]
    start = int(np.flatnonzero(plan.in_hold)[0])
    # np.interp needs increasing abscissae, and integer duties let the temperature ripple.
    rising = np.maximum.accumulate(middle[: start + 1])
    goals = [middle[0] + fraction * (middle[start] - middle[0]) for fraction in QUARTERS]
    times = [float(np.interp(goal, rising, plan.time[: start + 1])) for goal in goals]
    off, left = plan.spec.slot * plan.table_length, left_in_mold(plan)
    shown = (
        []
        if plan.feedback is None
        else [
            "Temperatures are those of the tube. The board shows its own reading, corrected for the wires, with the "
            f"largest deviation and delay of {plan.feedback.samples} uncertain rigs"
        ]
    )
    return [
        *shown,
        f"0 s: switched on, {middle[0]:.0f} °C",
        *(f"{time:.1f} s: {goal:.0f} °C{_shown_text(plan, time)}" for time, goal in zip(times, goals, strict=True)),
        f"{plan.hold_start:g} s: the hold begins, {middle[start]:.0f} °C{_shown_text(plan, plan.hold_start)}",
        f"{plan.hold_end:g} s: the hold ends; the last pulse is at {off:g} s",
        f"{opening_text(fabrication.mold)}; tongs put "
        f"the tube into {plan.spec.quench}, and it is below 100 °C {plan.quench_time:.2f} s later. {LEFT:.0f} s after "
        f"the hold a tube in the closed mold is still at {left.closed:.0f} °C. "
        + (
            f"Under this mold's hinged lid, opened at once, it is at {left.opened:.0f} °C"
            if hinged
            else f"This lid is bolted; under a hinged one (key `hinge` of the mold) it is at {left.opened:.0f} °C"
        )
        + ".",
        _quench_text(left),
    ]


def _shown_text(plan: HeatingPlan, time: float) -> str:
    """Reading that the board shows at a time of the schedule, s, as text; "" without a board."""
    if plan.feedback is None:
        return ""
    expected = plan.feedback.expected(round(time / plan.spec.slot))
    return f"; shown {expected.reading:.0f} ± {expected.deviation:.0f} °C, up to {expected.delay:.1f} s later"


HAND = 2.0
"""Shortest time in which a hand opens a mold, s (assumed)."""


def _quench_text(left: LeftInMold) -> str:
    """Latest quench, and what a later one means, as text."""
    low, high = AGEING_DEGC
    begin = f"latest quench: {left.latest:.1f} s after the hold, above {high:g} °C"
    if math.isinf(left.passed):
        ages = f"the tube ages at {low:g} to {high:g} °C for {SHORTEST_AGEING:g} s and more"
        return f"{begin}. Later {ages}: it is scrap."
    return (
        f"{begin}{'; no hand is as fast' if left.latest < HAND else ''}. The quench is optional: in the closed mold "
        f"the tube passes {high:g} to "
        f"{low:g} °C in {left.passed:.1f} s, and the shortest published ageing takes {SHORTEST_AGEING:g} s "
        "(BIOMED2007). A tube quenched late or not at all is no scrap: measure its Af."
    )


def preparation(fabrication: TubeFabrication) -> list[str]:
    """Steps before switching on, as text: set-up, wiring, measurements."""
    plan, spec, behind = fabrication.heating, fabrication.mold.spec, behind_clamp(fabrication.groove)
    live = f" {behind * TO_MM:.0f} mm behind the proximal clamp are live: a sleeve over them." if behind else ""
    gaps = " and ".join(f"{gap * TO_MM:.1f}" for gap in fabrication.groove.gaps)
    battery, fixed = plan.rig.battery, "distal" if spec.clamps.sliding_end == "proximal" else "proximal"
    voltage = f"Battery rested and disconnected: {battery.voltage:.2f} V. "
    if plan.feedback is None:
        voltage += "With another voltage take its own schedule (heating/schedule_..V), not this one."
    else:
        emptiest = plan.rig.with_charge(CHARGES[-1]).battery.voltage
        voltage += f"Down to {emptiest:.2f} V the board takes the schedule of the voltage that it measures. Above: let "
        voltage += "it rest. Below: charge it."
    thermometer = [
        "Thermocouple: junction on the middle of the bend (set-up sheet), above 1 Mohm to the tube. The board reads "
        "room temperature; warm the junction: the reading must rise, or its legs are swapped."
    ]
    sensed = plan.feedback is not None and isinstance(plan.feedback.sensor, Thermocouple)
    return [
        f"Tube in its groove, {plan.rig.clamps.grip * TO_MM:g} mm of it in each clamp; the {fixed} clamp is fixed, the "
        f"{spec.clamps.sliding_end} one slides outwards by {plan.growth * TO_MM:.2f} mm and more. Cold gaps from plate "
        f"to clamp, as on the set-up sheet: {gaps} mm, +0 / -0.2.{live}",
        *_board_text(plan),
        *(thermometer if sensed else ()),
        f"Fuse of this tube: {fuse_of(plan)} A; that of another tube does not protect it.",
        voltage,
        f"Polarity: battery plus, fuse, main switch, cut-out, current sensor, {fixed} clamp; "
        f"{spec.clamps.sliding_end} clamp, MOSFET (drain), its "
        "source to battery minus. A diode across the tube has its ring on the side of the fuse. The tube itself has no "
        "polarity.",
        f"Power off: the resistance from each clamp to {'screws of hinges' if fabrication.mold.hinge else 'bolts'} "
        "and thermocouple must be above 1 Mohm if the mold "
        "insulates. Measure it again after the tube was moved. From "
        "clamp to clamp a multimeter measures mainly its own leads; check the current instead.",
    ]


DRYING = (110.0, 150.0), 2.0
"""Temperatures (degC) and time (h) that dry a mold of board (assumed)."""

POROUS = 1500.0
"""Density below which boards hold water, kg/m^3 (assumed)."""


def _board_text(plan: HeatingPlan) -> list[str]:
    """Material of the mold that the plan assumes, and its drying, as text; empty for a metal."""
    board = plan.rig.mold.material
    if not board.electrically_insulating:
        return []
    text = (
        f"Board of the mold, as planned: {board.density:g} kg/m3, {board.conductivity:g} W/(m K), service temperature "
        f"at least {math.ceil(plan.mold_temperature.max() / 10) * 10} °C."
    )
    if plan.feedback is not None and board.density_range is not None and board.conductivity_range is not None:
        (light, heavy), (poor, good) = board.density_range, board.conductivity_range
        text += f" The uncertain rigs have {light:g} to {heavy:g} kg/m3 and {poor:g} to {good:g} W/(m K)."
    if board.density < POROUS and board.limit_temperature_degC > plan.spec.limit:
        (low, high), hours = DRYING
        text += f" Dry the mold for {hours:g} h at {low:g} to {high:g} °C before the first tube: water would boil."
    return [text]


def running(fabrication: TubeFabrication) -> list[str]:
    """Steps from the finished set-up to the heating, as text."""
    plan, port = fabrication.heating, "--port PORT"
    if plan.feedback is None:
        return [
            "This is the schedule alone. `tubeopt heat firmware rig.yaml` has sketch, wiring and parts of a board that "
            "corrects it by a thermocouple.",
            "One pulse by hand: compare the current with the table. Then the whole schedule (heating/schedule.h).",
        ]
    law, cut = plan.feedback.law, cut_out(plan)
    return [
        "Wire as firmware/wiring.png, with the ratings of parts.pdf: they serve all tubes of a robot. "
        "Load firmware/tube_heater onto the board: each tube has its own.",
        f"Every day, main switch on, tube in the clamps: `tubeopt heat run {port} --test-cutout` pulses it. Pass: the "
        f'reply "cut-out: opened after .. ms", at most {math.ceil(1e3 * cut.delay)} ms; a slower contactor is not the '
        f"planned one, and above {math.floor(1e3 * cut.budget)} ms the board refuses to heat. Then the same with "
        '`--dry` in place of it: no current. Pass: it ends as "done". The lamp test (wiring.png) is before the first '
        "tube.",
        f"`tubeopt heat run {port} --out .` in the folder of this sheet. Its start checks switch, cut-out and the "
        "current of one pulse.",
        f"The board multiplies the counts of the table by {max(1 - law.share, 0):.1f} to "
        f"{1 + float(law.largest(law.planned)[law.planned > 0].max()):.1f}, with at most "
        f"{largest_count(plan):.0f} of {COUNTS}. Where the tube lags, the "
        f"schedule waits up to {law.patience:g} s: the times below are the earliest.",
        'Use the tube only if the board reports "done".',
    ]


def _silent(plan: HeatingPlan) -> list[str]:
    """Line on the uncertain rigs that miss window or limit without a report; empty without a sensor."""
    if plan.feedback is None:
        return []
    silent, samples = round(plan.feedback.silent * plan.feedback.samples), plan.feedback.samples
    most = 100 * wilson(silent, samples)[1]
    return [
        f"{silent} of {samples} uncertain rigs miss window or limit without a report (95 %: at most {most:.1f} %). "
        "Success is of the temperature alone: measure radius and Af of the tube, and compare them with your own "
        "tolerances."
    ]


def average_current(plan: HeatingPlan) -> float:
    """Mean current (A) of the battery from switching on to the end of the hold."""
    charge = float((plan.duty[:-1] / COUNTS * plan.current[:-1] * np.diff(plan.time)).sum())
    return charge / plan.hold_end


def safety(plan: HeatingPlan) -> list[str]:
    """Hazards of the heating, as text, with the numbers of the plan."""
    cut, limit = cut_out(plan), plan.rig.circuit.current_limit
    return [
        f"{plan.peak_current:.0f} A flow while on: no rings or watches, tools with insulated handles, a fuse at the "
        f"battery's plus, the stop button within reach. On average {average_current(plan):.1f} A flow, and "
        f"{plan.mean_current:.1f} A in the strongest slot; the rig file allows {limit:g} A (current_limit_A).",
        f"The tube is at {plan.hottest:.0f} °C; clamps reach {plan.clamp_temperature.max():.0f} °C, the groove "
        f"{plan.mold_temperature.max():.0f} °C: wear gloves and goggles, and keep it away from anything that burns.",
        f"Shorted switch: the cut-out must open within {math.floor(1e3 * cut.budget)} ms, or the tube passes 650 °C. "
        f"With pulses of {plan.rig.circuit.pwm_frequency:.4g} Hz it takes {math.ceil(1e3 * cut.delay)} ms: "
        f"{cut.peak:.0f} °C at most.",
        "Heat under an extractor: a new board gives off steam and smoke. A lead-acid battery being charged gives off "
        "hydrogen: never charge it beside the rig."
        if plan.rig.battery.chemistry == LEAD_ACID
        else "Heat under an extractor: a new board gives off steam and smoke.",
        "Main switch off before a hand touches clamps or mold. Quench with tongs in hand; water spits.",
        "No sensor leads this heating: without a thermometer a miss stays unseen."
        if plan.feedback is None
        else f"The board stops by itself at a reading of {plan.feedback.law.ceiling:.0f} °C: the hottest point, which "
        f"is beside the junction, is then at most at {plan.spec.limit + MOST_EXCESS:.0f} °C, with the sensor's error.",
        *_silent(plan),
        "Above the limit, or where the tube does not follow the time line: stop."
        if plan.feedback is None
        else "The board compares its corrected reading with the schedule: it waits where the tube lags, and stops by "
        "itself. Stop by hand what smokes, sparks or moves.",
        "After a stop or a miss: main switch off, let the tube cool in the mold; do not use it. Find the cause first, "
        "or calibrate by the log (`tubeopt heat calibrate`); then heat a new tube.",
        # Said above with its interval.
        *(text for text in plan.concerns if plan.feedback is None or text != plan.feedback.unreported),
    ]

"""A mold as SVG: mm, true arcs, one group per layer."""

from __future__ import annotations

import math
from os import PathLike
from pathlib import Path
from xml.sax.saxutils import escape

from ...files.files import write_text
from .drawing import LAYERS, TEXT_HEIGHT_MM, Drawing, draw_plate
from .groove import Line, Piece
from .mold import Mold

COLOURS = {"OUTLINE": "#222222", "GROOVE": "#0072B2", "CENTERLINE": "#D55E00", "HOLES": "#009E73", "TEXT": "#6A6A6A"}
MARGIN_MM = 25.0


def write_svg(mold: Mold, path: str | PathLike[str], *, part: str = "base") -> Path:
    """Write a plate of the mold as SVG in its true size, whole or not at all, and return the path."""
    write_text(path, svg_of(draw_plate(mold, part)))
    return Path(path)


def svg_of(drawing: Drawing) -> str:
    """A drawing as SVG in its true size."""
    low = min([0.0, *(place[1] for place, _ in drawing.texts)]) - MARGIN_MM / 2
    longest = max(len(text) for _, text in drawing.texts) * 0.6 * TEXT_HEIGHT_MM
    right = max(drawing.size[0] + MARGIN_MM, longest)
    width, height = right + MARGIN_MM, drawing.size[1] + MARGIN_MM - low
    # SVG's y points down: everything is flipped at once, the letters back again.
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:.3f}mm" height="{height:.3f}mm" '
        f'viewBox="{-MARGIN_MM:.3f} {-(drawing.size[1] + MARGIN_MM):.3f} {width:.3f} {height:.3f}">\n'
        '<g transform="scale(1,-1)" fill="none" stroke-width="0.15">\n'
    )
    groups = []
    for layer in LAYERS:
        dash = ' stroke-dasharray="3 0.7 0.5 0.7"' if layer == "CENTERLINE" else ""
        body = [f'<path d="{_path(piece)}"/>' for piece in drawing.pieces.get(layer, ())]
        if layer == "HOLES":
            body += [f'<circle cx="{x:.6f}" cy="{y:.6f}" r="{d / 2:.6f}"/>' for (x, y), d in drawing.circles]
        if layer == "TEXT":
            body += [
                f'<text transform="translate({x:.3f},{y:.3f}) scale(1,-1)" font-size="{TEXT_HEIGHT_MM}" '
                f'font-family="sans-serif" fill="{COLOURS[layer]}" stroke="none">{escape(text)}</text>'
                for (x, y), text in drawing.texts
            ]
        groups.append(f'<g id="{layer}" stroke="{COLOURS[layer]}"{dash}>\n' + "\n".join(body) + "\n</g>\n")
    return head + "".join(groups) + "</g>\n</svg>\n"


def _path(piece: Piece) -> str:
    (x0, y0), (x1, y1) = piece.start, piece.end
    if isinstance(piece, Line):
        return f"M{x0:.6f},{y0:.6f} L{x1:.6f},{y1:.6f}"
    large, sweep = int(abs(piece.sweep) > math.pi), int(piece.sweep > 0)
    return f"M{x0:.6f},{y0:.6f} A{piece.radius:.6f},{piece.radius:.6f} 0 {large} {sweep} {x1:.6f},{y1:.6f}"

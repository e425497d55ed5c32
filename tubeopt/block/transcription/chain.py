"""Tubes made of pieces in a program: stiffness and precurvature along them as expressions of their dimensions.

Every tube is a chain of panels, on each of which EI, GJ and precurvature are polynomials: its straight part, then the
panels of its pieces. The dimensions of a piece stretch, bend, rotate, twist and soften the piece of the robot.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from ...errors import InputError
from ...robots.lengthwise import CrossSections
from ...robots.pieces import Piece, Quantity, Series, breaks_of, extremes, on_panels
from ...robots.tubes import Tube, TubeStretch, stretches
from ...typing import Array

# --- Tubes along a piece of the mesh ----------------------------------------------------------------------------------

# A column of coefficients describes the tubes along one piece of the mesh. Every tube has polynomials on its panels; a
# piece of the mesh lies in one panel of each tube, from `low` to `high` in the coordinate -1 .. 1 of that panel.

CHANNELS = 5
"""Number of channels: EI of a tube that is present, GJ, u*_x, u*_y and the natural turn, in this order."""

QUADRATURE = 16
"""Gauss points for the mean torsional compliance of a panel."""


@dataclass(frozen=True, eq=False)
class LocalTubes:
    """n tubes at a cross-section."""

    stiffness: Any
    """Bending stiffness kb (n,)."""
    moment: Any
    """Moments m (n,), bending stiffness times precurvature; (n, 2) of tubes made of pieces."""
    natural_turn: Any = 0.0
    """Natural twist integrated from the clamp (n,), rad."""
    compliance_ratio: Any = 1.0
    """Ratio kt / GJ (n,), with kt of the tube where it is clamped."""
    natural: Any = None
    """Precurvature (n, 2), 1/m; None for tubes of one curvature."""


def column_length(n: int, detail: int) -> int:
    """Length of the column of n tubes with `detail` coefficients a channel."""
    return n * (CHANNELS * detail + 2)


def local_tubes(along: Any, torsional_stiffness: Any, detail: int, x: Any) -> LocalTubes:
    """The tubes at the fraction x of a piece.

    Args:
        along: column, tube by tube: `detail` coefficients of each channel, then low and high.
        torsional_stiffness: (n,) kt, the reference of the compliance ratios.
    """
    n = along.numel() // (CHANNELS * detail + 2)
    return LocalTubes(*_local_function(n, detail).call([along, torsional_stiffness, x]))


@lru_cache(maxsize=32)
def _local_function(n: int, detail: int) -> ca.Function:
    """Function (along, kt, x) -> fields of `LocalTubes`; built once, since it is called at many points."""
    along, torsional_stiffness, x = ca.SX.sym("along", column_length(n, detail)), ca.SX.sym("kt", n), ca.SX.sym("x")
    table = ca.reshape(along, CHANNELS * detail + 2, -1)
    low, high = table[-2, :], table[-1, :]
    basis = chebyshev_basis(low + x * (high - low), detail)
    kb, kt, a, b, natural_turn = (
        sum(table[c * detail + k, :] * basis[k] for k in range(detail)).T for c in range(CHANNELS)
    )
    natural = ca.horzcat(a, b)
    outputs = [kb, ca.horzcat(kb, kb) * natural, natural_turn, torsional_stiffness / kt, natural]
    return ca.Function("local", [along, torsional_stiffness, x], outputs)


def chebyshev_basis(x: Any, count: int) -> list[Any]:
    """First `count` Chebyshev polynomials at x."""
    basis = [1.0, x]
    for _ in range(2, count):
        basis.append(2 * x * basis[-1] - basis[-2])
    return basis[:count]


def interpolated_columns(sections: CrossSections, nodes: Array) -> Array:
    """Columns of P pieces, one after the other, by polynomials through cross-sections (P K, n) at their nodes (K,).

    They are exact at the nodes, where the collocated equations need them.
    """
    count, n = len(nodes), sections.stiffness.shape[1]
    curvature = sections.moment / np.where(sections.stiffness > 0, sections.stiffness, 1.0)
    turn = sections.phase - sections.twist_angle
    x, y = curvature * np.cos(turn), curvature * np.sin(turn)
    parts = sections.stiffness, sections.torsional_stiffness, x, y, sections.twist_angle
    fit = np.linalg.inv(np.polynomial.chebyshev.chebvander(2 * nodes - 1, count - 1))
    tables = [fit @ part.reshape(-1, count, n) for part in parts]
    joined = np.concatenate(tables, axis=1).transpose(0, 2, 1)
    ends = np.broadcast_to([-1.0, 1.0], (*joined.shape[:2], 2))
    return np.asarray(np.concatenate([joined, ends], axis=2).ravel())


def shifted_columns(table: Any, detail: int, lengths: Any, ends: Any, tubes: Any) -> Any:
    """Columns (X, P) of `interpolated_columns` after tubes are shifted along; each keeps its polynomials.

    Args:
        lengths: (P,) of the pieces, m.
        ends, tubes: forward shifts of the ends of the pieces (P + 1,), and of the tubes (n,), m.
    """
    rows, pieces = CHANNELS * detail + 2, table.shape[1]
    out = []
    for i in range(tubes.shape[0]):
        low, high = (2 * (ends[first : first + pieces] - tubes[i]) / lengths for first in (0, 1))
        out += [table[i * rows : (i + 1) * rows - 2, :], (low - 1).T, (high + 1).T]
    return ca.vertcat(*out)


@lru_cache(maxsize=32)
def compliance_function(detail: int) -> ca.Function:
    """Function (coefficients of GJ (detail,), low, high) -> mean of 1 / GJ between two points of a panel."""
    coefficients, low, high = ca.SX.sym("kt", detail), ca.SX.sym("low"), ca.SX.sym("high")
    nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE if detail > 1 else 1)
    mean: Any = 0.0
    for x, w in zip((nodes + 1) / 2, weights / 2, strict=True):
        basis = chebyshev_basis(low + x * (high - low), detail)
        mean += w / sum(coefficients[k] * basis[k] for k in range(detail))
    return ca.Function("compliance", [coefficients, low, high], [mean], {"cse": True})


PIECES = (
    "piece_length",
    "piece_curvature",
    "piece_plane",
    "piece_twist",
    "piece_bending_factor",
    "piece_torsion_factor",
)
"""Dimensions of the pieces, one each, tube by tube, inner to outer, from the straight part to the tip.

They are length (m), largest curvature (1/m, signed), rotation of its direction from that of the robot (rad), natural
twist where the piece begins (1/m), and factors of its stiffnesses. Curvature that varies along a piece is stretched and
scaled with it; a straight piece becomes an arc about x. A tube of one curvature is one piece."""

OF_TUBE = {"piece_length": "curved_length", "piece_curvature": "curvature"}
"""Dimensions of a tube that scale those of all its pieces, unless the pieces are passed."""

POINT = 1e-9
"""Length (m) below which a straight part counts as absent."""


@dataclass(frozen=True, eq=False)
class Chain:
    """The B panels of n tubes, and their M pieces, as the robot has them."""

    tube: NDArray[np.intp]
    """Tube (B,) of each panel."""
    piece: NDArray[np.intp]
    """Piece (B,) of each panel; -1 is the straight part."""
    fraction: Array
    """Length (B,) of each panel relative to its piece."""
    kb: Array
    """Coefficients (B, D) of the bending stiffness."""
    kt: Array
    """Coefficients (B, D) of the torsional stiffness."""
    x: Array
    """Coefficients (B, D) of u*_x, relative to piece_curvature and in the direction of the piece."""
    y: Array
    """Coefficients (B, D) of u*_y, likewise."""
    z: Array
    """Coefficients (B, D) of the natural twist, 1/m."""
    owner: NDArray[np.intp]
    """Tube (M,) of each piece."""
    start: dict[str, Array]
    """PIECES of the robot."""

    @property
    def detail(self) -> int:
        """Number of coefficients per channel; the natural turn has one more than the natural twist."""
        return int(self.z.shape[1]) + 1

    @property
    def before(self) -> Array:
        """(B, B) 1 if the column's panel is on the same tube as the row's and closer to the clamp, else 0."""
        return np.asarray(np.tril(self.tube[:, None] == self.tube, -1), dtype=float)


@lru_cache(maxsize=64)
def chain_of(tubes: tuple[Tube, ...]) -> Chain:
    """Panels and pieces of tubes."""
    rows: list[tuple[int, int, float, list[Array]]] = []
    owner: list[int] = []
    pieces: list[tuple[float, float, float]] = []
    for i, tube in enumerate(tubes):
        parts = stretches(tube)
        if tube.straight_length == 0:
            stiffnesses = float(tube.bending_stiffness), float(tube.torsional_stiffness)
            parts = [TubeStretch(0.0, (0.0, 0.0, 0.0), *stiffnesses), *parts]
        for number, (length, (x, y, z), bending, torsional) in enumerate(parts):
            size, (a, b) = bend_of((x, y), length)
            quantities: tuple[Quantity, ...] = (bending, torsional, a, b, z)
            breaks = breaks_of(quantities, length) if length else np.zeros(2)
            columns = [on_panels(q, breaks) for q in quantities]
            piece = len(owner) if number else -1
            fractions = np.diff(breaks) / length if length else np.ones(1)
            for fraction, *channels in zip(fractions, *columns, strict=True):
                rows.append((i, piece, float(fraction), channels))
            if number:
                owner.append(i)
                pieces.append((length, size, float(z(0.0)) if isinstance(z, Series) else float(z)))
    width = max(1, *(len(c) for *_, channels in rows for c in channels))
    table = np.array([[np.pad(c, (0, width - len(c))) for c in channels] for *_, channels in rows])
    lengths, bends, twists = np.array(pieces).reshape(-1, 3).T
    zero, one = np.zeros(len(pieces)), np.ones(len(pieces))
    kb, kt, x, y, z = table.transpose(1, 0, 2)
    return Chain(
        tube=np.array([row[0] for row in rows]),
        piece=np.array([row[1] for row in rows]),
        fraction=np.array([row[2] for row in rows]),
        kb=kb,
        kt=kt,
        x=x,
        y=y,
        z=z,
        owner=np.array(owner, dtype=np.intp),
        start=dict(zip(PIECES, (lengths, bends, zero, twists, one, one), strict=True)),
    )


def bend_of(curvature: tuple[Quantity, Quantity], length: float) -> tuple[float, tuple[Quantity, Quantity]]:
    """Largest curvature of a piece, signed if it is about x, and the curvature over it; (1, 0) if it is straight."""
    x, y = curvature
    if not isinstance(x, Series) and not isinstance(y, Series):
        size = x if y == 0 else float(np.hypot(x, y))
        return size, (x / size, y / size) if size else (1.0, 0.0)
    size = extremes([x, y], length)[1]
    return size, tuple(q.times(1 / size) if isinstance(q, Series) else q / size for q in (x, y))  # type: ignore[return-value]


@dataclass(frozen=True, eq=False)
class Panels:
    """The panels of all tubes at some dimensions, expressions or numbers."""

    width: Any
    """Lengths (B,) of the panels, m."""
    low: Any
    """Distances (B,) of their starts from the clamp, m."""
    table: Any
    """Coefficients (B, CHANNELS D) of kb, kt, u*_x, u*_y and the natural turn."""


def panels(chain: Chain, inputs: Mapping[str, Any]) -> Panels:
    """Panels at dimensions of tubes and PIECES."""
    tube, piece = chain.tube.tolist(), chain.piece.tolist()
    straight = [k < 0 for k in piece]

    def of_piece(name: str, default: Any) -> Any:
        """Dimension (B,) of the piece of every panel, `default` (n,) of the tube for straight parts."""
        return ca.vertcat(
            *(default[i] if s else inputs[name][k] for i, k, s in zip(tube, piece, straight, strict=True))
        )

    n = inputs["straight_length"].shape[0]
    one, zero = ca.DM.ones(n), ca.DM.zeros(n)
    width = ca.DM(chain.fraction) * of_piece("piece_length", inputs["straight_length"])
    stiff = [
        _scaled_rows(
            ca.DM(coefficients), of_piece(factor, one) * inputs[name][tube, :] / ca.DM(_stiffness(chain, coefficients))
        )
        for coefficients, factor, name in (
            (chain.kb, "piece_bending_factor", "bending_stiffness"),
            (chain.kt, "piece_torsion_factor", "torsional_stiffness"),
        )
    ]
    size, plane = of_piece("piece_curvature", zero), of_piece("piece_plane", zero)
    cos, sin = size * ca.cos(plane), size * ca.sin(plane)
    x = _scaled_rows(ca.DM(chain.x), cos) - _scaled_rows(ca.DM(chain.y), sin)
    y = _scaled_rows(ca.DM(chain.x), sin) + _scaled_rows(ca.DM(chain.y), cos)
    # A change of piece_twist shifts the natural twist all along the piece.
    start = np.array([0.0 if k < 0 else chain.start["piece_twist"][k] for k in piece])
    z = ca.horzcat(of_piece("piece_twist", zero) - ca.DM(start), ca.DM.zeros(len(tube), chain.z.shape[1] - 1)) + chain.z
    degree = chain.z.shape[1]
    turn = np.array([chebyshev.chebint(row, lbnd=-1) for row in np.eye(degree)])
    turned = _scaled_rows(z @ ca.DM(turn), width / 2)
    before = ca.DM(chain.before)
    natural_turn = turned + ca.horzcat(before @ ca.sum2(turned), ca.DM.zeros(len(tube), degree))
    padded = [ca.horzcat(part, ca.DM.zeros(len(tube), 1)) for part in (*stiff, x, y)]
    return Panels(width, before @ width, ca.horzcat(*padded, natural_turn))


def _stiffness(chain: Chain, coefficients: Array) -> Array:
    """Stiffness (B,) of each panel's tube, taken from its straight part."""
    return np.array([coefficients[(chain.tube == i) & (chain.piece < 0)][0, 0] for i in chain.tube])


def _scaled_rows(table: Any, factor: Any) -> Any:
    """Rows of a table (B, D) times a factor (B,) each."""
    return table * ca.repmat(factor, 1, table.shape[1])


def joints(chain: Chain, laid: Panels, clamped: Any) -> list[Any]:
    """Arc lengths of the joints between panels behind the transitions, m, for tubes clamped (n,) m behind the plate."""
    inner = [k for k in range(1, len(chain.tube)) if chain.piece[k] >= 0 and chain.piece[k - 1] >= 0]
    return [laid.low[k] - clamped[int(chain.tube[k])] for k in inner]


def transmissions(chain: Chain, laid: Panels, clamped: Any, selected: Any, torsional_stiffness: Any) -> Any:
    """kt int ds / GJ (n,) from clamp to plate, m.

    Args:
        clamped: distance (n,) of the clamps from the plate, m.
        selected: 1 for the panel of each tube at the plate, else 0, (B,).
    """
    count, detail = len(chain.tube), chain.detail
    kt = laid.table[:, detail : 2 * detail].T
    mean = compliance_function(detail)
    full = (laid.width * mean.map(count)(kt, -ca.DM.ones(1, count), ca.DM.ones(1, count)).T).T
    behind = ca.mtimes(ca.DM(chain.before).T, selected)
    out = []
    for i in range(torsional_stiffness.shape[0]):
        mine = np.flatnonzero(chain.tube == i).tolist()
        pick, chosen = selected[mine], kt[:, mine]
        last = clamped[i] - ca.dot(pick, laid.low[mine])
        high = 2 * last / ca.fmax(ca.dot(pick, laid.width[mine]), POINT) - 1
        part = last * mean(chosen @ pick, -1, high)
        out.append(torsional_stiffness[i] * (full[:, mine] @ behind[mine] + part))
    return ca.vertcat(*out)


def columns(chain: Chain, laid: Panels, selected: Any, present: Any, clamped: Any, cuts: Any) -> Any:
    """Columns (X, P) of all pieces of a mesh, as `local_tubes` reads them.

    Args:
        selected: 1 for the panel of each tube on a piece, else 0, (B, P).
        present: 1 where a tube is present, else 0, (n, P).
        clamped: distance (n,) of the clamps from the plate, m.
        cuts: arc lengths (P + 1,) of the ends of the pieces, m.
    """
    out = []
    pieces = selected.shape[1]
    for i in range(present.shape[0]):
        mine = np.flatnonzero(chain.tube == i).tolist()
        chosen = selected[mine, :]
        is_present = present[i, :]
        table = laid.table[mine, :].T @ chosen
        stiffness = table[: chain.detail, :] * ca.repmat(is_present, chain.detail, 1)
        low, width = (laid.low[mine].T @ chosen, ca.fmax(laid.width[mine].T @ chosen, POINT))
        ends = [2 * (clamped[i] + s - low) / width - 1 for s in (cuts[:pieces].T, cuts[1:].T)]
        # Beyond its end a tube keeps the values at its end.
        ends = [1 + is_present * (x - 1) for x in ends]
        out.append(ca.vertcat(stiffness, table[chain.detail :, :], *ends))
    return ca.vertcat(*out)


# --- Tubes from dimensions, and dimensions from tubes -----------------------------------------------------------------


def tubes_at(tubes: Sequence[Tube], inputs: Mapping[str, Array]) -> tuple[Tube, ...]:
    """Tubes with other dimensions and PIECES, in numbers."""
    chain = chain_of(tuple(tubes))
    laid = panels(chain, {name: ca.DM(value) for name, value in inputs.items()})
    width, table = (np.array(ca.DM(part)) for part in (laid.width, laid.table))
    channels = table.reshape(len(width), CHANNELS, chain.detail)
    turning = np.array([chebyshev.chebder(row) for row in channels[:, 4]]) / (width / 2)
    out = []
    for i, tube in enumerate(tubes):
        kb, kt = (float(inputs[name][i]) for name in ("bending_stiffness", "torsional_stiffness"))
        pieces: list[Piece] = []
        for k in np.flatnonzero(chain.owner == i).tolist():
            rows = np.flatnonzero(chain.piece == k).tolist()
            joints = np.concatenate([[0.0], np.cumsum(width[rows, 0])])
            shapes = (*(channels[rows, c] for c in range(4)), turning[rows])
            local_kb, local_kt, x, y, z = (_quantity(joints, shape) for shape in shapes)
            slots = tube.pieces[len(pieces)].slots if tube.pieces else None
            # A piece as stiff as its tube follows the tube.
            stiffness = None if local_kb == kb else local_kb, None if local_kt == kt else local_kt
            pieces.append(Piece(float(joints[-1]), (x, y, z), *stiffness, slots))
        curvature, made = max((piece.largest_curvature for piece in pieces), default=0.0), tuple(pieces)
        # A tube of one curvature stays one if its pieces allow it; a tube of pieces stays one of pieces.
        if not tube.general and all(piece.plain for piece in pieces):
            curvature, made = (float(pieces[0].precurvature[0]) if pieces else tube.curvature), ()
        out.append(
            remade(
                tube,
                straight_length=float(inputs["straight_length"][i]),
                curved_length=math.fsum(piece.length for piece in pieces),
                curvature=curvature,
                bending_stiffness=kb,
                torsional_stiffness=kt,
                pieces=made,
            )
        )
    return tuple(out)


def _quantity(joints: Array, table: Array) -> Quantity:
    rows = [chebyshev.chebtrim(row) for row in table]
    first = float(rows[0][0])
    if all(len(row) == 1 and row[0] == first for row in rows):
        return first
    return Series(tuple(joints.tolist()), tuple(tuple(row.tolist()) for row in rows))


def remade(tube: Tube, **dimensions: Any) -> Tube:
    """Tube with other dimensions or pieces; a stiffness that follows from the cross-section is computed again."""
    stiffness = ("bending_stiffness", "torsional_stiffness")
    return replace(tube, **{k: v for k, v in dimensions.items() if k not in stiffness or v != getattr(tube, k)})


def piece_numbers(tubes: Sequence[Tube], like: Chain) -> dict[str, Array]:
    """PIECES of tubes, relative to the pieces of `like`."""
    chain = chain_of(tuple(tubes))
    if chain.owner.tolist() != like.owner.tolist() or chain.piece.tolist() != like.piece.tolist():
        raise InputError("the pieces of the tubes differ from those of the block")
    start = dict(chain.start)
    first = [like.piece.tolist().index(k) for k in range(len(like.owner))]
    turned = np.arctan2(chain.y, chain.x)[first, 0] - np.arctan2(like.y, like.x)[first, 0]
    start["piece_plane"] = (turned + np.pi) % (2 * np.pi) - np.pi
    for name, mine, old in (("bending", chain.kb, like.kb), ("torsion", chain.kt, like.kt)):
        ratio = mine[first, 0] / _stiffness(chain, mine)[first] / (old[first, 0] / _stiffness(like, old)[first])
        start[f"piece_{name}_factor"] = ratio
    return start

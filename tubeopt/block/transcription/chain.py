"""Tubes made of pieces in a program: their dimensions as expressions, and what these make of the panels of the tubes.

Every tube is a chain of panels, on each of which EI, GJ and precurvature are polynomials: its straight part, then the
panels of its pieces. The dimensions of a piece stretch, bend, turn, twist and soften what the robot has there.
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
from ...robots.tubes import Tube, stretches
from ...typing import Array

# --- What varies along a piece ----------------------------------------------------------------------------------------

# What varies along one piece of tubes made of pieces, as the numbers of a column and read at any point of the piece.
#
# Every tube has polynomials on the panels that its own pieces are cut into; a piece of the mesh lies in one panel of
# each tube, from `low` to `high` in the coordinate -1 .. 1 of that panel.

CHANNELS = 5
"""EI of a tube that is present, GJ, u*_x, u*_y and the natural turn, in this order."""

QUADRATURE = 16
"""Gauss points for the mean torsional compliance of a panel."""


@dataclass(frozen=True, eq=False)
class Local:
    """n tubes at a cross-section: kb (n,), m (n,) or (n, 2), natural turn, ease kt / GJ, and u* (n, 2)."""

    stiffness: Any
    moment: Any
    wound: Any = 0.0
    ease: Any = 1.0
    natural: Any = None


def width(n: int, detail: int) -> int:
    """Length of the column of n tubes with `detail` coefficients."""
    return n * (CHANNELS * detail + 2)


def local(along: Any, torsional_stiffness: Any, detail: int, x: Any) -> Local:
    """The tubes at the fraction x of a piece.

    Args:
        along: column, tube by tube: `detail` coefficients of each channel, then low and high.
        torsional_stiffness: (n,) kt, the reference of the compliance ratios.
    """
    n = along.numel() // (CHANNELS * detail + 2)
    return Local(*_local_function(n, detail).call([along, torsional_stiffness, x]))


@lru_cache(maxsize=32)
def _local_function(n: int, detail: int) -> ca.Function:
    """Written out once, for expressions of symbols that have many points."""
    along, torsional_stiffness, x = ca.SX.sym("along", width(n, detail)), ca.SX.sym("kt", n), ca.SX.sym("x")
    table = ca.reshape(along, CHANNELS * detail + 2, -1)
    low, high = table[-2, :], table[-1, :]
    basis = chebyshev_basis(low + x * (high - low), detail)
    kb, kt, a, b, wound = (sum(table[c * detail + k, :] * basis[k] for k in range(detail)).T for c in range(CHANNELS))
    natural = ca.horzcat(a, b)
    outputs = [kb, ca.horzcat(kb, kb) * natural, wound, torsional_stiffness / kt, natural]
    return ca.Function("local", [along, torsional_stiffness, x], outputs)


def chebyshev_basis(x: Any, count: int) -> list[Any]:
    """The first `count` polynomials at x."""
    basis = [1.0, x]
    for _ in range(2, count):
        basis.append(2 * x * basis[-1] - basis[-2])
    return basis[:count]


def at_points(here: CrossSections, nodes: Array) -> Array:
    """The columns of P pieces, one behind the other, by polynomials through the cross-sections (P K, n) at nodes (K,)
    of every piece: as good as exact where nothing but these is asked for."""
    count, n = len(nodes), here.stiffness.shape[1]
    curvature = here.moment / np.where(here.stiffness > 0, here.stiffness, 1.0)
    turn = here.phase - here.wound
    parts = here.stiffness, here.torsional_stiffness, curvature * np.cos(turn), curvature * np.sin(turn), here.wound
    fit = np.linalg.inv(np.polynomial.chebyshev.chebvander(2 * nodes - 1, count - 1))
    tables = [fit @ part.reshape(-1, count, n) for part in parts]
    whole = np.concatenate(tables, axis=1).transpose(0, 2, 1)
    ends = np.broadcast_to([-1.0, 1.0], (*whole.shape[:2], 2))
    return np.asarray(np.concatenate([whole, ends], axis=2).ravel())


def slid(table: Any, detail: int, lengths: Any, moved: tuple[Any, Any]) -> Any:
    """Columns (X, P) as `at_points` gives them for pieces of `lengths` (P,), m, after the ends of the pieces (P + 1,)
    and the tubes (n,) have `moved` forward, m: the same polynomials of the place on each tube."""
    ends, tubes = moved
    rows, pieces = CHANNELS * detail + 2, table.shape[1]
    out = []
    for i in range(tubes.shape[0]):
        places = [2 * (ends[first : first + pieces] - tubes[i]) / lengths for first in (0, 1)]
        out += [table[i * rows : (i + 1) * rows - 2, :], (places[0] - 1).T, (places[1] + 1).T]
    return ca.vertcat(*out)


@lru_cache(maxsize=32)
def compliance_function(detail: int) -> ca.Function:
    """(coefficients of GJ (detail,), low, high) -> mean of 1 / GJ between two places of a panel."""
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
"""Dimensions of the pieces, one each, tube by tube, inner to outer, from the straight part to the tip: length (m),
largest bend (1/m, signed), angle (rad) by which its direction is turned from that of the robot, natural twist (1/m)
where the piece begins, and factors of its stiffnesses, as slots leave them. What varies along a piece is stretched, and
bent in proportion; a piece that is straight becomes an arc about x. A tube of one curvature is one piece."""

OF_TUBE = {"piece_length": "curved_length", "piece_curvature": "curvature"}
"""Dimensions of tubes that are in proportion for all their pieces, where those are not given."""

POINT = 1e-9
"""Length (m) of a straight part that is none."""


@dataclass(frozen=True, eq=False)
class Chain:
    """The panels of n tubes, B in all, as the robot has them, and their M pieces.

    tube, piece: (B,) which tube's a panel is, and which piece's; -1 is the straight part.  share: (B,) of the length
    of its piece.  kb, kt, x, y, z: (B, D) coefficients; x and y per piece_curvature, from its own direction.
    owner: (M,) the tube of every piece.  start: PIECES as the robot has them.
    """

    tube: NDArray[np.intp]
    piece: NDArray[np.intp]
    share: Array
    kb: Array
    kt: Array
    x: Array
    y: Array
    z: Array
    owner: NDArray[np.intp]
    start: dict[str, Array]

    @property
    def detail(self) -> int:
        """Coefficients of what varies along a panel; the natural turn has one more than the twist."""
        return int(self.z.shape[1]) + 1

    @property
    def before(self) -> Array:
        """(B, B) 1 where the panel of a column lies in the same tube nearer to its held end than that of the row."""
        return np.asarray(np.tril(self.tube[:, None] == self.tube, -1), dtype=float)


@lru_cache(maxsize=64)
def chain_of(tubes: tuple[Tube, ...]) -> Chain:
    """The panels and pieces of tubes."""
    rows: list[tuple[int, int, float, list[Array]]] = []
    owner: list[int] = []
    pieces: list[tuple[float, float, float]] = []
    for i, tube in enumerate(tubes):
        parts = stretches(tube)
        if tube.straight_length == 0:
            own = float(tube.bending_stiffness), float(tube.torsional_stiffness)
            parts = [(0.0, (0.0, 0.0, 0.0), *own), *parts]
        for number, (length, (x, y, z), bending, torsional) in enumerate(parts):
            size, (a, b) = bend_of((x, y), length)
            quantities: tuple[Quantity, ...] = (bending, torsional, a, b, z)
            breaks = breaks_of(quantities, length) if length else np.zeros(2)
            columns = [on_panels(q, breaks) for q in quantities]
            piece = len(owner) if number else -1
            shares = np.diff(breaks) / length if length else np.ones(1)
            for fraction, *channels in zip(shares, *columns, strict=True):
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
        share=np.array([row[2] for row in rows]),
        kb=kb,
        kt=kt,
        x=x,
        y=y,
        z=z,
        owner=np.array(owner, dtype=np.intp),
        start=dict(zip(PIECES, (lengths, bends, zero, twists, one, one), strict=True)),
    )


def bend_of(own: tuple[Quantity, Quantity], length: float) -> tuple[float, tuple[Quantity, Quantity]]:
    """Largest bend of a piece, signed where it is about x, and the bend over it; that of a straight one is about x."""
    x, y = own
    if not isinstance(x, Series) and not isinstance(y, Series):
        size = x if y == 0 else float(np.hypot(x, y))
        return size, (x / size, y / size) if size else (1.0, 0.0)
    size = extremes([x, y], length)[1]
    return size, tuple(q.times(1 / size) if isinstance(q, Series) else q / size for q in own)  # type: ignore[return-value]


@dataclass(frozen=True, eq=False)
class Panels:
    """The panels of all tubes at some dimensions, expressions or numbers.

    width, low: (B,) lengths, and where they begin from the held end, m.  table: (B, CHANNELS D) coefficients of kb, kt,
    u*_x, u*_y and the natural turn.
    """

    width: Any
    low: Any
    table: Any


def panels(chain: Chain, inputs: Mapping[str, Any]) -> Panels:
    """The panels at given dimensions of tubes and PIECES."""
    tube, piece = chain.tube.tolist(), chain.piece.tolist()
    straight = [k < 0 for k in piece]

    def of_piece(name: str, otherwise: Any) -> Any:
        """(B,) a dimension of the piece of every panel, `otherwise` (n,) of the tube for straight parts."""
        own = [otherwise[i] if s else inputs[name][k] for i, k, s in zip(tube, piece, straight, strict=True)]
        return ca.vertcat(*own)

    n = inputs["straight_length"].shape[0]
    one, zero = ca.DM.ones(n), ca.DM.zeros(n)
    width = ca.DM(chain.share) * of_piece("piece_length", inputs["straight_length"])
    stiff = [
        _rows(coefficients, of_piece(factor, one) * inputs[name][tube, :] / ca.DM(own))
        for coefficients, factor, name, own in (
            (chain.kb, "piece_bending_factor", "bending_stiffness", own_stiffness(chain, chain.kb)),
            (chain.kt, "piece_torsion_factor", "torsional_stiffness", own_stiffness(chain, chain.kt)),
        )
    ]
    size, plane = of_piece("piece_curvature", zero), of_piece("piece_plane", zero)
    cos, sin = size * ca.cos(plane), size * ca.sin(plane)
    x = _rows(chain.x, cos) - _rows(chain.y, sin)
    y = _rows(chain.x, sin) + _rows(chain.y, cos)
    own = np.array([0.0 if k < 0 else chain.start["piece_twist"][k] for k in piece])
    z = ca.horzcat(of_piece("piece_twist", zero) - ca.DM(own), ca.DM.zeros(len(tube), chain.z.shape[1] - 1)) + chain.z
    degree = chain.z.shape[1]
    turn = np.array([chebyshev.chebint(row, lbnd=-1) for row in np.eye(degree)])
    turned = _rows_of(z @ ca.DM(turn), width / 2)
    before = ca.DM(chain.before)
    begin = before @ ca.sum2(turned)
    wound = turned + ca.horzcat(begin, ca.DM.zeros(len(tube), degree))
    padded = [ca.horzcat(part, ca.DM.zeros(len(tube), 1)) for part in (*stiff, x, y)]
    return Panels(width, before @ width, ca.horzcat(*padded, wound))


def own_stiffness(chain: Chain, coefficients: Array) -> Array:
    """(B,) the stiffness of the straight part of the tube of every panel, which is that of the tube."""
    return np.array([coefficients[(chain.tube == i) & (chain.piece < 0)][0, 0] for i in chain.tube])


def _rows(coefficients: Array, factor: Any) -> Any:
    """Coefficients (B, D) times a factor of each row."""
    return _rows_of(ca.DM(coefficients), factor)


def _rows_of(table: Any, factor: Any) -> Any:
    return table * ca.repmat(factor, 1, table.shape[1])


def joints(chain: Chain, laid: Panels, held: Any) -> list[Any]:
    """Arc lengths, m, where panels meet behind the transitions of tubes `held` (n,) m behind the plate."""
    behind = [k for k in range(1, len(chain.tube)) if chain.piece[k] >= 0 and chain.piece[k - 1] >= 0]
    return [laid.low[k] - held[int(chain.tube[k])] for k in behind]


def transmissions(chain: Chain, laid: Panels, plate: tuple[Any, Any], torsional_stiffness: Any) -> Any:
    """(n,) kt int ds / GJ from where tubes are held to the plate: `plate` is how far (n,) it is, m, and the panels
    (B,) in which it lies, 0 or 1."""
    held, pick = plate
    count, detail = len(chain.tube), chain.detail
    kt = laid.table[:, detail : 2 * detail].T
    mean = compliance_function(detail)
    whole = (laid.width * mean.map(count)(kt, -ca.DM.ones(1, count), ca.DM.ones(1, count)).T).T
    behind = ca.mtimes(ca.DM(chain.before).T, pick)
    out = []
    for i in range(torsional_stiffness.shape[0]):
        mine = np.flatnonzero(chain.tube == i).tolist()
        here, chosen = pick[mine], kt[:, mine]
        last = held[i] - ca.dot(here, laid.low[mine])
        high = 2 * last / ca.fmax(ca.dot(here, laid.width[mine]), POINT) - 1
        part = last * mean(chosen @ here, -1, high)
        out.append(torsional_stiffness[i] * (whole[:, mine] @ behind[mine] + part))
    return ca.vertcat(*out)


def columns(chain: Chain, laid: Panels, which: tuple[Any, Any], place: tuple[Any, Any]) -> Any:
    """What varies along every piece of a mesh, a column each, as `panel.local` reads it.

    Args:
        which: (B, P) the panel of each tube, 0 or 1, and (n, P) whether it is present.
        place: how far (n,) tubes are held behind the plate, and arc lengths (P + 1,) of the ends of the pieces, m.
    """
    (picked, present), (held, cuts) = which, place
    out = []
    pieces = picked.shape[1]
    for i in range(present.shape[0]):
        mine = np.flatnonzero(chain.tube == i).tolist()
        chosen = picked[mine, :]
        there = present[i, :]
        table = laid.table[mine, :].T @ chosen
        stiffness = table[: chain.detail, :] * ca.repmat(there, chain.detail, 1)
        low, width = (laid.low[mine].T @ chosen, ca.fmax(laid.width[mine].T @ chosen, POINT))
        ends = [2 * (held[i] + s - low) / width - 1 for s in (cuts[:pieces].T, cuts[1:].T)]
        # A tube that has ended is held as it is at its end.
        ends = [1 + there * (x - 1) for x in ends]
        out.append(ca.vertcat(stiffness, table[chain.detail :, :], *ends))
    return ca.vertcat(*out)


# --- Tubes from dimensions, and dimensions from tubes -----------------------------------------------------------------


def tubes_at(tubes: Sequence[Tube], inputs: Mapping[str, Array]) -> tuple[Tube, ...]:
    """Tubes at dimensions in numbers."""
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
            bending, torsional, x, y, z = (_quantity(joints, shape) for shape in shapes)
            own = (None if value == b else value for value, b in zip((bending, torsional), (kb, kt), strict=True))
            slots = tube.pieces[len(pieces)].slots if tube.pieces else None
            pieces.append(Piece(float(joints[-1]), (x, y, z), next(own), next(own), slots))
        out.append(_tube(tube, pieces, float(inputs["straight_length"][i]), (kb, kt)))
    return tuple(out)


def _quantity(joints: Array, table: Array) -> Quantity:
    rows = [chebyshev.chebtrim(row) for row in table]
    first = float(rows[0][0])
    if all(len(row) == 1 and row[0] == first for row in rows):
        return first
    return Series(tuple(joints.tolist()), tuple(tuple(row.tolist()) for row in rows))


def _tube(tube: Tube, pieces: list[Piece], straight: float, stiffness: tuple[float, float]) -> Tube:
    """A tube of these pieces."""
    bend, chain = max((piece.largest_curvature for piece in pieces), default=0.0), tuple(pieces)
    # A tube of pieces stays one, even where they are arcs about x: so do the unknowns of the block.
    if not tube.general and all(piece.plain for piece in pieces):
        bend, chain = (float(pieces[0].precurvature[0]) if pieces else tube.curvature), ()
    return remade(
        tube,
        straight_length=straight,
        curved_length=math.fsum(piece.length for piece in pieces),
        curvature=bend,
        bending_stiffness=stiffness[0],
        torsional_stiffness=stiffness[1],
        pieces=chain,
    )


def remade(tube: Tube, **own: Any) -> Tube:
    """A tube with other dimensions or pieces; a stiffness that is not changed keeps following the cross-section."""
    stiffness = ("bending_stiffness", "torsional_stiffness")
    return replace(tube, **{k: v for k, v in own.items() if k not in stiffness or v != getattr(tube, k)})


def piece_numbers(tubes: Sequence[Tube], like: Chain) -> dict[str, Array]:
    """PIECES of tubes, as changes of those behind `like`."""
    own = chain_of(tuple(tubes))
    if own.owner.tolist() != like.owner.tolist() or own.piece.tolist() != like.piece.tolist():
        raise InputError("the pieces of the tubes differ from those of the block")
    start = dict(own.start)
    first = [like.piece.tolist().index(k) for k in range(len(like.owner))]
    turned = np.arctan2(own.y, own.x)[first, 0] - np.arctan2(like.y, like.x)[first, 0]
    start["piece_plane"] = (turned + np.pi) % (2 * np.pi) - np.pi
    for name, mine, old in (("bending", own.kb, like.kb), ("torsion", own.kt, like.kt)):
        ratio = mine[first, 0] / own_stiffness(own, mine)[first] / (old[first, 0] / own_stiffness(like, old)[first])
        start[f"piece_{name}_factor"] = ratio
    return start

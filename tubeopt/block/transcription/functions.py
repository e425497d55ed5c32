"""CasADi functions of one piece, built once and mapped over the pieces of every block."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca

from ...physics.shape import quaternion_product, rotation_matrix
from ...physics.strain import bend_from_own
from .collocated import (
    Grid,
    LoadedPiece,
    Torsion,
    bending_of,
    energy_of,
    felt_of,
    motion_of,
    shape_of,
    softened_fields,
    symbols,
    torsion_of,
)

# --- Jacobi fields under a dead load ----------------------------------------------------------------------------------

# Jacobi fields of an arm under a dead load decide whether its equilibrium is a minimum.
#
# With rotations y of the tubes and a rotation phi of the frame, seen in it, the second variation under a dead load is
#
#     Q = int sum kt y'^2 + K |d|^2 + y' V'' y + sum ((u - u0).a_i) y_i^2
#         - m.(phi x du) - (nu.phi) phi_z + nu_z |phi|^2,         du = u0' y + d,    phi' = du - u x phi,
#
# with the whole moment m and the force nu in the frame. Its Euler equations are the linearised equilibrium,
#
#     kt y'' = (dM/dtheta) y + (dM/dm) g,     g' = -u x g + m x du + e3 x (phi x nu),     d = (du/dm) g,
#
# with kt and K softened by the fraction mu, as the margin has it: kt (1 - mu) y'' and g = (1 - mu) K d. From y, phi = 1
# and y' = g = 0 at the tip, Q less mu times its elastic part is positive as long as det (y, phi) > 0 along the arm and
# det (y - |beta| y', phi) > 0 at the plate, where the frame is held; where mu is the margin the latter is 0. A double
# zero, where two ways to buckle are equally easy, the sign of a determinant does not show, nor two zeros between places
# where it is asked for: the margin of the equilibrium that a block gives back tells of either.

FRAME = 3
"""Components of the rotation of the frame."""


def field_size(grid: Grid) -> int:
    """Components of a Jacobi field: rotations of the tubes, and of the frame where a load makes it matter."""
    return grid.n_tubes + FRAME * grid.loaded


def field_rows(grid: Grid) -> int:
    """Numbers of a field at a point that are unknowns: under load its rates too, since they depend on each other."""
    return 2 * field_size(grid) if grid.loaded else field_size(grid)


def field_rates(torsion: Torsion, margin: Any, typical: Any) -> Any:
    """(2 N, 2 N K) matrices of the linear equations of (y, phi, y', g / (1 - margin) / typical) at the points."""
    piece, n = torsion.piece, torsion.piece.grid.n_tubes
    assert isinstance(piece, LoadedPiece)
    kt, soft, e3 = ca.diag(1 / piece.torsional_stiffness), 1 / (1 - margin), ca.SX([0, 0, 1])
    out = []
    for k, ((here, torque, nu), x) in enumerate(zip(felt_of(torsion), piece.grid.tableau.nodes, strict=True)):
        theta, bent = piece.inner[:, k], piece.bent[:, k]
        turned, bends = (ca.vertcat(ca.jacobian(here.curvature, of), ca.SX(1, of.numel())) for of in (theta, bent))
        stiff, pulled = (kt @ ca.jacobian(here.moment, of) for of in (theta, bent))
        bends, pulled = (typical * ca.horzcat(part, ca.SX(part.shape[0], 1)) for part in (bends, pulled))
        u, m = ca.skew(ca.vertcat(here.curvature, 0)), ca.skew(ca.vertcat(bent, torque))
        # e3 x (phi x nu) = nu_z phi - phi_z nu
        tilted = nu[2] * ca.SX.eye(FRAME) - nu @ e3.T
        ease = ca.diag(ca.SX.ones(n) * piece.local(x).ease)
        moved = ca.horzcat(turned, -u, ca.SX(FRAME, n), bends)
        out.append(
            ca.vertcat(
                ca.horzcat(ca.SX(n, n + FRAME), ease, ca.SX(n, FRAME)),
                moved,
                ca.horzcat(soft * stiff, ca.SX(n, FRAME + n), pulled),
                ca.horzcat(soft * m @ turned, soft * tilted, ca.SX(FRAME, n), soft * m @ bends - u * typical) / typical,
            )
        )
    return ca.densify(ca.horzcat(*out))


def field_step(grid: Grid, length: Any, rates: Any, end: Any, inner: Any) -> tuple[Any, Any]:
    """A field (2 N,) where a piece begins, and the defect (2 N, K) of its collocated equations, from the field where
    the piece ends and at its points (2 N, K)."""
    t, count, n = grid.tableau, grid.degree, 2 * field_size(grid)
    slope = ca.horzcat(*(rates[:, k * n : (k + 1) * n] @ inner[:, k] for k in range(count)))
    defect = inner - ca.repmat(end, 1, count) + length * slope @ (t.weights - t.matrix).T
    return end - length * slope @ t.weights, defect


OPTIONS = {"cse": True}


@lru_cache(maxsize=64)
def _torsion(grid: Grid) -> Torsion:
    """The collocated torsion of a piece of symbols, which most functions begin with."""
    return torsion_of(symbols(grid))


@lru_cache(maxsize=64)
def torsion_function(grid: Grid) -> ca.Function:
    """Arguments of a piece -> defect (n, K), theta and w (n,) where it ends."""
    torsion = _torsion(grid)
    return ca.Function("torsion", torsion.piece.arguments, [torsion.defect, *torsion.end], OPTIONS)


@lru_cache(maxsize=64)
def bending_function(grid: Grid) -> ca.Function:
    """Arguments of a piece that bears a load -> defect (2, K), bending moment (2,) where it ends."""
    torsion = _torsion(grid)
    return ca.Function("bending", torsion.piece.arguments, list(bending_of(torsion)), OPTIONS)


@lru_cache(maxsize=64)
def pose_function(grid: Grid) -> ca.Function:
    """(q, p, arguments of a piece) -> q (4,), p (3,) where it ends."""
    torsion = _torsion(grid)
    q, p, arguments = *_pose(), torsion.piece.arguments
    turn, shift, _ = shape_of(torsion)[-1]
    end = [quaternion_product(q, turn), p + rotation_matrix(q) @ shift]
    return ca.Function("pose", [q, p, *arguments], end, OPTIONS)


@lru_cache(maxsize=64)
def places_function(grid: Grid) -> ca.Function:
    """(q, p, arguments of a piece) -> positions (3, 4) of its shape points after its beginning."""
    torsion = _torsion(grid)
    q, p = _pose()
    places = [p + rotation_matrix(q) @ shift for _, shift, _ in shape_of(torsion)]
    return ca.Function("places", [q, p, *torsion.piece.arguments], [ca.horzcat(*places)], OPTIONS)


@lru_cache(maxsize=64)
def inside_function(grid: Grid) -> ca.Function:
    """(q, p, x, arguments of a piece) -> q (4,), p (3,), theta (n,), w (n,), u (2,) at the fraction x of it; of tubes
    made of pieces also their natural turn, natural twist, and ease (n,)."""
    torsion = _torsion(grid)
    q, p = _pose()
    x = ca.SX.sym("x")
    turn, shift, _ = shape_of(torsion, x)[-1]
    end = [quaternion_product(q, turn), p + rotation_matrix(q) @ shift]
    theta, w = torsion.rotation(x), torsion.torsion(x)
    outputs = [*end, theta, w, torsion.piece.section(theta, x).curvature]
    if grid.detail:
        here = torsion.piece.local(x)
        outputs += [here.wound, ca.jacobian(here.wound, x) / torsion.piece.length, here.ease]
    return ca.Function("inside", [q, p, x, *torsion.piece.arguments], outputs, OPTIONS)


@lru_cache(maxsize=64)
def energy_function(grid: Grid) -> ca.Function:
    """Arguments of a piece -> its elastic energy, J."""
    torsion = _torsion(grid)
    return ca.Function("energy", torsion.piece.arguments, [energy_of(torsion)], OPTIONS)


@lru_cache(maxsize=64)
def motion_function(grid: Grid) -> ca.Function:
    """(theta (n,) where a piece begins, theta and w (n, K) at its points, what is given of it) -> `motion_of`
    concentric tubes."""
    piece, twist = symbols(grid), ca.SX.sym("control", grid.n_tubes, grid.degree)
    return ca.Function("motion", [piece.theta, piece.inner, twist, *piece.data], list(motion_of(piece, twist)), OPTIONS)


@lru_cache(maxsize=64)
def bend_function(grid: Grid) -> ca.Function:
    """(arguments of a piece, precurvatures (n,) there) -> (n, K) how far each tube is bent from its own curvature
    at the points, |u / g - u*|, 1/m, and its own there; tubes made of pieces have theirs from the arguments."""
    piece, natural = symbols(grid), ca.SX.sym("natural", grid.n_tubes)
    columns = []
    for k, x in enumerate(grid.tableau.nodes):
        theta, at = piece.inner[:, k], piece.local(x)
        here = piece.section(theta, x)
        own: Any = natural
        direction = ca.cos(theta), ca.sin(theta)
        if grid.detail:
            turned = theta + at.wound
            cos, sin, (a, b) = ca.cos(turned), ca.sin(turned), ca.horzsplit(at.natural)
            direction, own = (a * cos - b * sin, a * sin + b * cos), bend_from_own((a, b), ca.DM.zeros(2), 1.0)
        bent = bend_from_own(direction, here.curvature, 1.0 if grid.detail else natural, here.stretch)
        columns.append((bent, own))
    bends, owns = (ca.horzcat(*parts) for parts in zip(*columns, strict=True))
    return ca.Function("bend", [*piece.arguments, natural], [bends, owns], OPTIONS)


@lru_cache(maxsize=64)
def twist_function(grid: Grid) -> ca.Function:
    """Arguments of a piece -> w (n, K) at its points."""
    torsion = _torsion(grid)
    return ca.Function("twist", torsion.piece.arguments, [torsion.twist], OPTIONS)


@lru_cache(maxsize=64)
def softness_function(grid: Grid) -> ca.Function:
    """(margin, theta, w (n,), its place x, what is given of the piece) of one point -> what `softened_fields` needs."""
    piece = symbols(grid)
    margin, w, x = ca.SX.sym("margin"), ca.SX.sym("w", grid.n_tubes), ca.SX.sym("x")
    _, stiff, *stretching = piece.balance(piece.theta, x)
    outputs = [ca.diag(1 / ((1 - margin) * piece.torsional_stiffness)) @ stiff]
    outputs += [ca.diag(w) @ turned for turned in stretching[1:]] + stretching[:1]
    inputs = [margin, piece.theta, w, x, *piece.data]
    return ca.Function("softness", inputs, [ca.densify(part) for part in outputs], OPTIONS)


@lru_cache(maxsize=64)
def fields_function(grid: Grid) -> ca.Function:
    """(N Jacobi fields (2N, N) at the end, (R, K N) at the points, field by field, length, softness) of a piece ->
    fields (2N, N) at its beginning, defect (R, K N), with N and R of `field_size` and `field_rows`."""
    # Every field is the same function of few operations: for nine tubes, CasADi would write out the second derivatives
    # of all fields at once for minutes.
    n, rows = field_size(grid), field_rows(grid)
    end, inner, h = ca.SX.sym("fields", 2 * n), ca.SX.sym("inside", rows, grid.degree), ca.SX.sym("h")
    softness = _softness(grid)
    one = ca.Function("field", [end, inner, h, *softness], list(_field(grid, h, softness, end, inner)))
    return one.map("fields", "serial", n, list(range(2, one.n_in())), [])


def _field(grid: Grid, length: Any, softness: tuple[Any, ...], end: Any, inner: Any) -> tuple[Any, Any]:
    if grid.loaded:
        return field_step(grid, length, softness[0], end, inner)
    return softened_fields(grid, length, softness, end, inner)


@lru_cache(maxsize=64)
def field_matrix_function(grid: Grid) -> ca.Function:
    """(length, softness) of a piece -> (K R, K R) matrix of the defect of one field by its values at the points."""
    inner, h, softness = ca.SX.sym("inside", field_rows(grid), grid.degree), ca.SX.sym("h"), _softness(grid)
    defect = _field(grid, h, softness, ca.SX.zeros(2 * field_size(grid)), inner)[1]
    matrix = ca.densify(ca.jacobian(ca.vec(defect), ca.vec(inner)))
    return ca.Function("field_matrix", [h, *softness], [matrix], OPTIONS)


@lru_cache(maxsize=64)
def rates_function(grid: Grid) -> ca.Function:
    """(margin, a typical stiffness, arguments of a piece that bears a load) -> `field_rates` its points."""
    torsion, margin, typical = _torsion(grid), ca.SX.sym("margin"), ca.SX.sym("typical")
    rates = field_rates(torsion, margin, typical)
    return ca.Function("rates", [margin, typical, *torsion.piece.arguments], [rates], OPTIONS)


def _softness(grid: Grid) -> tuple[Any, ...]:
    n, count = grid.n_tubes, grid.degree
    if grid.loaded:
        whole = 2 * field_size(grid)
        return (ca.SX.sym("A", whole, whole * count),)
    gain, turned, stretch = ca.SX.sym("G", n, n * count), ca.SX.sym("S", n, n * count), ca.SX.sym("g", n, count)
    return (gain, *((turned,) * grid.eccentric), *((stretch,) * grid.stretched))


@lru_cache(maxsize=16)
def determinant_function(n: int) -> ca.Function:
    """(n, n) -> its determinant, with derivatives, which `casadi.det` of an MX has not; of more than three rows by
    elimination without pivoting, as fits matrices that begin as the identity."""
    whole = ca.SX.sym("matrix", n, n)
    product, rest = ca.SX(1), whole
    while rest.shape[0] > 3:
        pivot = rest[0, 0]
        product, rest = product * pivot, rest[1:, 1:] - rest[1:, 0] @ rest[0, 1:] / pivot
    return ca.Function("determinant", [whole], [product * ca.det(rest)], OPTIONS)


def _pose() -> tuple[Any, Any]:
    return ca.SX.sym("q", 4), ca.SX.sym("p", 3)

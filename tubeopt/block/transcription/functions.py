"""CasADi functions of one element, built once and mapped over the elements of every block."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca

from ...physics.shape import quaternion_product, rotation_matrix
from ...physics.strain import bend_from_own
from .collocated import (
    Grid,
    LoadedElement,
    Torsion,
    bending_of,
    controlled_torsion,
    energy_of,
    loaded_points,
    shape_of,
    softened,
    softened_fields,
    symbolic_element,
    torsion_of,
)

# --- Jacobi fields under a dead load ----------------------------------------------------------------------------------

# Jacobi fields of an arm under a dead load show whether its equilibrium is a minimum.
#
# With rotations y of the tubes and a rotation phi of the frame, seen in it, the second variation under a dead load is
#
#     Q = int sum kt y'^2 + K |d|^2 + y' V'' y + sum ((u - u0).a_i) y_i^2
#         - m.(phi x du) - (nu.phi) phi_z + nu_z |phi|^2,         du = u0' y + d,    phi' = du - u x phi,
#
# with the moment m and the force nu in the frame. Its Euler equations are the linearised equilibrium,
#
#     kt y'' = (dM/dtheta) y + (dM/dm) g,     g' = -u x g + m x du + e3 x (phi x nu),     d = (du/dm) g,
#
# with kt and K softened by the fraction mu, as in the margin: kt (1 - mu) y'' and g = (1 - mu) K d. From y, phi = 1 and
# y' = g = 0 at the tip, Q less mu times its elastic part is positive as long as det (y, phi) > 0 along the arm and
# det (y - |beta| y', phi) > 0 at the plate, where the frame is fixed. The latter is 0 if mu is the margin. The sign of
# a determinant does not show a double zero, where two buckling modes have the same eigenvalue, nor two zeros between
# points at which it is evaluated. `EquilibriumBlock.equilibrium` therefore computes the margin itself.

FRAME = 3
"""Components of the rotation of the frame."""


def field_size(grid: Grid) -> int:
    """Number of components of a Jacobi field: rotations of the tubes, under load also of the frame."""
    return grid.n_tubes + FRAME * grid.loaded


def field_rows(grid: Grid) -> int:
    """Number of unknowns of a field at a point; under load they include its rates, which are coupled."""
    return 2 * field_size(grid) if grid.loaded else field_size(grid)


def field_rates(torsion: Torsion, margin: Any, typical: Any) -> Any:
    """Matrices (2 N, 2 N K) of the linear equations of (y, phi, y', g) at the points.

    The column of g is scaled by 1 / (1 - margin) / typical.
    """
    element, n = torsion.element, torsion.element.grid.n_tubes
    assert isinstance(element, LoadedElement)
    kt, soft, e3 = ca.diag(1 / element.torsional_stiffness), 1 / (1 - margin), ca.SX([0, 0, 1])
    out = []
    for k, (point, x) in enumerate(zip(loaded_points(torsion), element.grid.tableau.nodes, strict=True)):
        section, nu = point.section, point.force
        theta, bending = element.inner[:, k], element.moment_inside[:, k]
        # Derivatives of the curvature (3,) and of M / kt, by theta and by the bending moment.
        u_theta, u_m = (ca.vertcat(ca.jacobian(section.curvature, v), ca.SX(1, v.numel())) for v in (theta, bending))
        w_theta, w_m = (kt @ ca.jacobian(section.moment, v) for v in (theta, bending))
        u_m, w_m = (typical * ca.horzcat(part, ca.SX(part.shape[0], 1)) for part in (u_m, w_m))
        u, m = ca.skew(ca.vertcat(section.curvature, 0)), ca.skew(ca.vertcat(bending, point.torque))
        # e3 x (phi x nu) = nu_z phi - phi_z nu
        tilted = nu[2] * ca.SX.eye(FRAME) - nu @ e3.T
        ratio = ca.diag(ca.SX.ones(n) * element.local(x).compliance_ratio)
        out.append(
            ca.vertcat(
                ca.horzcat(ca.SX(n, n + FRAME), ratio, ca.SX(n, FRAME)),
                ca.horzcat(u_theta, -u, ca.SX(FRAME, n), u_m),
                ca.horzcat(soft * w_theta, ca.SX(n, FRAME + n), w_m),
                ca.horzcat(soft * m @ u_theta, soft * tilted, ca.SX(FRAME, n), soft * m @ u_m - u * typical) / typical,
            )
        )
    return ca.densify(ca.horzcat(*out))


def field_step(grid: Grid, length: Any, rates: Any, end: Any, inner: Any) -> tuple[Any, Any]:
    """Field (2 N,) at the start of an element, and defect (2 N, K) of its collocated equations.

    Args:
        end: field (2 N,) at the end of the element.  inner: field (2 N, K) at its points.
    """
    t, count, n = grid.tableau, grid.degree, 2 * field_size(grid)
    slope = ca.horzcat(*(rates[:, k * n : (k + 1) * n] @ inner[:, k] for k in range(count)))
    defect = inner - ca.repmat(end, 1, count) + length * slope @ (t.weights - t.matrix).T
    return end - length * slope @ t.weights, defect


OPTIONS = {"cse": True}


@lru_cache(maxsize=64)
def _torsion(grid: Grid) -> Torsion:
    """Collocated torsion of a symbolic element, shared by the functions below."""
    return torsion_of(symbolic_element(grid))


@lru_cache(maxsize=64)
def torsion_function(grid: Grid) -> ca.Function:
    """Function (arguments of an element) -> defect (n, K), theta and w (n,) where it ends."""
    torsion = _torsion(grid)
    return ca.Function("torsion", torsion.element.arguments, [torsion.defect, *torsion.end], OPTIONS)


@lru_cache(maxsize=64)
def bending_function(grid: Grid) -> ca.Function:
    """Function (arguments of an element under load) -> defect (2, K), bending moment (2,) where it ends."""
    torsion = _torsion(grid)
    return ca.Function("bending", torsion.element.arguments, list(bending_of(torsion)), OPTIONS)


@lru_cache(maxsize=64)
def pose_function(grid: Grid) -> ca.Function:
    """Function (q, p, arguments of an element) -> q (4,), p (3,) where it ends."""
    torsion = _torsion(grid)
    q, p, arguments = *_pose(), torsion.element.arguments
    last = shape_of(torsion)[-1]
    end = [quaternion_product(q, last.turn), p + rotation_matrix(q) @ last.shift]
    return ca.Function("pose", [q, p, *arguments], end, OPTIONS)


@lru_cache(maxsize=64)
def positions_function(grid: Grid) -> ca.Function:
    """Function (q, p, arguments of an element) -> positions (3, 4) of its shape points but the first."""
    torsion = _torsion(grid)
    q, p = _pose()
    positions = [p + rotation_matrix(q) @ pose.shift for pose in shape_of(torsion)]
    return ca.Function("positions", [q, p, *torsion.element.arguments], [ca.horzcat(*positions)], OPTIONS)


@lru_cache(maxsize=64)
def inside_function(grid: Grid) -> ca.Function:
    """Function (q, p, x, arguments of an element) -> pose and torsion at the fraction x of the element.

    The results are q (4,), p (3,), theta (n,), w (n,) and u (2,).

    Of tubes made of pieces also natural turn, natural twist and compliance ratio (n,).
    """
    torsion = _torsion(grid)
    q, p = _pose()
    x = ca.SX.sym("x")
    last = shape_of(torsion, x)[-1]
    end = [quaternion_product(q, last.turn), p + rotation_matrix(q) @ last.shift]
    theta, w = torsion.rotation(x), torsion.torsion(x)
    outputs = [*end, theta, w, torsion.element.section(theta, x).curvature]
    if grid.detail:
        tubes = torsion.element.local(x)
        twist = ca.jacobian(tubes.natural_turn, x) / torsion.element.length
        outputs += [tubes.natural_turn, twist, tubes.compliance_ratio]
    return ca.Function("inside", [q, p, x, *torsion.element.arguments], outputs, OPTIONS)


@lru_cache(maxsize=64)
def energy_function(grid: Grid) -> ca.Function:
    """Function (arguments of an element) -> elastic energy, J."""
    torsion = _torsion(grid)
    return ca.Function("energy", torsion.element.arguments, [energy_of(torsion)], OPTIONS)


@lru_cache(maxsize=64)
def motion_function(grid: Grid) -> ca.Function:
    """Function (theta (n,) at the start, theta and w (n, K) at points, data of an element) -> `ControlledTorsion`."""
    element, twist = symbolic_element(grid), ca.SX.sym("control", grid.n_tubes, grid.degree)
    outputs = list(controlled_torsion(element, twist))
    return ca.Function("motion", [element.theta, element.inner, twist, *element.data], outputs, OPTIONS)


@lru_cache(maxsize=64)
def bend_function(grid: Grid) -> ca.Function:
    """Function (arguments of an element, precurvatures (n,)) -> |u / g - u*| and |u*| (n, K) at the points, 1/m.

    The precurvatures of tubes made of pieces are in the arguments of the element.
    """
    element, natural = symbolic_element(grid), ca.SX.sym("natural", grid.n_tubes)
    changes, sizes = [], []
    for k, x in enumerate(grid.tableau.nodes):
        theta, tubes = element.inner[:, k], element.local(x)
        section = element.section(theta, x)
        size: Any = natural
        direction = ca.cos(theta), ca.sin(theta)
        if grid.detail:
            turned = theta + tubes.natural_turn
            cos, sin, (a, b) = ca.cos(turned), ca.sin(turned), ca.horzsplit(tubes.natural)
            direction, size = (a * cos - b * sin, a * sin + b * cos), bend_from_own((a, b), ca.DM.zeros(2), 1.0)
        changes.append(bend_from_own(direction, section.curvature, 1.0 if grid.detail else natural, section.stretch))
        sizes.append(size)
    outputs = [ca.horzcat(*changes), ca.horzcat(*sizes)]
    return ca.Function("bend", [*element.arguments, natural], outputs, OPTIONS)


@lru_cache(maxsize=64)
def twist_function(grid: Grid) -> ca.Function:
    """Function (arguments of an element) -> torsion w (n, K) at its points, rad/m."""
    torsion = _torsion(grid)
    return ca.Function("twist", torsion.element.arguments, [torsion.twist], OPTIONS)


@lru_cache(maxsize=64)
def softness_function(grid: Grid) -> ca.Function:
    """Function (margin, theta, w (n,), fraction x, data of an element) -> coefficients `softened` of Jacobi fields."""
    element = symbolic_element(grid)
    margin, w, x = ca.SX.sym("margin"), ca.SX.sym("w", grid.n_tubes), ca.SX.sym("x")
    outputs = softened(element, element.theta, w, x, margin)
    inputs = [margin, element.theta, w, x, *element.data]
    return ca.Function("softness", inputs, [ca.densify(part) for part in outputs], OPTIONS)


@lru_cache(maxsize=64)
def fields_function(grid: Grid) -> ca.Function:
    """Function from N Jacobi fields at the end of an element to those at its start.

    (fields (2N, N) at the end, (R, K N) at the points, field by field, length, softness) -> fields (2N, N) at the
    start, defect (R, K N), with N and R of `field_size` and `field_rows`.
    """
    # One small function is mapped over the fields: for nine tubes, second derivatives of all fields in one function
    # would take CasADi minutes.
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
    """Function (length, softness) of an element -> derivative (K R, K R) of a field's defect by its inner values."""
    inner, h, softness = ca.SX.sym("inside", field_rows(grid), grid.degree), ca.SX.sym("h"), _softness(grid)
    defect = _field(grid, h, softness, ca.SX.zeros(2 * field_size(grid)), inner)[1]
    matrix = ca.densify(ca.jacobian(ca.vec(defect), ca.vec(inner)))
    return ca.Function("field_matrix", [h, *softness], [matrix], OPTIONS)


@lru_cache(maxsize=64)
def rates_function(grid: Grid) -> ca.Function:
    """Function (margin, typical stiffness, arguments of an element under load) -> `field_rates` at its points."""
    torsion, margin, typical = _torsion(grid), ca.SX.sym("margin"), ca.SX.sym("typical")
    rates = field_rates(torsion, margin, typical)
    return ca.Function("rates", [margin, typical, *torsion.element.arguments], [rates], OPTIONS)


def _softness(grid: Grid) -> tuple[Any, ...]:
    n, count = grid.n_tubes, grid.degree
    if grid.loaded:
        size = 2 * field_size(grid)
        return (ca.SX.sym("A", size, size * count),)
    gain, turned, stretch = ca.SX.sym("G", n, n * count), ca.SX.sym("S", n, n * count), ca.SX.sym("g", n, count)
    return (gain, *((stretch,) * grid.stretched), *((turned,) * grid.eccentric))


@lru_cache(maxsize=16)
def determinant_function(n: int) -> ca.Function:
    """Function matrix (n, n) -> determinant, with derivatives, which `casadi.det` of an MX does not have."""
    matrix = ca.SX.sym("matrix", n, n)
    product, remainder = ca.SX(1), matrix
    # Elimination without pivoting: the matrices are close to the identity at the tip.
    while remainder.shape[0] > 3:
        pivot = remainder[0, 0]
        product, remainder = product * pivot, remainder[1:, 1:] - remainder[1:, 0] @ remainder[0, 1:] / pivot
    return ca.Function("determinant", [matrix], [product * ca.det(remainder)], OPTIONS)


def _pose() -> tuple[Any, Any]:
    return ca.SX.sym("q", 4), ca.SX.sym("p", 3)

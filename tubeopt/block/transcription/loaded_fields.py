"""Jacobi fields of an arm that bears a dead load: what decides whether its equilibrium is a minimum.

With rotations y of the tubes and a rotation phi of the frame, seen in it, the second variation under a dead load is

    Q = int sum kt y'^2 + K |d|^2 + y' V'' y + sum ((u - u0).a_i) y_i^2
        - m.(phi x du) - (nu.phi) phi_z + nu_z |phi|^2,         du = u0' y + d,    phi' = du - u x phi,

with the whole moment m and the force nu in the frame. Its Euler equations are the linearised equilibrium,

    kt y'' = (dM/dtheta) y + (dM/dm) g,     g' = -u x g + m x du + e3 x (phi x nu),     d = (du/dm) g,

with kt and K softened by the fraction mu, as the margin has it: kt (1 - mu) y'' and g = (1 - mu) K d. From y, phi = 1
and y' = g = 0 at the tip, Q less mu times its elastic part is positive as long as det (y, phi) > 0 along the arm and
det (y - |beta| y', phi) > 0 at the plate, where the frame is held; where mu is the margin the latter is 0. A double
zero, where two ways to buckle are equally easy, the sign of a determinant does not show, nor two zeros between places
where it is asked for: the margin of the equilibrium that a block gives back tells of either.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from .collocated import Grid, LoadedPiece, Torsion, felt_of

FRAME = 3
"""Components of the rotation of the frame."""


def size(grid: Grid) -> int:
    """Components of a Jacobi field: rotations of the tubes, and of the frame where a load makes it matter."""
    return grid.n_tubes + FRAME * grid.loaded


def rows(grid: Grid) -> int:
    """Numbers of a field at a point that are unknowns: under load its rates too, since they depend on each other."""
    return 2 * size(grid) if grid.loaded else size(grid)


def rates_of(torsion: Torsion, margin: Any, typical: Any) -> Any:
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


def marched(grid: Grid, length: Any, rates: Any, end: Any, inner: Any) -> tuple[Any, Any]:
    """A field (2 N,) where a piece begins, and the defect (2 N, K) of its collocated equations, from the field where
    the piece ends and at its points (2 N, K)."""
    t, count, n = grid.tableau, grid.degree, 2 * size(grid)
    slope = ca.horzcat(*(rates[:, k * n : (k + 1) * n] @ inner[:, k] for k in range(count)))
    defect = inner - ca.repmat(end, 1, count) + length * slope @ (t.weights - t.matrix).T
    return end - length * slope @ t.weights, defect

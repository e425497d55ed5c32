"""Collocation tableaux on [0, 1]: Gauss-Legendre and Radau IIA of any degree.

Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I (II.7) and II (IV.5).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import ArrayLike

from ...errors import InputError, choice
from ...typing import Array

FAMILIES = ("gauss", "radau")


@dataclass(frozen=True, eq=False)
class Tableau:
    """Butcher tableau of a collocation method with K nodes on [0, 1]."""

    family: str
    """Name of the family, "gauss" or "radau"."""
    nodes: Array
    """Nodes c (K,) of the quadrature on [0, 1]."""
    weights: Array
    """Weights b (K,) of the quadrature on [0, 1]."""
    matrix: Array
    """Runge-Kutta matrix a (K, K)."""
    legendre_of_lagrange: Array
    """Legendre coefficients (K, K) on [-1, 1] of the Lagrange polynomials, by column: stable to integrate."""

    @property
    def degree(self) -> int:
        """Number of collocation points K."""
        return len(self.nodes)

    @cached_property
    def adjoint(self) -> Array:
        """Matrix (K, K) b_j - a_ji b_j / b_i of the symplectic partitioned method with `matrix`.

        For Gauss nodes it equals `matrix`.

        With it for theta'' the collocated equations are the stationarity conditions of an energy (Hairer, Lubich,
        Wanner, Geometric Numerical Integration, II.1.4 and VI.4).
        """
        return np.asarray(self.weights - self.matrix.T * self.weights / self.weights[:, None])

    @cached_property
    def integration(self) -> Array:
        """(K + 1, K) integration from 0 to the nodes, and to 1."""
        return np.concatenate([self.matrix, self.weights[None]])

    @cached_property
    def adjoint_integration(self) -> Array:
        """(K + 1, K) integration from 0 to the nodes by `adjoint`, and to 1."""
        return np.concatenate([self.adjoint, self.weights[None]])

    def lagrange(self, at: ArrayLike, *, integrals: int = 0) -> Array:
        """Values (T, K) of the Lagrange polynomials at `at` (T,) in [0, 1].

        They are integrated `integrals` times from 0; -1 are their derivatives.
        """
        x = 2 * np.asarray(at, dtype=float) - 1
        coefficients = self.integrated(integrals)
        return np.asarray(legendre.legvander(x, len(coefficients) - 1) @ coefficients)

    def integrated(self, times: int) -> Array:
        """Legendre coefficients (K + times, K) on [-1, 1], by column, of the Lagrange polynomials integrated from 0."""
        return _integrated(self.family, self.degree, times)

    def basis(self, at: tuple[float, ...], integrals: int) -> Array:
        """Cached `lagrange` at fixed points; the array must not be changed."""
        return _basis(self.family, self.degree, at, integrals)


@lru_cache(maxsize=128)
def _basis(family: str, degree: int, at: tuple[float, ...], integrals: int) -> Array:
    return tableau(family, degree).lagrange(at, integrals=integrals)


@lru_cache(maxsize=64)
def _integrated(family: str, degree: int, integrals: int) -> Array:
    coefficients = tableau(family, degree).legendre_of_lagrange
    if integrals < 0:
        return np.asarray(legendre.legder(coefficients, m=-integrals, scl=2.0))
    return np.asarray(legendre.legint(coefficients, m=integrals, lbnd=-1, scl=0.5)) if integrals else coefficients


@lru_cache(maxsize=64)
def tableau(family: str = "gauss", degree: int = 6) -> Tableau:
    """Collocation tableau with `degree` nodes of the family "gauss" or "radau" (right end included).

    Raises:
        InputError: unknown family, or degree below 1.
    """
    choice("family", family, FAMILIES)
    if degree < 1:
        raise InputError(f"degree is {degree}; it must be at least 1")
    if family == "gauss":
        x = legendre.leggauss(degree)[0]
    else:
        # Radau IIA: the roots of P_K - P_{K-1} on [-1, 1], the last of which is 1 exactly.
        x = np.sort(legendre.legroots([0.0] * (degree - 1) + [-1.0, 1.0]).real)
        x[-1] = 1.0
    # Powers of x would make this matrix ill-conditioned; Legendre polynomials keep it near orthogonal.
    coefficients = np.linalg.inv(legendre.legvander(x, degree - 1))
    # a_ij = int_0^c_i of the j-th Lagrange polynomial and b_j = int_0^1; 0.5 maps [-1, 1] to [0, 1].
    once = legendre.legint(coefficients, lbnd=-1, scl=0.5)
    return Tableau(
        family=family,
        nodes=(x + 1) / 2,
        weights=np.asarray(legendre.legval(1.0, once), dtype=float),
        matrix=np.asarray(legendre.legval(x, once).T, dtype=float).reshape(degree, degree),
        legendre_of_lagrange=np.asarray(coefficients, dtype=float),
    )

"""Small symbolic matrices."""

from __future__ import annotations

from typing import Any

import casadi as ca


def determinant(matrix: Any) -> Any:
    """Determinant; of more than three rows by elimination without pivoting, as fits matrices that begin as the
    identity."""
    n = matrix.shape[0]
    if n <= 3:
        return ca.det(matrix)
    product: Any = 1.0
    for _ in range(n - 1):
        pivot = matrix[0, 0]
        product = product * pivot
        matrix = matrix[1:, 1:] - matrix[1:, 0] @ matrix[0, 1:] / pivot
    return product * matrix[0, 0]

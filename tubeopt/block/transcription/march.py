"""From the tip to the plate over a piece of the mesh, in one call: torsion, and Jacobi fields of softened tubes where a
program must stay small."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ...physics.torsion import section_functions
from .collocated import Piece, Torsion

Columns = list[Any]


@lru_cache(maxsize=64)
def march_function(n: int, eccentric: bool, slopes: bool, steps: int, varying: bool = False) -> ca.Function:
    """Steps of the classical method on a piece of the mesh.

    From (theta, torque, travel (n,)[, derivatives (n, n) of theta and of the torque by the tip angles], h (steps,) m,
    1 / kt, kb, m (n,)[, offset, angle (n,)]) at its far end to the same state at its near end, and theta and theta'
    (n, steps + 1) where the steps begin and end. `travel` is the length of every tube so far, m; h is counted towards
    the base. The last two inputs are those of eccentric tubes.

    Where cross-sections are `varying` along the piece, theta is the elastic rotation, and 1 / kt, kb, m and phase
    (n (2 steps + 1),), from the near end on where the steps end, are half-way and begin, stand for 1 / kt, kb and m.
    """
    step = _step_function(n, eccentric, slopes, varying)
    state, places = _state(ca.MX, n, slopes), 2 * steps + 1 if varying else 1
    h = ca.MX.sym("h", steps)
    constants = [ca.MX.sym("constant", n * places) for _ in range(_given(eccentric, varying))]
    tables = [ca.reshape(part, n, places) for part in constants]
    here, passed, rates = state, [state[0]], []
    for k in range(steps):
        far = 2 * (steps - k)
        given = [part[:, at] for at in (far, far - 1, far - 2) for part in tables] if varying else constants
        *here, rate = step(*here, h[k], *given)
        passed.append(here[0])
        rates.append(rate)
    stretch = section_functions(n, True)["moment"](here[0], *constants[1:])[1] if eccentric else 1
    rates.append(stretch * tables[0][:, 0] * here[1])
    return ca.Function("march", [*state, h, *constants], [*here, ca.horzcat(*passed), ca.horzcat(*rates)])


def _state(kind: Any, n: int, slopes: bool) -> Columns:
    return [kind.sym("state", *shape) for shape in [(n, 1)] * 3 + [(n, n)] * (2 if slopes else 0)]


def _given(eccentric: bool, varying: bool) -> int:
    """How many vectors tell of a cross-section."""
    return 4 if varying else 5 if eccentric else 3


@lru_cache(maxsize=32)
def _step_function(n: int, eccentric: bool, slopes: bool, varying: bool) -> ca.Function:
    """One of these steps: the state after it, and theta' where it began."""
    state, h = _state(ca.SX, n, slopes), ca.SX.sym("h")
    sections = [
        [ca.SX.sym("constant", n) for _ in range(_given(eccentric, varying))] for _ in range(3 if varying else 1)
    ]
    section_function = section_functions(n, eccentric)["balance" if slopes else "moment"]

    def rates(at: Columns, half: int) -> Columns:
        """By arc length; the travel grows towards the base."""
        theta, torque = at[:2]
        rate, *section = sections[half if varying else 0]
        if varying:
            theta = theta + section.pop()
        out = section_function.call([theta, *section])
        stretch = (out[3] if slopes else out[1]) if eccentric else ca.SX.ones(n)
        own = [stretch * rate * torque, out[0], -stretch]
        if not slopes:
            return own
        theta_by_tip, torque_by_tip = at[3:]
        turned = ca.diag(stretch * rate) @ torque_by_tip
        if eccentric:
            turned += ca.diag(rate * torque) @ (out[4] @ theta_by_tip)
        return [*own, turned, out[1] @ theta_by_tip]

    after = [ca.densify(part) for part in classical_step(state, rates, -h)]
    given = [part for section in sections for part in section]
    return ca.Function("step", [*state, h, *given], [*after, rates(state, 0)[0]], {"cse": True})


def classical_step(state: Columns, rates: Callable[[Columns, int], Columns], h: Any) -> Columns:
    """The state after a step h of Runge and Kutta's classical method; `rates` of a state some halves of it on."""
    slopes = [rates(state, 0)]
    for half in (1, 1, 2):
        slopes.append(rates([a + half / 2 * h * b for a, b in zip(state, slopes[-1], strict=True)], half))
    mean = [(a + 2 * (b + c) + d) / 6 for a, b, c, d in zip(*slopes, strict=True)]
    return [a + h * b for a, b in zip(state, mean, strict=True)]


# --- Jacobi fields ----------------------------------------------------------------------------------------------------

SOFT_NODES = np.array([0.0, 1 / 3, 1 / 2, 2 / 3, 1.0])
"""Where a step of Butcher's method of order 6 needs its right-hand side."""

_STAGES = (0, 1, 3, 1, 2, 2, 4)
_BUTCHER = (
    (),
    (1 / 3,),
    (0, 2 / 3),
    (1 / 12, 1 / 3, -1 / 12),
    (-1 / 16, 9 / 8, -3 / 16, -3 / 8),
    (0, 9 / 8, -3 / 8, -3 / 4, 1 / 2),
    (9 / 44, -9 / 11, 63 / 44, 18 / 11, 0, -16 / 11),
)
_WEIGHTS = (11 / 120, 0, 27 / 40, 27 / 40, -4 / 15, -4 / 15, 11 / 120)

SOFT_STEPS = 2
"""Steps of that method per piece: margins below 0.9 to about 1e-6."""


def marched_fields(torsion: Torsion, fields: Any, margin: Any) -> Any:
    """Jacobi fields (2n, n) at the beginning of a piece from those at its end, tubes softened by the fraction `margin`.

    The fields are those of `softened_fields`.

    Method: J. C. Butcher, J. Austral. Math. Soc. 4 (1964), order 6 in 7 stages.
    """
    piece, n = torsion.piece, torsion.piece.grid.n_tubes
    h = piece.length / SOFT_STEPS
    for step in reversed(range(SOFT_STEPS)):
        x = (step + SOFT_NODES) / SOFT_STEPS
        theta, w = torsion.rotation(x), torsion.torsion(x)
        rates = [_field_rate(piece, x[k], (theta[:, k], w[:, k]), margin) for k in range(len(x))]
        slopes: list[Any] = []
        for stage, row in zip(_STAGES, _BUTCHER, strict=True):
            at = fields - h * sum((a * k for a, k in zip(row, slopes, strict=True)), ca.SX.zeros(2 * n, n))
            # Towards the plate: the node at fraction c of the step lies at 1 - c of the stretch.
            slopes.append(rates[len(x) - 1 - stage](at))
        fields = fields - h * sum(b * k for b, k in zip(_WEIGHTS, slopes, strict=True))
    return fields


def _field_rate(piece: Piece, x: float, at: tuple[Any, Any], margin: Any) -> Any:
    """The right-hand side of the Jacobi fields at the fraction x of a piece, theta and w there, as a function of the
    fields."""
    n, (theta, w) = piece.grid.n_tubes, at
    _, stiff, *stretching = piece.balance(theta, x)
    gain = ca.diag(1 / ((1 - margin) * piece.torsional_stiffness)) @ stiff

    def rate(fields: Any) -> Any:
        y, v = fields[:n, :], fields[n:, :]
        turned = ca.diag(stretching[0]) @ v if stretching else v
        if len(stretching) > 1:
            turned += ca.diag(w) @ (stretching[1] @ y)
        return ca.vertcat(turned, gain @ y)

    return rate

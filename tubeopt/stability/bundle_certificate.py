"""Certificate of bundles: a lower bound of the second variation of their energy at all equilibria within bounds.

In an arm whose boundaries (ends of tubes, and places where they begin to curve) keep their order, let y_i be the change
of a rotation, v that of the curvature u of the centreline, X_b that of the place of a boundary. With the change w'_i of
a tube's own twist w_i, eta_i' = g_i w'_i, eta_i = y_i at the plate, the second variation at an equilibrium is

    Q = sum_i int kt_i eta_i'^2 / g_i + springs + int (sum_i kb_i |v - u b_i / g_i|^2 / g_i + kb_s |v|^2)
        - int sum_i 2 m_i (n_i.v) y_i - m_i (e_i.u) y_i^2 + sum over boundaries b,      b_i = d_i a_i.v,
    y_i = eta_i + int_0^s w_i b_i + sum_{b < s} w_i (g_i^- - g_i^+) X_b,    int_0^b b_i + g_i^- X_b + (...) = 0.

A boundary adds -2 X_b m_i (n_i.u^-) y_i of the tube that ends there, the same with u^+ and + of one that begins to
curve, -2 X_b m_i n_i.(u^- - u^+) y_i of every tube that goes on, and terms in w_i X_b^2. `Bounds` are those of all
equilibria at all rotations: with them Q >= T - N, where T = sum int kt eta'^2 / (1 + d U) + springs + int K |r|^2 and N
is a form of Y_i = |y_i(0)| + int |eta_i'| and R = |r|, r = v - sum m_i n_i eta_i / K, with coefficients above 0. The
derivation is in docs/theory-proofs.md. If T - N is positive for every scale of the precurvatures from 0 to 1, each set
of rotations has one equilibrium within the bounds, which moves smoothly: nothing snaps.

Derivatives are complex steps: f(x + j h y) = f(x) + j h f'(x) y to round-off for a small h. All functions here allow
complex numbers, and compare them by their real parts first. So they differentiate the branches that count.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import numpy as np

from ..block.transcription.bundle import SAME_PLACE, Boundary, Bundle, boundaries, tubes_of_sections
from ..block.transcription.tableau import tableau
from ..equilibrium.linearised_bundle import CHANGED
from ..typing import Array, Mask

CONTRACTIONS = 100
"""Maximum number of steps to the fixed point of the bounds; a step gains a factor of about d kappa."""

TWISTS = 3
"""Number of times that twist, axial forces and the curvature across the tubes bound one another."""

RESERVE = 1e-6
"""Relative increase of the bounds of curvature beyond their fixed point."""

ROUND_OFF = 1e-15
"""Width of a strip, and distance of two offsets, m, below which they are round-off."""

STEP = 1e-30
"""Complex step of the derivatives: products of two of them are far below round-off, and do not underflow."""

DEGREE, ELEMENTS = 6, 5
"""Points per element, and elements in the length of the arm. More of either change certificates by 1e-15."""


def _size(x: Array) -> Array:
    """Magnitudes; of complex numbers by their real parts, at 0 by their imaginary parts."""
    if not np.iscomplexobj(x):
        return np.abs(x)
    return np.where(x.real != 0, x * np.sign(x.real), 1j * np.abs(x.imag))


def _norm(x: Array) -> Array:
    """Lengths (...,) of vectors (..., 2)."""
    return np.asarray(np.sqrt((x * x).sum(-1)))


def _largest_eigenvalue(matrix: Array) -> Any:
    """Largest eigenvalue of a symmetric matrix: its derivative is that of the form at its eigenvector."""
    if not np.iscomplexobj(matrix):
        return np.linalg.eigvalsh(matrix)[-1]
    values, vectors = np.linalg.eigh(matrix.real)
    v = vectors[:, -1]
    return values[-1] + 1j * (v @ matrix.imag @ v)


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of the equilibria that motions from home can reach, on m sections between boundaries in order."""

    order: tuple[Boundary, ...]
    """Boundaries at which the sections end."""
    own_length: Array
    """Own arc length (m,) of the tubes of each boundary from the plate, m."""
    present: Mask
    """Tubes (m, n) of the sections."""
    moment: Array
    """Natural moments |kb kappa_0| (m, n) of the tubes that are curved there, N m."""
    stiffness: Array
    """Bending stiffness K (m,) of tubes and sheath, N m^2."""
    curvature: Array
    """Curvature U (m,), 1/m."""
    bend: Array
    """Integral (m,) of the curvature up to each boundary, rad."""
    place: Array
    """First and last arc lengths (2, m) of each boundary, m."""
    off_balance: Array
    """Distance (m,) of K u from the sum of natural moments: by axial forces and by stretch, N m."""
    across: Array
    """Curvature (m, n) across a tube's own direction of bending, which alone twists the tube, 1/m."""

    @property
    def jump(self) -> Array:
        """Jump (m,) of the curvature at the boundaries, 1/m; 0 at the tip."""
        u, K, off = self.curvature, self.stiffness, self.off_balance
        gained = _size(np.diff(self.moment, axis=0)).sum(1) - np.diff(K) * u[:-1] + off[:-1] + off[1:]
        return np.append(np.minimum(u[:-1] + u[1:], gained / K[1:]), 0.0)


def bounds_of(bundle: Bundle) -> Bounds | None:
    """Bounds of equilibria that keep the order of boundaries; None if tubes curve too tightly for the estimates.

    An equilibrium with |u| <= U is in balance with |u| < U. So none can leave this range while precurvatures grow from
    0 to their values.
    """
    real = replace(bundle, **{field.name: np.real(getattr(bundle, field.name)) for field in fields(bundle)})
    order = tuple(sorted(boundaries(real), key=lambda b: b.arc_length))
    own_length = np.array([bundle.end[b.ends[0]] if b.ends else bundle.transition[b.tubes[0]] for b in order])
    present, curved = tubes_of_sections(bundle, order)
    moment = _size(bundle.bending_stiffness * bundle.curvature) * curved
    kb = bundle.bending_stiffness * present
    stiffness = kb.sum(1) + bundle.sheath
    # |sum kb_i d_i a_i|: 0 for equal tubes spread evenly around the centreline.
    uneven = _norm(kb @ bundle.levers)

    def at(curvature: Array) -> Bounds | None:
        stretch = bundle.offset * curvature[:, None]
        if (stretch >= 0.5).any():
            return None
        bend, place = _places(bundle, order, own_length, curvature)
        lengths = place[1] - np.append(0.0, place[0, :-1])
        # |u| (K - uneven |u|) is at most the sum of all moments in balance.
        room = stiffness - uneven * curvature
        if (room <= 0).any():
            return None
        across = np.tile(curvature[:, None], present.shape[1])
        for _ in range(TWISTS):
            twist = (moment * across * lengths[:, None]).sum(0) / bundle.torsional_stiffness
            axial = _axial_moment(bundle, order, present, curvature, twist)
            off = uneven * curvature**2 + (kb * stretch**2 / (1 - stretch)).sum(1) * curvature + axial
            of_others = moment.sum(1, keepdims=True) - moment + off[:, None]
            across = np.minimum(curvature[:, None], of_others / stiffness[:, None])
        balanced = (moment.sum(1) + axial) / room
        return Bounds(order, own_length, present, moment, stiffness, balanced, bend, place, off, across)

    # The reserve is part of the map: on sections without curved tubes U is of second order in the others.
    curvature = moment.sum(1) / stiffness
    for _ in range(CONTRACTIONS):
        if (next_bounds := at(curvature)) is None:
            return None
        larger = (1 + RESERVE) * next_bounds.curvature
        change, curvature = np.abs(larger - curvature).max(), larger
        if change <= 1e-14 * curvature.max():
            break
    found = at(curvature)
    if found is None or (found.curvature > (1 - RESERVE / 2) * curvature).any():
        return None
    return replace(found, curvature=curvature)


def _places(bundle: Bundle, order: tuple[Boundary, ...], own: Array, curvature: Array) -> tuple[Array, Array]:
    """Largest bends (m,) up to the boundaries, rad, and their first and last arc lengths (2, m), m."""
    bend, place = np.zeros_like(curvature), np.zeros((2, len(order)), curvature.dtype)
    reached = before = curvature.dtype.type(0)
    for k, boundary in enumerate(order):
        # s = own length - int d a.u, and the section begins at `before` or later.
        d, u = bundle.offset[boundary.tubes[0]], curvature[k]
        last = max((own[k] + d * (reached - u * before)) / (1 - d * u), before)
        reached += u * (last - before)
        before = max(own[k] - d * reached, before)
        bend[k], place[:, k] = reached, (before, max(last, before))
    return bend, place


def _axial_moment(bundle: Bundle, order: tuple[Boundary, ...], present: Mask, curvature: Array, twist: Array) -> Array:
    """Bounds (m,) of sum d N of the axial forces N at all offsets, N m.

    At a boundary N of its tubes jumps by what the energies kb v^2 / 2 of the others jump. Between two boundaries of one
    offset N + kb v^2 / 2 + kt w^2 / 2 is constant.
    """
    n = present.shape[1]
    own = np.vstack([curvature[:, None] / (1 - bundle.offset * curvature[:, None]), np.zeros(n)])
    both = np.maximum(own[:-1], own[1:]) ** 2
    on = np.vstack([present[1:], np.zeros(n, dtype=bool)])
    released = bundle.bending_stiffness * on * both / 2
    sheath = bundle.sheath * np.maximum(curvature, np.append(curvature[1:], 0.0)) ** 2 / 2
    out = np.zeros_like(curvature)
    left = list(range(n))
    while left:
        here = np.abs(bundle.levers - bundle.levers[left[0]]).max(1) <= ROUND_OFF
        left = [i for i in left if not here[i]]
        last = [k for k, boundary in enumerate(order) if here[boundary.tubes[0]]]
        force = 0.0
        for first, end in reversed(list(zip([0, *(k + 1 for k in last[:-1])], last, strict=False))):
            force += released[end, ~here].sum() + sheath[end]
            bent = bundle.bending_stiffness * np.maximum(own[end], own[first : end + 1]) ** 2
            change = ((bent + bundle.torsional_stiffness * twist**2) / 2)[:, here & present[end]].sum(1)
            out[first : end + 1] += bundle.offset[here][0] * (force + change)
            force += change[0]
    return out


class Passing(NamedTuple):
    """Two boundaries that may change places."""

    tubes: tuple[int, int]
    """A tube of each."""
    apart: float
    """Difference of own lengths from which on they cannot, m."""


def reserves(bundle: Bundle, bounds: Bounds) -> dict[tuple[int, int], tuple[Any, Any]]:
    """Pairs of tubes i < j, each with the least reserve with which boundaries keep their order, and what that takes.

    Both are differences of own lengths, m; the reserve is < 0 if the order may change.

    Boundary b is before c if tube c is not yet at its own length where tube b is: both differ by int (lever_c -
    lever_b).u there. At one offset no boundary passes another.
    """
    found: dict[tuple[int, int], tuple[Any, Any]] = {}
    for k, b in enumerate(bounds.order):
        for later, c in enumerate(bounds.order[k + 1 :], start=k + 1):
            lever = _norm(bundle.levers[b.tubes[0]] - bundle.levers[c.tubes[0]])
            if lever > ROUND_OFF:
                apart = lever * bounds.bend[k]
                pair = min(b.tubes[0], c.tubes[0]), max(b.tubes[0], c.tubes[0])
                kept = bounds.own_length[later] - bounds.own_length[k] - apart
                if pair not in found or kept < found[pair][0]:
                    found[pair] = kept, apart
    return found


class Proof(NamedTuple):
    """Certificate of a bundle."""

    margin: float
    """Lower bound of Q / T over all rotations; -inf if nothing can be proved."""
    obstacle: str = ""
    """Reason why nothing can be proved, as a sentence."""


def bundle_proof(bundle: Bundle) -> Proof:
    """Certificate of a bundle: if it is above 0, nothing snaps at any rotations."""
    if bundle.end.max() <= SAME_PLACE or not bundle.curvature.any():  # no tube in front of the plate, or none curved
        return Proof(1.0)
    bounds = bounds_of(bundle)
    if bounds is None or (least_stiffness(bundle, bounds) <= 0).any():
        return Proof(-np.inf, "the tubes curve too tightly, relative to their offsets, for a proof.")
    kept = reserves(bundle, bounds)
    if kept and (meeting := min(kept.items(), key=lambda pair: pair[1][0]))[1][0] <= 0:
        (i, j), (_, apart) = meeting
        return Proof(
            -np.inf,
            f"tubes {i + 1} and {j + 1} may end, or begin to curve, in either order, and the arm may snap where the "
            f"order changes. Own lengths that differ by more than about {1e3 * apart:.2f} mm keep it.",
        )
    return Proof(float(_least_second_variation(bundle, bounds)))


def proof_parts(bundle: Bundle) -> Array | None:
    """Bound of Q / T, and reserves (m) of all pairs of tubes, by `combinations`; a proof needs all above 0.

    The bound holds if boundaries keep their order. None if the tubes curve too tightly.

    Tubes at one offset, and those without a boundary in front of the plate, have the length of the arm as reserve.
    """
    n = len(bundle.end)
    pairs = [*combinations(range(n), 2)]
    if bundle.end.max() <= SAME_PLACE or not bundle.curvature.any():
        return np.array([1.0, *(bundle.end.max() for _ in pairs)])
    bounds = bounds_of(bundle)
    if bounds is None or (least_stiffness(bundle, bounds) <= 0).any():
        return None
    kept = reserves(bundle, bounds)
    free = bundle.end.max(), 0.0
    return np.array([_least_second_variation(bundle, bounds), *(kept.get(pair, free)[0] for pair in pairs)])


def proof_slopes(bundle: Bundle, slopes: Mapping[str, Array]) -> Array:
    """Derivatives (1 + n (n - 1) / 2, Q) of `proof_parts` along Q directions, in which parameters change by `slopes`.

    These are (n, Q) of the names in CHANGED, (1, Q) of the sheath. At kinks derivatives are one-sided.
    """
    columns = []
    for k in range(next(iter(slopes.values())).shape[1]):
        moved = {field.name: getattr(bundle, field.name) + 0j for field in fields(bundle)}
        for name, rows in slopes.items():
            for quantity, factor in CHANGED[name].items():
                change = rows[0, k] if quantity == "sheath" else rows[:, k]
                moved[quantity] = moved[quantity] + 1j * STEP * factor * change
        parts = proof_parts(Bundle(**moved))
        assert parts is not None
        columns.append(parts.imag / STEP)
    return np.array(columns).T


def least_stiffness(bundle: Bundle, bounds: Bounds) -> Array:
    """Bounds (m,) from below of the bending stiffness, int sum kb_i |v - u b_i / g_i|^2 / g_i per |v|^2, N m^2."""
    kb, stretch = bundle.bending_stiffness * bounds.present, bundle.offset * bounds.curvature[:, None]
    first_order = 3 * _norm(kb @ bundle.levers) * bounds.curvature
    return np.asarray(bounds.stiffness - first_order - 2 * (kb * stretch * (1 / (1 - stretch) ** 2 - 1)).sum(1))


def _least_second_variation(bundle: Bundle, bounds: Bounds) -> Any:
    """Least eigenvalue of T - N relative to T.

    N consists of the pairs of tubes, with the signs of eta kept, and of a form of magnitudes. It is computed as a sum
    of two least eigenvalues, and as one with magnitudes for the pairs as well; the larger number counts.
    """
    n, d, kt = len(bundle.end), bundle.offset, bundle.torsional_stiffness
    jump, across, u, (low, high) = bounds.jump, bounds.across, bounds.curvature, bounds.place

    # Strips: the sections of an arm have their boundaries somewhere between `low` and `high`.
    # Also the thinnest count: one that is left out would lack a tube.
    cuts = np.unique(np.concatenate([[0.0], low, high]))
    cuts = np.concatenate([[0.0], cuts[1:][np.diff(cuts).real > ROUND_OFF]])
    counts = np.ceil(ELEMENTS * np.diff(cuts).real / cuts[-1].real).astype(int)
    parts = [np.linspace(a, b, 1 + count) for (a, b), count in zip(pairwise(cuts), counts, strict=True)]
    ends = np.concatenate([[0.0], *(part[1:] for part in parts)])
    h, middle, rule = np.diff(ends), (ends[1:] + ends[:-1])[:, None] / 2, tableau("gauss", DEGREE)
    possible = (np.append(0.0, low[:-1]) < middle) & (middle < high)
    element = np.repeat(np.arange(len(h)), DEGREE)
    s, weight = (ends[:-1, None] + h[:, None] * rule.nodes).ravel(), np.outer(h, rule.weights).ravel()

    def largest(of_sections: Array) -> Array:
        """Largest values (N, ...) at the points, of values (m, ...) on the sections that may be there."""
        return np.array([of_sections[row].max(0) for row in possible])[element]

    least = least_stiffness(bundle, bounds)
    K, moment, curvature = -largest(-least), largest(bounds.moment), largest(u)
    rate = largest(bounds.moment / least[:, None])
    pairs = largest(bounds.moment[:, :, None] * bounds.moment[:, None] / least[:, None, None])
    off_balance = largest(((bounds.stiffness - least) * u + bounds.off_balance) / least)
    up_to = np.where(element < element[:, None], weight, 0.0) + np.kron(np.diag(h), rule.matrix)
    number = up_to.dtype

    def within(length: Any) -> Array:
        """Weights (N,) of the integral up to an arc length at the end of an element."""
        return np.where(s < length, weight, 0.0)

    # Twists w (N, n) at the points, and (m, n) at the boundaries: kt w' <= m times the curvature across.
    growth = largest(bounds.moment * across) / kt
    twist = weight @ growth - up_to @ growth
    twist_at = np.array([weight @ growth - within(place) @ growth for place in low])

    # Magnitudes as linear forms of the whitened unknowns: eta' at the points, eta at the plate, R at the points.
    count, sprung = len(s), np.flatnonzero(bundle.transmission.real > 0)
    split = n * count + len(sprung)
    size = split + count
    y, y_at = np.zeros((n, count, size), number), np.zeros((len(u), n, size), number)
    for i in range(n):
        per_unknown = np.sqrt((1 + largest(d[i] * u)) / (weight * kt[i]))
        columns = slice(i * count, (i + 1) * count)
        y[i, :, columns] = up_to * per_unknown
        y_at[:, i, columns] = [within(place) * per_unknown for place in high]
    for column, i in enumerate(sprung.tolist(), start=n * count):
        y[i, :, column] = y_at[:, i, column] = np.sqrt(bundle.transmission[i] / kt[i])
    v = np.einsum("ai,iaz->az", rate, y)
    v[:, split:] += np.diag(1 / np.sqrt(weight * K))
    moved = np.zeros((len(u), size), number)
    for k, boundary in enumerate(bounds.order):
        lever = d[boundary.tubes[0]]
        moved[k] = lever * (within(high[k]) @ v + jump[:k] @ moved[:k]) / (1 - lever * u[k])
    turned = np.stack([up_to @ ((twist[:, i] * d[i])[:, None] * v) for i in range(n)])
    turned_at = np.stack([[(within(place) * twist[:, i] * d[i]) @ v for i in range(n)] for place in high])
    for k in range(len(u) - 1):
        step = (twist_at[k] * d * jump[k] * bounds.present[k + 1])[:, None] * moved[k]
        turned += (s > low[k])[None, :, None] * step[:, None]
        turned_at[k:] += step

    # The form N: pairs with signs, and all else.
    opposed, rest = np.zeros((split, split), number), np.zeros((size, size), number)
    same = np.zeros_like(rest)

    def add(a: Array, b: Array) -> None:
        rest[...] += a.T @ b + b.T @ a

    for i in range(n):
        m = (weight * moment[:, i])[:, None]
        add(y[i], m * off_balance[:, None] * y[i] / 2)
        add(v + curvature[:, None] * y[i], m * turned[i])
        add(turned[i], m * curvature[:, None] * turned[i] / 2)
        for j in range(i):
            coupling = (weight * pairs[:, i, j])[:, None]
            apart, together = (y[i] - y[j])[:, :split], y[i] + y[j]
            opposed += apart.T @ (coupling * apart)
            same += together.T @ (coupling * together)
    for k, boundary in enumerate(bounds.order):
        torque, square = np.zeros(size, number), number.type(0)
        for i in np.flatnonzero(bounds.present[k]).tolist():
            at = y_at[k, i] + turned_at[k, i]
            if i in boundary.ends:
                torque += bounds.moment[k, i] * across[k, i] * at
                continue
            m, side, change = bounds.moment[k + 1, i], across[k + 1, i], min(jump[k], across[k, i] + across[k + 1, i])
            if i in boundary.tubes:
                torque += m * side * at
                square += m * side * twist_at[k, i] * (1 + d[i] * (u[k] + jump[k]))
            else:
                torque += m * change * at
                square += m * twist_at[k, i] * ((1 + d[i] * u[k]) * change + d[i] * jump[k] * side)
        add(moved[k, None], torque[None] + square * moved[k, None] / 2)

    of_eta, of_r = _largest_eigenvalue(rest[:split, :split]), _largest_eigenvalue(rest[split:, split:])
    mixed = np.sqrt(_largest_eigenvalue(rest[:split, split:].T @ rest[:split, split:]))
    apart = np.array([[_largest_eigenvalue(opposed) + of_eta, mixed], [mixed, of_r]])
    return 1 - min(_largest_eigenvalue(apart), _largest_eigenvalue(same + rest))

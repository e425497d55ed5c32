"""Independent verification of an equilibrium by adaptive integration of its equations.

It shares only the tubes with the solver. From the solved values at the plate, torque, bending moment and shape are
integrated to the tip by DOP853 (SciPy) with tolerance 1e-12, from one breakpoint to the next; the physics is written
once more, in NumPy. Loads are those of Rucker, Jones and Webster, IEEE T-RO 26 (2010): with the force n and the bending
moment m on the cross-sections, the torques t_i, and force and moment per length f and l,

    u = (m + sum kb_i u*_i e^(j theta_i)) / sum kb_i,    n' = -f,    m' = -u x t + n x e3 - l  in the Bishop frame,

and at the tip n and m are the force and the moment there.

The tubes of a bundle slide in frictionless channels of a sheath: see `_Channels`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
import scipy

from ..block.transcription.bundle import Boundary, length_forces
from ..robots.assembly import Assembly, cut
from ..robots.eccentric import BundleRobot
from ..robots.load import FORCE, MOMENT, Load, masses
from ..robots.order import last_tube, outermost, twisted_tube
from ..robots.pieces import Quantity, at, vary
from ..robots.robot import Robot
from ..robots.tubes import stretches
from ..typing import Array, Index, Mask
from .kinematics import point_of
from .result import Equilibrium, Verification, refuse_friction, small_turn

# Four orders below the accuracy of an equilibrium, 1e-8: differences are then errors of the solver, not of the check.
TOLERANCE = 1e-12

CURVATURE_ROUND_OFF = 4e-16
"""Relative change of a curvature by round-off."""

SAME_POSITION = 1e-12
"""Largest distance (m) of two positions that count as equal: round-off of a length."""


def verify_equilibrium(equilibrium: Equilibrium) -> Equilibrium:
    """Verify an equilibrium: returns it with its `verification`; raises InputError with friction."""
    (check,) = verifications([equilibrium])
    return replace(equilibrium, verification=check)


def verifications(equilibria: Sequence[Equilibrium]) -> list[Verification]:
    """The verifications of equilibria of one robot under one load, integrated together: many cost little more than one.

    Raises InputError for one under friction.
    """
    for each in equilibria:
        refuse_friction(each)
    if not equilibria[0].robot.fixed_sections:
        return [_Channels.of(each).verification() for each in equilibria]
    arms = _Arms.of(equilibria)
    n, state = arms.robot.n_tubes, arms.base()
    # By integration from the shape's own values at the plate, the joint rotations must come out.
    base = [
        at_plate[:n] - arms.transmitted(assembly, at_plate[n : 2 * n]) - each.rotations
        for each, assembly, at_plate in zip(equilibria, arms.assemblies, state, strict=True)
    ]
    # Sections are integrated one by one: at a breakpoint the right-hand side jumps, which would cost DOP853 its order.
    worst, loose, bent = np.zeros((3, len(equilibria)))
    for k in range(arms.n_sections):
        section = arms.section(k)
        state[section.rows] = section.integrated(arms.past_points(section.rows, section.start, state[section.rows]))
        kb, kt, *_ = section.tubes(1.0)
        beyond = arms.past_points(section.rows, section.stop, state[section.rows], ending=True)
        for j, b in enumerate(section.rows.tolist()):
            each, assembly, stop = equilibria[b], arms.assemblies[b], section.stop[j]
            solved = each.rotation[:, np.argmin(np.abs(each.arc_length - stop))]
            worst[b] = max(worst[b], np.abs(state[b, :n] - solved).max())
            if k == assembly.n_sections - 1:
                bent[b] = np.abs(beyond[j, -5:-3]).max() / kb[j].sum()
            # A free end has no torque: what is left there is an error of the solution.
            ends = np.abs(assembly.end - stop) < SAME_POSITION
            loose[b] = max(loose[b], np.abs(beyond[j, n : 2 * n] / kt[j])[ends].max(initial=0.0))
    out = []
    for b, each in enumerate(equilibria):
        turn = _frame(state[b], n) @ each.tip_rotation.T
        out.append(
            Verification(
                tip_position=float(np.linalg.norm(state[b, 2 * n + 9 : 2 * n + 12] - each.tip_position)),
                tip_rotation=float(np.linalg.norm(small_turn(turn))),
                rotation=float(worst[b]),
                end_torsion=float(loose[b]),
                end_curvature=float(bent[b]),
                base_rotation=float(np.abs(base[b]).max(initial=0.0)),
            )
        )
    return out


def point_at(equilibrium: Equilibrium, arc_length: float) -> tuple[Array, Array]:
    """Position (3,), m, and curvature (2,) in the Bishop frame, 1/m, at an arc length, by the same integration."""
    arms = _Arms.of([equilibrium])
    state, u, n = arms.base(), 0j, equilibrium.robot.n_tubes
    for k in range(arms.n_sections):
        section = arms.section(k)
        if k and arc_length <= section.start[0]:
            break
        section = replace(section, stop=np.minimum(section.stop, arc_length))
        state = section.integrated(arms.past_points(section.rows, section.start, state))
        u = complex(section.curvature(section.tubes(1.0), state).u[0])
    return state[0, 2 * n + 9 : 2 * n + 12], np.array([u.real, u.imag])


def _frame(state: Array, n: int) -> Array:
    """(3, 3) Bishop frame of a state."""
    return state[2 * n : 2 * n + 9].reshape(3, 3)


def _past_points(equilibrium: Equilibrium, assembly: Assembly, s: float, state: Array, *, ending: bool) -> Array:
    """State beyond the forces and moments that act at arc length s; `ending`: also those at the tip."""
    n, out, load = assembly.n_tubes, state.copy(), equilibrium.load or Load()
    for part in load.acting if ending else load.points:
        axes, arc_length = np.eye(3), part.at
        if arc_length == np.inf:
            axes = equilibrium.tip_rotation if load.frame == "tip" else axes
            arc_length = max(s, float(assembly.end[last_tube(assembly.end)]))
        if abs(arc_length - s) < SAME_POSITION:
            # The cross-section transmits the loads beyond it: past a point load force and moment drop by it.
            moment = _frame(state, n).T @ axes @ part.moment
            out[n + twisted_tube(assembly.end, s)] -= moment[2]
            out[-5:-3] -= moment[:2]
            out[-3:] -= axes @ part.force
    return out


Stretch = tuple[float, float, tuple[Quantity, ...]]
"""Stretch (start, end) from the clamped end of its tube, m, with kb, kt and u* (3) along it."""


@dataclass(frozen=True, eq=False)
class _Arms:
    """B equilibria of a robot under one load, with assemblies and tube properties for their joint integration."""

    equilibria: Sequence[Equilibrium]
    load: Load
    assemblies: tuple[Assembly, ...]
    along: tuple[tuple[Stretch, ...], ...]

    @staticmethod
    def of(equilibria: Sequence[Equilibrium]) -> _Arms:
        """Arms of a list of equilibria of one robot under one load."""
        robot, load, along = equilibria[0].robot, equilibria[0].load or Load(), []
        for tube in robot.tubes:
            pieces, start = [], 0.0
            for length, (x, y, z), kb, kt in stretches(tube):
                pieces.append((start, start + length, (kb, kt, x, y, z)))
                start += length
            along.append(tuple(pieces))
        placed = tuple(cut(robot.assembly(each.translations), load.cuts()) for each in equilibria)
        return _Arms(equilibria, load, placed, tuple(along))

    @property
    def robot(self) -> Robot:
        """Robot of all equilibria."""
        return self.equilibria[0].robot

    @property
    def n_sections(self) -> int:
        """Largest number of sections of an arm."""
        return max(assembly.n_sections for assembly in self.assemblies)

    def past_points(self, rows: Index, s: Array, state: Array, *, ending: bool = False) -> Array:
        """States of some arms beyond the forces and moments that act at arc lengths (B,)."""
        if self.load == Load():
            return state
        each = zip(rows.tolist(), s.tolist(), state, strict=True)
        return np.array(
            [
                _past_points(self.equilibria[b], self.assemblies[b], s, arm_state, ending=ending)
                for b, s, arm_state in each
            ]
        )

    def section(self, k: int) -> _Section:
        """Section k from the plate, of all arms that have it."""
        rows = np.array([b for b, assembly in enumerate(self.assemblies) if k < assembly.n_sections], dtype=np.intp)
        some = [self.assemblies[b] for b in rows]
        start, length = (np.array([getattr(each, name)[k] for each in some]) for name in ("start", "length"))
        mass = np.array([masses(self.robot.tubes, self.load) @ each.present[k] for each in some])
        parts = [
            [
                next(
                    ((first - held, numbers) for first, end, numbers in tube if first - held <= middle < end - held),
                    None,
                )
                for tube, held in zip(self.along, each.transmission.tolist(), strict=True)
            ]
            for each, middle in zip(some, (start + length / 2).tolist(), strict=True)
        ]
        section = _Section(some[0], self.load, rows, start, start + length, mass, parts)
        still = not any(vary(part[1]) for row in parts for part in row if part is not None)
        return replace(section, everywhere=section.tubes(0.5)) if still else section

    def base(self) -> Array:
        """(B, 2n + 17) state (theta, t, R, p, m, n) behind the plate; the torque is kt (theta' / g - u*_z)."""
        states = []
        for each in self.equilibria:
            wrench, none = each.base_wrench, np.zeros(self.robot.n_tubes)
            pose = [*np.eye(3).ravel(), 0.0, 0.0, 0.0]
            states.append(np.concatenate([each.rotation[:, 0], none, pose, wrench[3:5], wrench[:3]]))
        state, n = np.array(states), self.robot.n_tubes
        if self.n_sections:
            section = self.section(0)
            _, kt, _, z = tubes = section.tubes(0.0)
            slope = np.array([self.equilibria[b].torsion[:, 0] for b in section.rows])
            # The torques on the arm and those of point loads at the plate.
            beyond = self.past_points(section.rows, 0 * section.start, state[section.rows])
            # theta' = g (u*_z + t / kt), solved for t.
            torque = kt * (slope / section.curvature(tubes, beyond).g - z) - beyond[:, n : 2 * n]
            state[section.rows, n : 2 * n] = torque
        return state

    def transmitted(self, assembly: Assembly, torque: Array) -> Array:
        """(n,) rotation of the tubes from their clamped ends to the plate, rad."""
        out = np.zeros(assembly.n_tubes)
        for i, (pieces, held) in enumerate(zip(self.along, assembly.transmission.tolist(), strict=True)):
            for start, end, (_, kt, _, _, z) in pieces:
                stop = min(end, held)
                if stop > start and not vary((z, kt)):
                    out[i] += (at(z, 0.0) + torque[i] / at(kt, 0.0)) * (stop - start)
                elif stop > start:
                    out[i] += scipy.integrate.quad(
                        lambda x, z=z, kt=kt, t=torque[i]: at(z, x) + t / at(kt, x), 0, stop - start, epsrel=TOLERANCE
                    )[0]
        return out


class _TubesAt(NamedTuple):
    """Tubes (B, n) of B arms at an arc length."""

    bending: Array
    """kb, N m^2."""
    torsional: Array
    """kt, N m^2."""
    precurvature: Array
    """u*_x + j u*_y, 1/m."""
    twist: Array
    """u*_z, 1/m."""


class _SlidingTubes(NamedTuple):
    """Tubes (n,) of a bundle."""

    bending: Array
    """kb, N m^2."""
    torsional: Array
    """kt, N m^2."""
    curvature: Array
    mass: Array
    """Mass per length, kg/m."""


class _Curvature(NamedTuple):
    """Curvature of B cross-sections, with complex numbers for the plane of the Bishop frame."""

    u: Array
    """Complex curvature u_x + j u_y (B,), 1/m."""
    moments: Array
    """Natural moments kb u* e^(j theta) (B, n), N m."""
    g: Array
    """(B, n) arc length of each tube per arc length of the arm."""


@dataclass(frozen=True, eq=False)
class _Section:
    """Section of B arms, `rows`, between arc lengths `start` and `stop` (B,), m. Positions x are fractions of it.

    `mass` (B,) is per length, kg/m. `parts` has for each arm and tube the start of its stretch and kb, kt and u* along
    it, None if the tube has ended.
    """

    assembly: Assembly
    load: Load
    rows: Index
    start: Array
    stop: Array
    mass: Array
    parts: list[list[tuple[float, tuple[Quantity, ...]] | None]]
    everywhere: _TubesAt | None = None

    @cached_property
    def present(self) -> Mask:
        """(B, n) True where a tube is present."""
        return np.array([[part is not None for part in row] for row in self.parts])

    @cached_property
    def loaded(self) -> bool:
        """True with an external load."""
        return self.load != Load()

    def arc_lengths(self, x: float) -> Array:
        """(B,) arc lengths at a fraction of the section, m."""
        return self.start + x * (self.stop - self.start)

    def tubes(self, x: float) -> _TubesAt:
        """Tubes of all arms.

        Where a tube has ended, kt is 1 and the others are 0.
        """
        if self.everywhere is not None:
            return self.everywhere
        ended = [0.0, 1.0, 0.0, 0.0, 0.0]
        table = [
            [ended if part is None else [at(q, s - part[0]) for q in part[1]] for part in row]
            for row, s in zip(self.parts, self.arc_lengths(x).tolist(), strict=True)
        ]
        kb, kt, bend, bend_y, twist = np.moveaxis(np.array(table), 2, 0)
        return _TubesAt(kb, kt, bend + 1j * bend_y, twist)

    def curvature(self, tubes: _TubesAt, state: Array) -> _Curvature:
        """Curvature by fixed-point iteration on u sum kb / g(u) = m + sum kb u* e^(j theta)."""
        kb, _, u_star, _ = tubes
        moments = kb * u_star * np.exp(1j * state[:, : kb.shape[1]])
        total, g, assembly = state[:, -5] + 1j * state[:, -4] + moments.sum(1), np.ones(kb.shape), self.assembly
        # Start without stretch; each pass shrinks the error by d |u|, so 60 are far more than enough.
        u = total / kb.sum(1)
        sin, cos = np.sin(assembly.offset_angle), np.cos(assembly.offset_angle)
        for _ in range(60 if assembly.eccentric else 0):
            g = 1 + assembly.offset * (u.real[:, None] * sin - u.imag[:, None] * cos)
            u, before = total / (kb / g).sum(1), u
            if (np.abs(u - before) <= CURVATURE_ROUND_OFF * np.abs(u)).all():
                break
        return _Curvature(u, moments, g)

    def rates(self, x: float, state: Array) -> Array:
        """(B, 2n + 17) derivatives of theta, t, R, p, m, n with respect to arc length."""
        count, n = self.present.shape
        torque = state[:, n : 2 * n]
        frame, out = state[:, 2 * n : 2 * n + 9].reshape(count, 3, 3), np.zeros(state.shape)
        _, kt, _, z = tubes = self.tubes(x)
        u, moments, g = self.curvature(tubes, state)
        a, b, ahead = u.real, u.imag, frame[:, :, 2]
        out[:, :n] = g * (z + torque / kt) * self.present
        # conj(u) kb u* e^(j theta) has the imaginary part m (u_x sin theta - u_y cos theta) = M.
        out[:, n : 2 * n] = (np.conj(u)[:, None] * moments).imag
        turned = out[:, 2 * n : 2 * n + 9].reshape(count, 3, 3)  # R times the matrix of u x
        turned[:, :, 0], turned[:, :, 1] = -b[:, None] * ahead, a[:, None] * ahead
        turned[:, :, 2] = b[:, None] * frame[:, :, 0] - a[:, None] * frame[:, :, 1]
        out[:, 2 * n + 9 : 2 * n + 12] = ahead
        if self.loaded:
            self._loaded(x, state, u, out)
        return out

    def _loaded(self, x: float, state: Array, u: Array, out: Array) -> None:
        """Add the effect of a load to the derivatives of torques, moments and forces."""
        count, n = self.present.shape
        frame = state[:, 2 * n : 2 * n + 9].reshape(count, 3, 3)
        per_length = self.load.per_length(self.arc_lengths(x))
        along, couple = per_length[:, FORCE], np.einsum("bij,bi->bj", frame, per_length[:, MOMENT])
        local_moment = np.einsum("bij,bi->bj", frame, state[:, -3:])
        if self.load.gravity is not None:
            along = along + self.mass[:, None] * np.array(self.load.gravity)
        out[np.arange(count), n + outermost(self.present)] -= couple[:, 2]
        total = (state[:, n : 2 * n] * self.present).sum(1)
        out[:, -5] = -u.imag * total + local_moment[:, 1] - couple[:, 0]
        out[:, -4] = u.real * total - local_moment[:, 0] - couple[:, 1]
        out[:, -3:] = -along

    def integrated(self, state: Array) -> Array:
        """States at the end of the section, from those at its start."""
        # Sections of different arms have different lengths: integrated over fractions, they share one step size.
        long = (self.stop - self.start)[:, None]
        # The solver bounds the root mean square over all arms: one arm may have sqrt(B) times as much.
        tight = dict.fromkeys(("rtol", "atol"), TOLERANCE / np.sqrt(len(state)))
        run = scipy.integrate.solve_ivp(
            lambda x, flat: (long * self.rates(x, flat.reshape(state.shape))).ravel(),
            (0.0, 1.0),
            state.ravel(),
            method="DOP853",
            **tight,
        )
        return np.asarray(run.y[:, -1]).reshape(state.shape)


SAME_BOUNDARY = 1e-8
"""Distance (m) along a tube below which two boundaries of a bundle are one."""


class _BundleSection(NamedTuple):
    """Tubes (n,) between two boundaries of a bundle."""

    stiffness: Array
    """Bending stiffnesses kb, N m^2; 0 of tubes that are not there."""
    curvature: Array
    """Precurvatures kappa, 1/m; 0 where a tube is straight, or not there."""
    multiplier: Array
    """Multipliers lambda, N."""
    rigid: bool
    """True if the sheath is rigid."""


@dataclass(frozen=True, eq=False)
class _Channels:
    """Tubes of a bundle in their channels, integrated from the plate.

    Tube i at the offset o_i has the own curvature v = u / g and twist w, g = 1 + d_i a_i.u, and pulls with

        N = kb (kappa^2 - |v|^2) / 2 - kt w^2 / 2 - lambda - rho G.(p - p_tip + R o_i),

    lambda constant between its boundaries. The moment of all tubes and of the sheath is M in world axes:

        sum kb (v - kappa e) + N d a + B u = (R'M)_xy,    kt dw = kb kappa (u_x sin theta - u_y cos theta) ds.

    A boundary may slide along its tube without a gain of energy: sum g (kb |v - kappa e|^2 / 2 - kt w^2 / 2 - lambda -
    weight) + B |u|^2 / 2 - (R'M).u is the same on both sides of it. Beyond the last one it is n.t of the tip's force.
    """

    equilibrium: Equilibrium
    load: Load
    boundaries: tuple[Boundary, ...]
    multipliers: Array
    """lambda (m,) of the boundaries, N: that of a tube is the sum over those in front of it."""

    @staticmethod
    def of(equilibrium: Equilibrium) -> _Channels:
        """Channels with the multipliers of a solved equilibrium."""
        state = point_of(equilibrium).state
        load = equilibrium.load or Load()
        return _Channels(equilibrium, load, tuple(state.problem.order), length_forces(state))

    @cached_property
    def tubes(self) -> _SlidingTubes:
        """Tubes of the robot."""
        robot = self.equilibrium.robot
        names = ("bending_stiffness", "torsional_stiffness", "curvature")
        kb, kt, curved = (np.array([float(getattr(tube, name)) for tube in robot.tubes]) for name in names)
        return _SlidingTubes(kb, kt, curved, np.asarray(masses(robot.tubes, self.load)))

    @cached_property
    def places(self) -> tuple[Array, Array]:
        """(n, 2) offsets o and levers d a of the tubes, m."""
        robot = self.equilibrium.robot
        assert isinstance(robot, BundleRobot)
        return robot.axes, np.asarray(robot.axes[:, ::-1] * [1.0, -1.0])

    @property
    def reach(self) -> float:
        """End of loads per length, m: own length of the longest tube in front of the plate."""
        each = self.equilibrium
        own = [tube.length - tube.straight_length for tube in each.robot.tubes] + each.translations
        return float(own.max())

    def is_rigid(self, s: float) -> bool:
        """True if the sheath is rigid behind an arc length s."""
        robot = self.equilibrium.robot
        assert isinstance(robot, BundleRobot)
        tip = math.inf if robot.sheath_rigid_from is None else robot.sheath_rigid_from
        return s < robot.sheath_rigid_length - SAME_BOUNDARY or s > tip - SAME_BOUNDARY

    def section(self, left: Sequence[int], s: float) -> _BundleSection:
        """Section that begins at an arc length s, with the boundaries `left` ahead."""
        kb, _, curved, _ = self.tubes
        there, bent, pull = np.zeros(len(kb)), curved.copy(), np.zeros(len(kb))
        for k in left:
            b = self.boundaries[k]
            there[list(b.ends)] = 1.0
            bent[[i for i in b.tubes if i not in b.ends]] = 0.0
            pull[list(b.tubes[:1])] += self.multipliers[k]
        return _BundleSection(kb * there, bent * there, pull, self.is_rigid(s))

    def curvature(self, y: Array, section: _BundleSection) -> Array:
        """(2,) curvature that balances the moment, by Newton's method; 0 where the sheath is rigid."""
        (kb, bent, pull, rigid), (_, kt, _, _), (_, lever) = section, self.tubes, self.places
        if rigid:
            return np.zeros(2)
        n = len(kb)
        theta, w, on = y[:n], y[n : 2 * n], kb > 0
        natural = bent[:, None] * np.column_stack([np.cos(theta), np.sin(theta)])
        sheath = self.equilibrium.robot.sheath_stiffness  # type: ignore[attr-defined]
        moment, axial = self.moment(y), (kb * bent**2 - kt * w**2) / 2 - pull - self.weight(y)
        u = kb @ natural / (kb.sum() + sheath)
        for _ in range(12):
            g = 1 + lever @ u
            v = u / g[:, None]
            tension = on * (axial - kb * (v**2).sum(1) / 2)
            rest = kb @ (v - natural) + tension @ lever + sheath * u - moment
            by_g = (kb / g)[:, None, None] * lever[:, :, None]
            # dv = (1 - v d a') du / g, and d tension = -kb v.dv.
            slope = np.eye(2) * ((kb / g).sum() + sheath) - np.einsum("ij,ikl->jk", v, by_g)
            slope -= np.einsum("ikl,ij->kj", by_g, v) - lever.T @ (lever * (kb * (v**2).sum(1) / g)[:, None])
            step = np.linalg.solve(slope, rest)
            u = u - step
            if np.abs(step).max() <= CURVATURE_ROUND_OFF * max(1.0, float(np.abs(u).max())):
                break
        return np.asarray(u)

    def moment(self, y: Array) -> Array:
        """(2,) moment on the cross-section in the Bishop frame, N m."""
        return np.asarray((y[-15:-6].reshape(3, 3).T @ y[-3:])[:2])

    def weight(self, y: Array) -> Array:
        """(n,) potential of the weight of a tube per length, from the tip, N."""
        gravity, (out, _) = np.array(self.load.gravity or (0.0, 0.0, 0.0)), self.places
        place = y[-18:-15] - self.equilibrium.tip_position + out @ y[-15:-6].reshape(3, 3)[:, :2].T
        return np.asarray(self.tubes.mass * (place @ gravity))

    def potential(self, y: Array, section: _BundleSection, u: Array) -> float:
        """Quantity that is the same on both sides of a boundary that slides, N."""
        (kb, bent, pull, _), (_, kt, _, _), (_, lever) = section, self.tubes, self.places
        n = len(kb)
        theta, w, g = y[:n], y[n : 2 * n], 1 + lever @ u
        off = u / g[:, None] - bent[:, None] * np.column_stack([np.cos(theta), np.sin(theta)])
        tubes = kb * (off**2).sum(1) / 2 - (kb > 0) * (kt * w**2 / 2 + pull + self.weight(y))
        sheath = self.equilibrium.robot.sheath_stiffness  # type: ignore[attr-defined]
        return float(g @ tubes + sheath * u @ u / 2 - self.moment(y) @ u)

    def rates(self, s: float, y: Array, section: _BundleSection) -> Array:
        """Derivatives of (theta, w, own length, p, R, n, M) by arc length."""
        (kb, bent, _, _), (_, kt, _, mass), (out, lever) = section, self.tubes, self.places
        n, on = len(kb), kb > 0
        theta, w, frame = y[:n], y[n : 2 * n], y[-15:-6].reshape(3, 3)
        u = self.curvature(y, section)
        g, ahead = 1 + lever @ u, frame[:, 2]
        turned = np.column_stack([-u[1] * ahead, u[0] * ahead, u[1] * frame[:, 0] - u[0] * frame[:, 1]])
        along = self.load.per_length(np.array([s]))[0] * (s < self.reach)
        gravity = np.array(self.load.gravity or (0.0, 0.0, 0.0))
        weight = (mass * g * on)[:, None] * gravity
        force = along[FORCE] + weight.sum(0)
        couple = along[MOMENT] + np.cross(out @ frame[:, :2].T, weight).sum(0)
        twist = kb * bent * (u[0] * np.sin(theta) - u[1] * np.cos(theta)) / kt
        statics = [-force, -np.cross(ahead, y[-6:-3]) - couple]
        return np.concatenate([g * w * on, twist * on, g, ahead, turned.ravel(), *statics])

    def verification(self) -> Verification:
        """Differences of the integrated arm, and what is violated at its boundaries."""
        each, n = self.equilibrium, self.equilibrium.robot.n_tubes
        kb, kt, _, _ = self.tubes
        lever, left = self.places[1], list(range(len(self.boundaries)))
        w = each.torsion[:, 0] / (1 + lever @ each.curvature[0])
        held = np.array([tube.straight_length for tube in each.robot.tubes]) - each.translations
        base = each.rotation[:, 0] - np.maximum(held, 0.0) * w - each.rotations
        pose = [np.zeros(3), np.eye(3).ravel(), each.base_wrench]
        y, s = np.concatenate([each.rotation[:, 0], w, np.zeros(n), *pose]), 0.0
        worst, loose, bent, most = 0.0, 0.0, 0.0, float(np.abs(lever).max()) / kb.sum()
        while left:
            section = self.section(left, s)
            if not section.stiffness.any():
                break

            def to_go(s: float, y: Array, k: int) -> float:
                b = self.boundaries[k]
                return float(y[2 * n + b.tubes[0]] if b.tubes else s) - b.arc_length

            events = [partial(to_go, k=k) for k in left]
            for event in events:
                event.terminal = True  # type: ignore[attr-defined]
            flow = scipy.integrate.solve_ivp(
                partial(self.rates, section=section),
                (s, s + 2 * float(each.arc_length[-1])),
                y,
                method="DOP853",
                events=events,
                rtol=TOLERANCE,
                atol=TOLERANCE,
            )
            s, y = float(flow.t[-1]), flow.y[:, -1]
            passed = [k for k in left if abs(to_go(s, y, k)) < SAME_BOUNDARY]
            left = [k for k in left if k not in passed]
            u, after = self.curvature(y, section), self.section(left, s)
            before = self.potential(y, section, u)
            here = [i for k in passed for i in self.boundaries[k].ends]
            last = not after.stiffness.any()
            if last:
                before -= float(y[-6:-3] @ y[-15:-6].reshape(3, 3)[:, 2])
            else:
                before -= self.potential(y, after, self.curvature(y, after))
            if not any(self.boundaries[k].of_sheath for k in passed):
                # An axial force that is off by this bends the tubes by its lever.
                bent = max(bent, abs(before) * most)
            for i in here:
                twisted = float(y[-3:] @ y[-15:-6].reshape(3, 3)[:, 2]) if last and i == here[0] else 0.0
                loose = max(loose, abs(y[n + i] - twisted / kt[i]))
                worst = max(worst, abs(y[i] - each.tip_rotations[i]))
            for part in self.load.points:
                if any(self.boundaries[k].of_sheath and abs(part.at - s) < SAME_BOUNDARY for k in passed):
                    y[-6:-3] -= part.force
                    y[-3:] -= part.moment
        turn = y[-15:-6].reshape(3, 3) @ each.tip_rotation.T
        tip = self._tip_wrench(s)
        return Verification(
            tip_position=float(np.linalg.norm(y[-18:-15] - each.tip_position)),
            tip_rotation=float(np.linalg.norm(small_turn(turn))),
            rotation=worst,
            end_torsion=loose,
            end_curvature=max(bent, float(np.abs(y[-3:] - tip[3:]).max()) / kb.sum()),
            base_rotation=float(np.abs(base).max()),
        )

    def _tip_wrench(self, s: float) -> Array:
        """Force and moment (6,) at the tip at arc length s; loads per length beyond it act there, too."""
        wrench = np.zeros(6)
        if self.load.distributed is not None and self.reach > s:
            wrench += scipy.integrate.quad_vec(lambda x: self.load.per_length(np.array([x]))[0], s, self.reach)[0]
        axes = self.equilibrium.tip_rotation if self.load.frame == "tip" else np.eye(3)
        for part in self.load.acting:
            if part.at == np.inf:
                wrench += np.concatenate([axes @ part.force, axes @ part.moment])
        return wrench

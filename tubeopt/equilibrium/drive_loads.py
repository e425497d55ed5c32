"""Torques and forces of the drives that hold an equilibrium.

At fixed rotations theta(s), torques t(s) and bending moments b(s), an advance of tube i changes the energy only by
moving what varies along this tube. With the Legendre transform of the energy per length

    H = 1/2 sum kb |u*|^2 - 1/2 |b + sum a|^2 / sum kb - sum [t^2 / (2 kt) + t u*_z],

torque and force of the drives of tube i are

    T_i = -t_i at the clamp,
    F_i = sum over its breakpoints of (H before - H after) - int (dH/ds of its data) ds            in front of the plate
          + t^2 / (2 kt) + t u*_z - 1/2 kb |u*|^2                                                  at the plate
          - n.e where the arm ends with it - its weight along its path - int m_i theta_i' ds       (friction m_i on it).

The last term at the plate is the energy of a curved part that the plate holds straight. `Equilibrium.energy` leaves it
out, since it changes no shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np

from ..arguments import typed
from ..block.transcription.collocated import SHAPE_STEPS
from ..display import Displayed
from ..errors import InputError
from ..files.field_metadata import form, unit
from ..robots.assembly import Assembly
from ..robots.eccentric import BundleRobot
from ..robots.load import masses
from ..solvers.blas import small
from ..typing import Array
from .arm_sections import NEAR, ArmSections
from .directions import check_wrt
from .result import Equilibrium

BOOLE = np.array([7, 32, 12, 32, 7]) / 90
"""Weights of values at the five shape points of an element, exact to degree 5."""


@dataclass(frozen=True, eq=False)
class DriveLoads(Displayed):
    """Loads of the drives that hold an equilibrium of n tubes on C carriages."""

    torque: Annotated[Array, unit("mN_m"), form(".4f"), "torque of every rotation drive"]
    """Torques (n,) on the tubes about +z at their clamped ends, N m."""
    force: Annotated[Array, unit("mN"), form(".4f"), "force of every carriage"]
    """Forces (C,) on the tubes along +z, N."""


@typed
@small
def drive_loads(equilibrium: Equilibrium, *, side: int = 1, previous: Equilibrium | None = None) -> DriveLoads:
    """Torques and forces of the drives that hold an equilibrium: derivatives of its energy by the joint values.

    The energy is the potential of the equilibrium, with the bending of curved parts that the plate holds straight and
    the weight of the tubes behind it. Tip forces move with the tip. Other forces along the arm stay at their arc
    lengths, and do no work on tubes that slide past. Friction torques between the tubes count.

    Args:
        side: 1 for carriages that begin to advance, -1 for those that begin to withdraw. The forces differ where
            breakpoints coincide, as at home, where all curved parts begin at the plate.
        previous: the state before, of a motion with friction that acts on sliding tubes (`Friction.sliding`). That
            friction opposes the sliding since then, and is not known without it.

    Raises:
        InputError: an eccentric robot without an energy, a bundle with load or friction, or a load with moments or
            one that turns with the tip.
        SolveError: the equilibrium of a bundle is a fold.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("thesis_ctr")
        >>> loads = tubeopt.drive_loads(tubeopt.forward_kinematics(robot, [0, 1, 2]))
        >>> bool(abs(loads.torque.sum()) < 1e-9)  # without a load the drives turn against each other
        True
    """
    e, robot = equilibrium, equilibrium.robot
    check_wrt((), side)
    if isinstance(robot, BundleRobot):
        return _of_bundle(e, side)
    if not robot.fixed_sections or robot.assembly(e.translations).eccentric:
        raise InputError(
            "the robot has eccentric tubes of a model without an energy, so that forces of carriages are unknown; use "
            "model: energy in its file, or robot.bundle() in Python"
        )
    if e.load is not None and not e.load.has_energy:
        raise InputError("the load has moments or turns with the tip; drive loads need a load of dead forces")
    held = _HeldArm(e, robot.assembly(e.translations), side)
    force = np.array([held.force(i) for i in range(robot.n_tubes)])
    if previous is not None:
        force += _against_sliding(e, e.translations - previous.translations)
    return DriveLoads(held.torque, np.array([force[[*tubes]].sum() for tubes in robot.moving_together]))


def _of_bundle(e: Equilibrium, side: int) -> DriveLoads:
    """Loads of the drives of a bundle."""
    if e.load is not None or e.friction is not None:
        what = "a load" if e.load is not None else "friction"
        raise InputError(f"the equilibrium of a bundle has {what}; drive loads of bundles need one without")
    robot = e.robot
    torque, force = np.split(e.jacobian(side=side).energy, 2)
    # Where curved parts are straight behind the plate, advancing them releases that bending.
    held = np.array([tube.bending_stiffness * tube.curvature**2 / 2 for tube in robot.tubes], dtype=float)
    force = force - held * (e.translations < -side * NEAR)
    return DriveLoads(torque.copy(), np.array([force[[*tubes]].sum() for tubes in robot.moving_together]))


def _against_sliding(e: Equilibrium, moved: Array) -> Array:
    """Forces (n,) of the drives against friction along the tubes after they moved (n,), N."""
    out = np.zeros(e.robot.n_tubes)
    if e.friction is None or not e.friction.friction.sliding:
        return out
    torque, capacity, inner = (np.array(part) for part in (e.friction.torque, e.friction.capacity, e.friction.pair))
    radius = np.array([tube.outer_diameter / 2 for tube in e.robot.tubes])[inner]
    # Friction of a given size turns from the direction of the torque to that of the sliding.
    along = np.sqrt(np.maximum(capacity**2 - torque**2, 0.0)) / radius * np.sign(moved[inner + 1] - moved[inner])
    np.add.at(out, inner + 1, along)
    np.add.at(out, inner, -along)
    return out


class _Place(NamedTuple):
    """Data of one tube at a place on it."""

    stiffness: float
    """Bending stiffness, N m^2; 0 beyond the ends of the tube."""
    natural: complex
    """Precurvature u*_x + j u*_y in the axes of the tube, 1/m."""
    torsional_stiffness: float
    twist: float
    """Natural twist u*_z, 1/m."""

    @property
    def straightened(self) -> float:
        """Bending energy per length of the tube held straight, N."""
        return self.stiffness * abs(self.natural) ** 2 / 2

    def twisted(self, torque: float) -> float:
        """Part of H by torsion, N."""
        return -(torque**2) / (2 * self.torsional_stiffness) - torque * self.twist if self.stiffness else 0.0


def _at_place(e: Equilibrium, i: int, side: int, place: float | None = None) -> _Place:
    """Data of tube i at a distance from its clamped end (m), by default at the plate, as it comes from one side.

    With `side` 1 they are those just behind the place, with -1 just in front of it.
    """
    tube, assembly = e.robot.tubes[i], e.robot.assembly(e.translations)
    at = float(assembly.transmission[i]) if place is None else place
    inside = at - side * NEAR
    if not 0 <= inside <= tube.length:
        # In front of the clamp of a tube without transmission there is none of it, and what follows is the same.
        inside = 0.0 if inside < 0 else np.inf
    if inside > tube.length:
        return _Place(0.0, 0.0, 1.0, 0.0)
    if assembly.even:
        curved = inside > tube.straight_length
        return _Place(
            float(assembly.bending_stiffness[i]),
            complex(assembly.curvature[i]) if curved else 0.0,
            float(assembly.torsional_stiffness[i]),
            0.0,
        )
    assert assembly.lengthwise is not None
    n = assembly.n_tubes
    kb, kt, x, y, z, _ = assembly.lengthwise.values(np.full((1, n), at), np.full((1, n), inside))[:, 0, i].tolist()
    return _Place(kb, complex(x, y), kt, z)


class _HeldArm(ArmSections):
    """An equilibrium whose carriages begin to move to one side."""

    def __init__(self, e: Equilibrium, assembly: Assembly, side: int) -> None:
        super().__init__(e, assembly)
        self.side = side

    @property
    def torque(self) -> Array:
        """Torques (n,) of the drives, N m."""
        return -self.plate_torque

    @cached_property
    def friction_along(self) -> Array:
        """Sums (n,) of the friction torques on the tubes times their rates of rotation, N."""
        s, tube, torque = self.along
        out = np.zeros(self.n)
        if len(s):
            np.add.at(out, tube, torque * self.at(s).torsion[np.arange(len(s)), tube])
        return out

    def force(self, i: int) -> float:
        """Force of the drive of tube i, N."""
        assembly, e = self.assembly, self.e
        end, behind = float(assembly.end[i]), float(assembly.transmission[i])
        plate, torque = _at_place(e, i, self.side), float(self.torques[0, i])
        total = -plate.twisted(torque) - plate.straightened
        for s in self._breakpoints(i):
            total += self._jump(i, s)
        total -= self.friction_along[i] + self._varying(i)
        if e.load is not None:
            weight = masses(e.robot.tubes, e.load)[i] * np.array(e.load.gravity or (0.0, 0.0, 0.0))
            front = e.position[min(int(np.searchsorted(e.arc_length, end - NEAR)), len(e.position) - 1)]
            total -= float(weight @ front) * (end > NEAR) + float(weight[2]) * min(behind, e.robot.tubes[i].length)
        return float(total)

    def _breakpoints(self, i: int) -> list[float]:
        """Arc lengths of the breakpoints of tube i in front of the plate, and of friction there that is on it."""
        pairs = zip(self.assembly.breakpoints, self.assembly.breakpoint_tubes, strict=True)
        own = {s for s, tube in pairs if tube == i and s > -self.side * NEAR}
        concentrated = self.cuts[1:][self.jumps[1:, i] != 0].tolist()
        return sorted(own | {s for s in concentrated if min((abs(s - x) for x in own), default=1.0) > NEAR})

    def _jump(self, i: int, s: float) -> float:
        """H before less H after a breakpoint of tube i at arc length s, N, and the work of a force at the tip."""
        e, k = self.e, int(np.argmin(np.abs(self.cuts - s)))
        if not len(self.middle):
            return 0.0
        point, last = k * SHAPE_STEPS, len(self.middle)
        ahead = self.side > 0
        kb, natural = 0.0, 0j
        if (k < last) if ahead else k > 0:
            element = k if ahead else k - 1
            at = self.assembly.cross_sections(self.cuts[[k]], self.middle[[element]])
            others = np.arange(self.n) != i
            turned = e.rotation.T[[point]] - self.assembly.twist_angle(self.cuts[[k]])
            kb, natural = float(at.stiffness[0, others].sum()), complex(self.natural(at, turned)[0, others].sum())
        moment, torque = complex(self.moments[point]), float(self.torques[point, i])
        before, after = (_at_place(e, i, side, s + float(self.assembly.transmission[i])) for side in (1, -1))
        direction, value = np.exp(1j * e.rotation[i, point]), []
        for place, twisting in ((before, torque), (after, torque - float(self.jumps[k, i] * (k > 0)))):
            total = kb + place.stiffness
            own = place.stiffness * place.natural * direction
            bending = place.straightened - (abs(moment + natural + own) ** 2 / (2 * total) if total else 0.0)
            value.append(bending + place.twisted(twisting))
        result = value[0] - value[1]
        if not kb and not after.stiffness:
            result -= float(self._tip_force() @ e.frame[-1, :, 2])
        return result

    def _tip_force(self) -> Array:
        """Force (3,) that moves with the tip, N: the tip force, and contact forces there."""
        e, force = self.e, np.zeros(3)
        if e.load is not None:
            force += e.load.force
        for contact in () if e.walls is None else e.walls.contacts:
            if contact.arc_length > self.cuts[-1] - NEAR:
                force += contact.force
        return force

    def _varying(self, i: int) -> float:
        """Integral of dH/ds by what varies along tube i, N."""
        table = self.assembly.lengthwise
        if self.assembly.even or table is None or not len(self.middle):
            return 0.0
        e, total = self.e, 0.0
        for k, middle in enumerate(self.middle.tolist()):
            points = k * SHAPE_STEPS + np.arange(SHAPE_STEPS + 1)
            s, inside = e.arc_length[points], np.full(SHAPE_STEPS + 1, middle)
            at = self.assembly.cross_sections(s, inside)
            if not at.stiffness[0, i]:
                continue
            position, near = (x[:, None] + self.assembly.transmission for x in (s, inside))
            kb, kt, x, y, _, _ = table.values(position, near)[:, :, i]
            dkb, dkt, dx, dy, dz, _ = table.rates(position, near)[:, :, i]
            # Torques and moments are continuous, unlike torsion and curvature.
            u = (
                self.moments[points] + self.natural(at, e.rotation.T[points] - at.twist_angle).sum(1)
            ) / at.stiffness.sum(1)
            torque = self.torques[points, i] - (self.jumps[k, i] * (k > 0)) * (np.arange(SHAPE_STEPS + 1) == 0)
            turn = np.exp(1j * e.rotation[i, points])
            bent = u - turn * (x + 1j * y)
            rate = dkb * np.abs(bent) ** 2 / 2 - kb * (bent.conj() * turn * (dx + 1j * dy)).real
            rate += dkt * torque**2 / (2 * kt**2) - torque * dz
            total += (self.cuts[k + 1] - self.cuts[k]) * float(BOOLE @ rate)
        return total

"""Dry friction between tubes that bear a load, against a discrete energy of its own that IPOPT makes least.

The reference shares no code with the package: rotations at nodes and curvatures of the arm between them, on cells of
equal length, with the orientation as a product of exponentials. One increment is

    min  sum kt (theta')^2 / 2 + K |u - u0|^2 / 2 + V - work of the load + sum D |slip|

with |slip| as a bound on both sides of it, so that nothing is smoothed. Its error falls with the square of the cells,
which Richardson's extrapolation takes off where no point sticks beside one that slips.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from tubeopt import ConcentricRobot, Friction, InputError, Load, Tube, follow, forward_kinematics, load_equilibrium
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.typing import Array

MM = 1e-3
LENGTH, HELD = 0.1, (0.03, 0.02)
ROBOT = ConcentricRobot(
    (
        Tube(1.0 * MM, 0.7 * MM, HELD[0], LENGTH, 9.0, bending_stiffness=2e-3, torsional_stiffness=1.5e-3,
             mass_per_length=0.05),
        Tube(2.0 * MM, 1.1 * MM, HELD[1], LENGTH, 6.0, bending_stiffness=3e-3, torsional_stiffness=2.5e-3,
             mass_per_length=0.05),
    )
)  # fmt: skip
TORQUE = 2e-2
"""N m per m: it turns the tubes against each other by up to 0.1 rad."""

LOADS = {
    "tip force": Load((0.15, -0.1, 0.05)),
    "weight": Load((0.0, 0.0, -0.1), gravity=(0.0, -9.80665, 0.0)),
    "forces along the arm": Load(points=((0.05, (0.1, 0.2, 0.0)),), distributed=(1.0, 0.0, -0.5)),
}


@dataclass(frozen=True)
class Reference:
    """The discrete energy on a number of cells."""

    cells: int
    load: Load

    def states(self, path: list[list[float]], torque: float) -> list[tuple[Array, Array]]:
        """theta (2, cells + 1) and tip (3,) at every row of base rotations, from rest at the first."""
        m, h = self.cells, LENGTH / self.cells
        kb, kappa, kt = (np.array([getattr(t, name) for t in ROBOT.tubes]) for name in
                         ("bending_stiffness", "curvature", "torsional_stiffness"))  # fmt: skip
        theta, u, slip = ca.MX.sym("theta", 2, m + 1), ca.MX.sym("u", 2, m), ca.MX.sym("slip", m)
        alpha, old = ca.MX.sym("alpha", 2), ca.MX.sym("old", m)
        middle = (theta[:, :-1] + theta[:, 1:]) / 2
        pull = ca.repmat(ca.DM(kb * kappa), 1, m)
        # E = sum kb |u - u*_i|^2 / 2, whose least over u is V.
        energy = h * (ca.sumsqr(u) * kb.sum() / 2)
        energy -= h * ca.sum2(u[0, :] * ca.sum1(pull * ca.cos(middle)) + u[1, :] * ca.sum1(pull * ca.sin(middle)))
        energy += ca.sum1(ca.DM(kt / 2) * ca.sum2((theta[:, 1:] - theta[:, :-1]) ** 2) / h)
        energy += ca.sum1(ca.DM(kt / (2 * np.array(HELD))) * (theta[:, 0] - alpha) ** 2)
        R, p, work = ca.MX.eye(3), ca.MX.zeros(3, 1), 0
        mass = sum(t.mass_per_length for t in ROBOT.tubes)
        along = np.array(self.load.distributed or (0, 0, 0), dtype=float)
        if self.load.gravity is not None:
            along = along + mass * np.array(self.load.gravity)
        for k in range(m):
            half = _turned(R, u[:, k], h / 2)
            p_middle, p = p + h / 2 * R[:, 2] / 2 + h / 2 * half[:, 2] / 2, p + h * half[:, 2]
            R = _turned(R, u[:, k], h)
            work += h * ca.dot(ca.DM(along), p_middle)
            for part in self.load.points:
                if abs(part.at - (k + 1) * h) < 1e-9:
                    work += ca.dot(ca.DM(part.force), p)
        work += ca.dot(ca.DM(self.load.force), p)
        relative = (middle[1, :] - middle[0, :]).T
        x = ca.vertcat(ca.vec(theta), ca.vec(u), slip)
        bounds = ca.vertcat(slip - (relative - old), slip + (relative - old))
        # In units of 1 mJ, as IPOPT likes numbers near 1.
        cost = 1e3 * (energy - work + torque * h * ca.sum1(slip))
        problem = {"x": x, "p": ca.vertcat(alpha, old), "f": cost, "g": bounds}
        options = {"ipopt": {"print_level": 0, "sb": "yes", "tol": 1e-12}, "print_time": False, "expand": True}
        solver = ca.nlpsol("increment", "ipopt", problem, options)
        read = ca.Function("read", [x], [theta, p, relative])
        start, before, out = np.concatenate([np.zeros(2 * (m + 1) + 2 * m), np.zeros(m)]), None, []
        for row in path:
            # At rest nothing has rubbed yet: the first state is one without friction.
            inputs = np.concatenate([row, np.full(m, np.nan) if before is None else before])
            if before is None:
                frictionless = problem | {"f": 1e3 * (energy - work) + ca.sumsqr(slip)}
                del frictionless["g"]
                free = ca.nlpsol("free", "ipopt", frictionless, options)
                answer, solved = free(x0=start, p=np.nan_to_num(inputs)), free.stats()["success"]
            else:
                answer, solved = solver(x0=start, p=inputs, lbg=0.0), solver.stats()["success"]
            assert solved
            start = np.array(answer["x"]).ravel()
            turned, tip, current = (np.array(part) for part in read(start))
            before = current.ravel()
            out.append((turned, tip.ravel()))
        return out


def _turned(R: ca.MX, u: ca.MX, h: float) -> ca.MX:
    """R exp(h hat(u)) for u along x and y, smooth at u = 0."""
    square = h * h * (ca.sumsqr(u) + 1e-16)
    angle = ca.sqrt(square)
    hat = h * ca.skew(ca.vertcat(u, 0))
    return R @ (ca.MX.eye(3) + ca.sin(angle) / angle * hat + (1 - ca.cos(angle)) / square * hat @ hat)


def ends(state: Equilibrium) -> Array:
    """Relative rotation at plate and tip, rad."""
    phi = state.rotation[1] - state.rotation[0]
    return np.array([phi[0], phi[-1]])


@pytest.mark.parametrize("name", LOADS)
def test_states_that_slip_are_those_of_an_independent_energy(name: str) -> None:
    load, path = LOADS[name], [[0.0, 0.0], [0.2, 1.5], [-0.3, -1.0]]
    result = follow(ROBOT, path, load=load, friction=Friction(TORQUE)).equilibria
    coarse, fine = (Reference(cells, load).states(path, TORQUE) for cells in (16, 32))
    for state, (_, one), (_, other) in zip(result, coarse, fine, strict=True):
        assert state.tip_position == pytest.approx((4 * other - one) / 3, abs=1e-8)
    for state in result[1:]:
        assert state.friction is not None
        assert not state.friction.sticking.any()
    for state, (turned, _), (finer, _) in zip(result[1:], coarse[1:], fine[1:], strict=True):
        rough, sharp = (t[1, [0, -1]] - t[0, [0, -1]] for t in (turned, finer))
        assert ends(state) == pytest.approx((4 * sharp - rough) / 3, abs=2e-6)


def test_states_with_a_front_are_those_of_an_independent_energy() -> None:
    load, path = LOADS["tip force"], [[0.0, 0.0], [0.0, 1.5], [0.0, 1.46], [0.0, 1.42]]
    result = follow(ROBOT, path, load=load, friction=Friction(TORQUE)).equilibria
    expected = Reference(40, load).states(path, TORQUE)
    sticks = [float(state.friction.sticking.mean()) for state in result[2:] if state.friction is not None]
    assert all(0 < fraction < 1 for fraction in sticks)
    for state, (turned, tip) in zip(result, expected, strict=True):
        assert state.tip_position == pytest.approx(tip, abs=1e-5)
        assert ends(state) == pytest.approx(turned[1, [0, -1]] - turned[0, [0, -1]], abs=2e-3)


def test_no_load_is_the_zero_of_a_load() -> None:
    path, rub = [[0.0, 0.0], [0.3, 1.2], [0.1, 0.9]], Friction(TORQUE, plate=1e-4, ends=1e-4)
    shift = -0.001 * np.arange(3)[:, None] * [2.0, 1.0]
    free, zero = (follow(ROBOT, path, shift, friction=rub, load=load).equilibria for load in (None, Load()))
    for one, other in zip(free, zero, strict=True):
        assert other.tip_position == pytest.approx(one.tip_position, abs=1e-9)
        assert other.rotation == pytest.approx(one.rotation, abs=1e-8) or len(one.arc_length) != len(other.arc_length)
        assert one.friction is not None
        assert other.friction is not None
        assert other.friction.heat == pytest.approx(one.friction.heat, rel=1e-6, abs=1e-15)
        assert other.margin == pytest.approx(one.margin, abs=1e-7)


def test_friction_of_round_off_leaves_the_loaded_equilibria() -> None:
    path, load = [[0.0, 0.0], [0.3, 1.2], [0.1, 0.9]], LOADS["tip force"]
    plain = follow(ROBOT, path, load=load).equilibria
    for one, other in zip(plain, follow(ROBOT, path, load=load, friction=Friction(1e-13)).equilibria, strict=True):
        assert other.tip_position == pytest.approx(one.tip_position, abs=1e-12)
        assert other.base_wrench == pytest.approx(one.base_wrench, abs=1e-11)


def test_history_goes_on_from_a_file(tmp_path: Path) -> None:
    path, load, rub = [[0.0, 0.0], [0.0, 1.5], [0.0, 1.46], [0.0, 1.2]], LOADS["tip force"], Friction(TORQUE, ends=1e-4)
    whole = follow(ROBOT, path, load=load, friction=rub).equilibria
    whole[2].save(tmp_path)
    last = follow(ROBOT, path[2:], start=load_equilibrium(tmp_path), load=load, friction=rub).equilibria[-1]
    assert last.tip_position == pytest.approx(whole[-1].tip_position, abs=1e-9)
    assert last.friction is not None
    assert whole[-1].friction is not None
    assert last.friction.heat == pytest.approx(whole[-1].friction.heat, rel=1e-6)


def test_a_load_that_comes_and_goes_leaves_its_mark() -> None:
    """What friction takes is energy that the load has done: the robot does not come back to where it was."""
    rub, current = Friction(5e-3), [[0.0, 1.2]] * 2
    before = follow(ROBOT, [[0.0, 0.0], current[0]], friction=rub).equilibria[-1]
    pushed = follow(ROBOT, current, start=before, load=Load((-0.4, 0.3, 0.0)), friction=rub).equilibria[-1]
    after = follow(ROBOT, current, start=pushed, load=Load(), friction=rub).equilibria[-1]
    heats = [state.friction.heat for state in (before, pushed, after) if state.friction is not None]
    assert heats[0] < heats[1] <= heats[2]
    assert np.linalg.norm(pushed.tip_position - before.tip_position) > 5 * MM
    assert 1e-6 < np.linalg.norm(after.tip_position - before.tip_position) < 2 * MM


def test_a_loaded_robot_snaps_later_with_friction() -> None:
    tubes = (
        Tube(d * MM, (d - 0.5) * MM, 1e-9, 1.0, 2.0, bending_stiffness=1e-3, torsional_stiffness=1e-3)
        for d in (1.0, 2.0)
    )
    robot, load = ConcentricRobot(tuple(tubes)), Load((2e-5, 0.0, -1e-5))
    path = np.linspace([0.0, 0.0], [0.0, np.radians(330)], 12)
    (plain,) = follow(robot, path, load=load).snaps
    (rubbed,) = follow(robot, path, load=load, friction=Friction(1e-4)).snaps
    assert plain.index + plain.fraction < rubbed.index + rubbed.fraction
    assert rubbed.before.friction is not None
    assert rubbed.after.friction is not None
    assert abs(rubbed.before.friction.held_margin) < 1e-3
    assert rubbed.after.stable
    assert rubbed.energy_released > rubbed.after.friction.heat - rubbed.before.friction.heat > 0


def test_loads_without_an_energy_are_refused() -> None:
    with pytest.raises(InputError, match="moment"):
        follow(ROBOT, [[0.0, 0.0]], load=Load(moment=(0.01, 0.0, 0.0)), friction=Friction(TORQUE))
    push = Load((0.1, 0.0, 0.0))
    state = follow(ROBOT, [[0.0, 0.0], [0.0, 1.0]], load=push, friction=Friction(TORQUE)).equilibria[-1]
    with pytest.raises(InputError, match="friction"):
        _ = state.compliance
    assert forward_kinematics(ROBOT, [0.0, 1.0], load=push).compliance.shape == (6, 6)

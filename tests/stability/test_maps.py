"""Energy maps and stability maps."""

from __future__ import annotations

import numpy as np
import pytest

from tests.examples import CRL, DEG, THESIS, TWO_TUBE
from tests.stability.reference import Elements, bundle
from tests.stability.robots import inner_and_middle, unit_pair
from tubeopt import ConcentricRobot, InputError, follow, snap_free_certificate
from tubeopt.robots.robot import Robot
from tubeopt.stability import EnergyMap, energy_map, find_snap, stability_map
from tubeopt.typing import Array


def held_energy(robot: Robot, rotations: Array, tubes: tuple[int, int], tips: Array) -> float:
    """Least energy with two tips held, by Newton's method with multipliers in finite elements from straight tubes."""
    elements = Elements(bundle(robot))
    n = robot.n_tubes
    theta = rotations + np.zeros((len(elements.node), n))
    held = np.zeros(len(elements.free), dtype=bool)
    for tube, tip in zip(tubes, tips, strict=True):
        end = robot.tubes[tube].curved_length
        theta[:, tube] += (tip - rotations[tube]) * np.minimum(1.0, elements.node / end)
        held |= elements.free == int(np.argmin(np.abs(elements.node - end))) * n + tube
    for _ in range(200):
        energy, gradient, hessian = elements.energy(rotations, theta)
        block, force = hessian[np.ix_(~held, ~held)], -gradient[~held]
        shift = max(0.0, 1e-3 - float(np.linalg.eigvalsh(block)[0]))
        step = np.zeros(theta.size)
        step[elements.free[~held]] = np.linalg.solve(block + shift * np.eye(len(block)), force)
        step *= min(1.0, 0.3 / max(np.abs(step).max(), 1e-12))
        theta = theta + step.reshape(theta.shape)
        if np.abs(step).max() < 1e-9:
            break
    return float(energy)


def interpolated(chart: EnergyMap, tips: Array) -> tuple[float, Array]:
    """Value and gradient of the map at given tip angles, by a polynomial of degree 4 over the nearest samples."""
    k = [int(np.argmin(np.abs(axis - tip))) for axis, tip in zip((chart.first, chart.second), tips, strict=True)]
    rows = np.s_[k[0] - 3 : k[0] + 4], np.s_[k[1] - 3 : k[1] + 4]
    x, y = np.meshgrid(chart.first[rows[0]] - tips[0], chart.second[rows[1]] - tips[1], indexing="ij")
    powers = [(a, b) for a in range(5) for b in range(5 - a)]
    matrix = np.stack([(x**a * y**b).ravel() for a, b in powers], axis=1)
    fit = np.linalg.lstsq(matrix, chart.energy[rows].ravel(), rcond=None)[0]
    return float(fit[powers.index((0, 0))]), fit[[powers.index((1, 0)), powers.index((0, 1))]]


@pytest.mark.parametrize(
    ("robot", "rotations"), [(inner_and_middle(), (150 * DEG, 0.0)), (unit_pair(3.0, 0.2), (2.9, 0.0))]
)
def test_two_tubes_are_stationary_at_their_equilibria(robot: Robot, rotations: tuple[float, float]) -> None:
    chart = energy_map(robot, rotations, samples=41)
    assert len(chart.equilibria) == 3
    scale = float(np.ptp(chart.energy))
    offsets = []
    for equilibrium in chart.equilibria:
        value, slope = interpolated(chart, equilibrium.tip_rotations)
        assert np.abs(slope).max() < 2e-3 * scale
        offsets.append(value - equilibrium.energy)
    # What is not coupled bends with the same energy at all of them.
    assert np.ptp(offsets) < 2e-4 * scale
    lowest = min(equilibrium.energy for equilibrium in chart.equilibria)
    assert chart.energy.min() >= lowest + min(offsets) - 1e-3 * scale


def test_energy_map_against_finite_elements() -> None:
    rotations = np.array([2.0, 0.3, 0.0])
    for robot in (THESIS, CRL):
        chart = energy_map(robot, rotations, np.zeros(3), samples=9)
        expected = np.array(
            [
                [held_energy(robot, rotations, (0, 1), np.array([a, b])) for b in chart.second[2:7:2]]
                for a in chart.first[2:7:2]
            ]
        )
        # The map leaves out what bends without coupling.
        tubes = bundle(robot)
        alone = ~tubes.coupling.any((1, 2))
        rest = float(tubes.constant[alone] @ tubes.length[alone])
        assert chart.energy[2:7:2, 2:7:2] + rest == pytest.approx(expected, rel=1e-7)


def test_axes_hold_the_equilibria_and_other_tubes_can_be_chosen() -> None:
    chart = energy_map(CRL, [2.9, 0.3, 0.0], tubes=(2, 0), samples=7)
    assert chart.tubes == (2, 0)
    for equilibrium in chart.equilibria:
        assert chart.first[0] < equilibrium.tip_rotations[2] < chart.first[-1]
        assert chart.second[0] < equilibrium.tip_rotations[0] < chart.second[-1]


def test_stability_map_is_following_from_home() -> None:
    done: list[tuple[int, int]] = []
    chart = stability_map(
        THESIS, samples=5, directions=8, workers=1, progress=lambda count, whole: done.append((count, whole))
    )
    assert chart.angles == pytest.approx(np.linspace(-np.pi, np.pi, 5))
    assert done[-1][0] == done[-1][1] == len(done)
    for i, j in ((0, 3), (2, 2), (4, 0), (1, 4)):
        goal = [chart.angles[i], chart.angles[j], 0.0]
        path = follow(THESIS, [[0.0, 0.0, 0.0], goal])
        assert chart.margin[i, j] == pytest.approx(path.equilibria[-1].margin, abs=1e-9)
        assert chart.snaps[i, j] == len(path.snaps)
    assert (chart.margin > 0).all()
    # An odd number of directions has no opposite ones, so that every way is followed: none is another's mirror image.
    every = stability_map(THESIS, samples=5, directions=3)
    assert every.margin == pytest.approx(chart.margin, abs=1e-9)
    assert np.array_equal(every.snaps, chart.snaps)
    requested = np.searchsorted(chart.directions, np.arange(8) * np.pi / 4)
    assert chart.directions[requested] == pytest.approx(np.arange(8) * np.pi / 4)
    for angle, point in zip(chart.directions[requested], chart.boundary[requested], strict=True):
        ray = np.array([np.cos(angle), np.sin(angle)])
        goal = [*(ray * np.pi / np.abs(ray).max()), 0.0]
        snap = find_snap(THESIS, ([0.0, 0.0, 0.0], None), (goal, None))
        assert np.isnan(point).all() if snap is None else point == pytest.approx(snap.rotations[:2], abs=1e-9)


def test_stability_map_of_a_robot_that_snaps_and_two_workers() -> None:
    """Advanced transitions lengthen nothing, but withdrawn tubes twist in front of the plate: snaps inside the map."""
    longer = inner_and_middle().tubes
    robot = ConcentricRobot((*longer, THESIS.tubes[2]))
    one = stability_map(robot, samples=4, directions=8, workers=1)
    two = stability_map(robot, samples=4, directions=8, workers=2)
    assert np.array_equal(one.margin, two.margin)
    assert np.array_equal(one.boundary, two.boundary, equal_nan=True)
    assert (one.margin >= snap_free_certificate(robot)).all()


def test_messages() -> None:
    with pytest.raises(InputError, match="the robot has 2 tubes; a map over two relative rotations needs at least 3"):
        stability_map(TWO_TUBE)
    with pytest.raises(InputError, match=r"tubes is \(0, 3\); they must be two different tubes from 0 to 2"):
        stability_map(THESIS, tubes=(0, 3))
    with pytest.raises(InputError, match=r"tubes is \(1, 1\); they must be two different tubes"):
        energy_map(THESIS, [0.0, 0.0, 0.0], tubes=(1, 1))
    with pytest.raises(InputError, match=r"tubes is \(0, 5\); each must be a tube, from 0, that is coupled"):
        energy_map(THESIS, [0.0, 0.0, 0.0], tubes=(0, 5))
    with pytest.raises(InputError, match="translations has 1 numbers"):
        stability_map(THESIS, [0.0])

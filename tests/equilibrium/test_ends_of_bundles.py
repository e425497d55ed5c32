"""Ends of tubes of a bundle that meet: they pass each other, stay together, or separate."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from tests.equilibrium.test_bundle import bundle_of_thesis
from tubeopt import BundleRobot, find_stroke_force, load_robot
from tubeopt.block.transcription.bundle import BundleState, holding_forces, rearranged, together
from tubeopt.equilibrium.bundle import SETTLE, Bundled, bundle_at
from tubeopt.equilibrium.kinematics import point_of
from tubeopt.solvers.compiled.bundle import bundle_kernel, solve_bundle_compiled
from tubeopt.typing import Array

HOME = (0.0, 0.0, 0.0)

NEAR_ENDS = (
    (18.93, 86.89, -150.65),
    (157.31, -32.60, 34.65),
    (-122.32, 40.51, -164.18),
    (35.35, -158.67, -40.45),
    (-51.05, -160.77, 144.32),
    (-85.545, 75.608, 109.518),
    (89.16, 142.73, -134.69),
)
"""Rotations (deg) at which two ends of the robot of the thesis are 0.1 to 70 micrometres apart."""


def cold(rotations: Array) -> tuple[Bundled, BundleState]:
    """Member and state of the equilibrium that the general solver finds from tubes without torsion."""
    member = Bundled.cold(bundle_of_thesis(), rotations, HOME)
    result = member.descend(member.untwisted())
    assert result.converged
    return member.owner(result.state), result.state


def least_force(member: Bundled, state: BundleState) -> float:
    """Least derivative (N) of the energy by a gap between boundaries that are together, in all their orders."""
    out = np.inf
    for chain in together(state.problem.held):
        first, last = chain[0] - 1, chain[-1] + 1
        order = state.problem.order
        for part in permutations(order[first:last]):
            problem, x = rearranged(state, (*order[:first], *part, *order[last:]), state.problem.held)
            result = Bundled(member.robot, problem, member.rotations, HOME).newton(x, SETTLE)
            if result.state.problem.held == state.problem.held:
                out = min(out, float(holding_forces(result.state).min()))
            else:
                out = min(out, -1.0)  # it has separated
    return out


@pytest.mark.parametrize("degrees", NEAR_ENDS)
def test_short_sections_are_solved_by_the_kernel_as_by_the_general_solver(degrees: tuple[float, ...]) -> None:
    if bundle_kernel(3) is None:
        pytest.skip("there is no compiler")
    rotations = np.radians(degrees)
    solved = solve_bundle_compiled(bundle_at(bundle_of_thesis(), HOME), rotations)
    assert solved is not None
    found = solved.solution
    assert max(found.errors.theta, found.errors.tip) < 1e-9
    member, state = cold(rotations)
    assert found.energy == pytest.approx(state.energy, abs=1e-14)
    assert found.margin == pytest.approx(member.margin(state), abs=1e-8)


@pytest.mark.parametrize("degrees", [(0.0, 120.0, -120.0), (10.0, 130.0, -110.0), (0.0, -120.0, 120.0)])
def test_three_ends_together_separate_where_this_lowers_the_energy(degrees: tuple[float, ...]) -> None:
    """A straight arm is no minimum: the last tube by itself is curved."""
    member, state = cold(np.radians(degrees))
    assert len(state.problem.held) < 2
    assert not state.problem.held or least_force(member, state) > 0
    straight = member.owner(state).at(member.untwisted()) if state.problem.held else member.at(member.untwisted())
    assert state.energy < straight.energy


def test_a_push_ends_where_ends_separate_with_a_snap() -> None:
    robot = load_robot("configs/bundles/steerable_sheath.yaml")
    assert isinstance(robot, BundleRobot)
    limit = find_stroke_force(robot, np.radians([10.0, 60.0, 0.0]))
    assert limit is not None
    assert limit.kind == "ends"
    assert limit.factor == pytest.approx(8.89587, abs=1e-4)
    # The ends of tubes 1 and 3 are together up to the limit, and no force holds them together there.
    state = point_of(limit.before).state
    assert limit.before.tube_end[0] == pytest.approx(limit.before.tube_end[2], abs=1e-9)
    assert abs(holding_forces(state)[0]) < 1e-4
    assert limit.before.margin > 0.4
    assert limit.after is not None
    assert limit.after.load == limit.before.load
    assert limit.after.tube_end[0] - limit.after.tube_end[2] > 1e-3
    assert limit.after.margin > 0
    assert limit.energy_released == pytest.approx(limit.before.potential - limit.after.potential)
    assert limit.energy_released > 0.005

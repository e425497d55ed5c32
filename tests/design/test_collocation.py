"""One program of equilibrium blocks has the optimum of the program in which equilibria are solved inside."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import pytest

from tests.design.tasks import equal_pair, snap_free_thesis, two_tubes
from tubeopt import DesignSolution, DesignTask, InputError, optimize_design
from tubeopt.bodies.corridors import Corridor
from tubeopt.design import (
    Avoid,
    CustomObjective,
    CustomRequirement,
    Free,
    Length,
    Nesting,
    Poses,
    Quantities,
    Reach,
    SnapFree,
    SnapFreeInUse,
    Strain,
    Target,
    Wall,
)

POSE = Poses(((0.0, 3.0),), ((-0.02, 0.0),))


@dataclass(frozen=True)
class Aside(CustomRequirement):
    """Distance of the tips from the axis of the plate."""

    limit: float
    words, unit, factor, size = "distance of the tips from the axis", "mm", 1e3, 1e-3

    def expression(self, q: Quantities) -> Any:
        return ca.vertcat(*(ca.norm_2(pose.tip_position[:2]) for pose in q.poses)) - self.limit


class Height(CustomObjective):
    """Height of the first tip."""

    words, unit, factor, sign = "height of the tip", "mm", 1e3, -1

    def expression(self, q: Quantities) -> Any:
        return q.poses[0].tip_position[2]


def both(task: DesignTask) -> tuple[DesignSolution, DesignSolution]:
    reduced = optimize_design(task, turns=0)
    collocated = optimize_design(task, turns=0, method="collocation")
    assert collocated.verification.kept
    assert collocated.objective == pytest.approx(reduced.objective, rel=1e-6)
    return reduced, collocated


def test_certificate_and_change() -> None:
    reduced, collocated = both(snap_free_thesis(0.05))
    for a, b in zip(reduced.dimensions, collocated.dimensions, strict=True):
        assert b.after == pytest.approx(a.after, rel=1e-6)
    assert collocated.sensitivities[0].derivative == pytest.approx(reduced.sensitivities[0].derivative, rel=1e-3)


def test_margin_of_a_pose() -> None:
    """Two tubes of short transmission, turned against each other, with the least change that keeps a margin."""
    robot = equal_pair(0.1, 0.005, 9.0)
    requirements = (
        Poses(((0.0, 3.1),), ((0.0, 0.0),)),
        SnapFreeInUse(0.7, paths=False),
        Strain((0.02,), in_poses=False),
    )
    reduced, collocated = both(DesignTask(robot, (Free("curvature", (0, 1), 2.0, 40.0),), requirements))
    for a, b in zip(reduced.dimensions, collocated.dimensions, strict=True):
        assert b.after == pytest.approx(a.after, rel=1e-6)
    assert collocated.equilibria[0].margin == pytest.approx(0.7, abs=1e-6)


def test_free_poses_lengths_and_own_parts() -> None:
    free = (Free("curvature", (0, 1), 5.0, 25.0), Free("curved_length", (0,), 0.03, 0.1))
    reach = Reach((Target((0.02, -0.03, 0.11), 5e-3),))
    requirements = (reach, SnapFree(0.1), Aside(0.032), Length("length", 0, 0.2), Nesting(5e-5), Wall(8e-5))
    design = both(DesignTask(two_tubes(), free, requirements, Height()))[1]
    assert design.objective == pytest.approx(design.equilibria[0].tip_position[2], abs=1e-8)


def test_what_no_block_expresses_is_refused() -> None:
    corridor = Avoid((Corridor(((0.0, 0.0, -0.01), (0.0, 0.0, 0.2)), 0.1),))
    task = DesignTask(two_tubes(), (Free("curvature", (0, 1), 2.0, 40.0),), (POSE, corridor))
    for other, words in ((corridor, "Avoid"), (Strain((0.02,)), "Strain in poses")):
        with pytest.raises(InputError, match=f"method 'collocation' does not support the requirement {words}"):
            optimize_design(replace(task, requirements=(POSE, other)), method="collocation")
    with pytest.raises(InputError, match=r"method is 'colocation'.*did you mean 'collocation'"):
        optimize_design(task, method="colocation")

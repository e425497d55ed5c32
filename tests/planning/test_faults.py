"""What a proof holds against a motion: margin, clearance, speed and re-integration, each up to its limit."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.examples import nested
from tubeopt import verify_trajectory
from tubeopt.bodies.obstacles import Sphere
from tubeopt.planning import proof
from tubeopt.planning.trajectory_trace import ClearanceTarget

ROOM = 1.01 * proof.ACCURACY

STRAIGHT = nested((0.0, 0.05, 0.0))


def beside(clearance: float, max_force: float = 0.0) -> proof.Proof:
    """A straight tube that turns beside a ball."""
    ball = Sphere((0.02, 0.0, 0.05), 1e-3)
    joints = {"obstacles": [ball], "clearance": clearance, "max_force": max_force}
    return verify_trajectory(STRAIGHT, [0.0, 1.0], [[0.0], [0.02]], **joints)  # type: ignore[arg-type]


def test_a_clearance_under_any_force_is_less_by_the_deflection_of_a_cantilever() -> None:
    """F L^3 / (3 EI) towards the ball; the bound of it is at most 3 % above."""
    force, tube = 0.02, STRAIGHT.tubes[0]
    moved = force * 0.05**3 / (3 * tube.bending_stiffness)
    gap = 0.02 - 1e-3 - tube.outer_diameter / 2
    true = gap - moved
    assert moved > 10 * ROOM
    near = beside(true - 0.03 * moved - ROOM, force)
    assert near.holds
    assert true - 0.03 * moved <= near.measured_clearance <= true
    assert true - 0.03 * moved - ROOM <= near.least_clearance <= true
    assert any("the arm comes as close as" in fault for fault in beside(true + 1e-6, force).faults)


@pytest.mark.parametrize(
    ("found", "refuted", "open_"),
    [
        ({}, "", ""),
        ({"margin": 0.2999}, "the margin falls to 0.2999", ""),
        ({"measured": 1.999e-3, "clearance": 1.99e-3}, "the arm comes as close as 1.999 mm", ""),
        ({"clearance": 1.999e-3}, "", "of the clearance of 2 mm only 1.999 mm are shown"),
        (
            {"clearance": -np.inf, "unproved": ((0.25, 0.5),)},
            "",
            "one stable branch joins 25 % and 50 % of the trajectory",
        ),
    ],
    ids=["all is kept", "margin", "closest place", "bound of the clearance", "branch"],
)
def test_what_falls_short_of_a_limit_is_a_fault(found: dict[str, Any], refuted: str, open_: str) -> None:
    retained = {"snap": None, "margin": 0.3, "measured": 2e-3, "clearance": 2e-3, "unproved": ()}
    trajectory_trace: Any = SimpleNamespace(steps=[SimpleNamespace(at=1.0)], **(retained | found))
    verifier: Any = SimpleNamespace(target=ClearanceTarget(2e-3, 1e-5, 9), unprovable="", flutters=False)
    faults, unproved = proof._branch_faults(verifier, trajectory_trace, 0.3, np.array([0.0, 1.0]))
    assert [refuted in fault for fault in faults] == [True] * bool(refuted)
    assert [open_ in fault for fault in unproved] == [True] * bool(open_)


def test_a_tip_that_a_second_solver_puts_elsewhere_is_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    allowed = proof.AGREEMENT * STRAIGHT.tubes[0].length
    for fraction, fine in ((0.99, True), (1.01, False)):
        monkeypatch.setattr(proof, "_again", lambda equilibria, fraction=fraction: fraction * allowed)
        result = verify_trajectory(STRAIGHT, [0.0, 1.0], [[0.0], [0.02]])
        assert result.holds == fine
        assert result.reintegration == fraction * allowed

"""Inverse kinematics with own costs and constraints."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np
import pytest

from tests.examples import THESIS
from tubeopt import IkSession, InputError, InverseOptions, forward_kinematics, inverse_kinematics
from tubeopt.design import CustomObjective, CustomRequirement, Quantities
from tubeopt.equilibrium.verification import point_at
from tubeopt.inverse import multistart

SEED = ((0.0, 0.5, 1.0), (-0.03, -0.02, 0.0))
REFERENCE = ((0.4, 0.7, 0.6), (-0.02, -0.015, -0.005))
SHARE = 2 / 0.36


@dataclass(frozen=True)
class Aside(CustomRequirement):
    """How far the middle of the arm stays on one side."""

    limit: float
    description, unit, factor, size = "place of the middle", "mm", 1e3, 1e-3

    def expression(self, q: Quantities) -> Any:
        return ca.vertcat(*(pose.position(0.5)[0] for pose in q.poses)) - self.limit


class Close(CustomObjective):
    """The built-in objective "nearest", of REFERENCE."""

    description = "distance from a reference"

    def expression(self, q: Quantities) -> Any:
        (pose,) = q.poses
        turned, moved = pose.rotations - ca.DM(REFERENCE[0]), pose.translations - ca.DM(REFERENCE[1])
        return (ca.sumsqr(turned) + SHARE**2 * ca.sumsqr(moved)) / 2


@dataclass(frozen=True)
class Turning(CustomRequirement):
    """What poses are asked for in designs only."""

    limit: float = 0.0
    description = "how far the tip turns"

    def expression(self, q: Quantities) -> Any:
        return ca.sumsqr(q.poses[0].turning) - self.limit


def test_own_cost_equal_to_a_built_in_one_has_the_same_optimum() -> None:
    target = forward_kinematics(THESIS, *SEED).tip_position
    weights = ([1.0] * 3, [SHARE] * 3)
    built_in = inverse_kinematics(THESIS, target, start=SEED, reference=REFERENCE, weights=weights)
    nothing = ([1e-7] * 3, [1e-7] * 3)
    own = inverse_kinematics(THESIS, target, start=SEED, weights=nothing, options=InverseOptions(extra_cost=Close()))
    assert own.position_error < 1e-8
    gaps = [
        np.append(one.rotations - REFERENCE[0], SHARE * (one.translations - REFERENCE[1])) for one in (built_in, own)
    ]
    cost = [0.5 * float(gap @ gap) for gap in gaps]
    assert cost[1] == pytest.approx(cost[0], rel=1e-5)
    assert own.rotations == pytest.approx(built_in.rotations, abs=1e-3)


def test_own_constraint_is_kept_in_every_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(multistart, "COMPARED", 1)
    start = forward_kinematics(THESIS, *SEED)
    without = inverse_kinematics(THESIS, start.tip_position, start=SEED)
    options = InverseOptions(extra_constraints=(Aside(0.0105),))
    answer = inverse_kinematics(THESIS, start.tip_position, start=SEED, options=options)
    positions = [point_at(one.equilibrium, one.equilibrium.arc_length[-1] / 2)[0][0] for one in (without, answer)]
    assert positions[0] < 0.009
    assert positions[1] >= 0.0105 - 3e-8  # the arm is interpolated between shape points
    assert answer.reached
    assert "place of the middle" in answer.active
    session = IkSession(THESIS, start=answer, options=options)
    for step in range(3):
        moved = session.solve(answer.target_position + (step + 1) * np.array([2e-4, 0.0, 0.0]))
        assert point_at(moved.equilibrium, moved.equilibrium.arc_length[-1] / 2)[0][0] >= 0.0105


def test_what_makes_no_sense_is_refused() -> None:
    for options, text in (
        ({"extra_cost": Aside(0.0)}, "extra_cost is .* it must be a CustomObjective"),
        ({"extra_constraints": (Close(),)}, "extra_constraints contains .* it must be a sequence of CustomRequirement"),
        ({"extra_constraints": 3}, "extra_constraints is 3"),
        ({"extra_cost": Close(), "method": "nlp"}, "method 'nlp' does"),
    ):
        with pytest.raises(InputError, match=text):
            inverse_kinematics(THESIS, (0.0, 0.0, 0.2), options=InverseOptions(**options))
    target = forward_kinematics(THESIS, *SEED).tip_position
    with pytest.raises(InputError, match="the turning of a pose is available in designs only"):
        inverse_kinematics(THESIS, target, start=SEED, options=InverseOptions(extra_constraints=(Turning(),)))

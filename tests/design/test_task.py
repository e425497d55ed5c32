"""What makes no task is refused in a sentence."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from tests.design.tasks import THESIS, two_tubes
from tubeopt import DesignTask, InputError, optimize_design
from tubeopt.bodies.corridors import Corridor
from tubeopt.design import (
    Coverage,
    Free,
    Length,
    Objective,
    Poses,
    SnapFree,
    SnapFreeInUse,
    StockTube,
    Strain,
    Target,
    Tolerances,
    pareto_front,
    tolerance_analysis,
)

FREE = (Free("curvature", (0, 1), 0.0, 20.0),)

WRONG: list[tuple[Callable[[], object], str]] = [
    (lambda: DesignTask("robot.yaml", FREE), "robot is a str; a design needs a robot"),  # type: ignore[arg-type]
    (lambda: DesignTask(two_tubes(), ()), "free is empty"),
    (lambda: DesignTask(two_tubes(), (Free("curvature", (2,), 0, 1),)), "names tube 3; the robot has tubes 1 to 2"),
    (lambda: DesignTask(two_tubes(), FREE * 2), "curvature of tube 1 is free twice"),
    (lambda: DesignTask(two_tubes(), FREE, (SnapFree(0.1, ((0.0,),)),)), "has 1 numbers; it must be 2"),
    (
        lambda: DesignTask(two_tubes(), FREE, (SnapFree(0.1, ((0.2, 0.0),)),)),
        "at most the lower bound of its straight length",
    ),
    (lambda: DesignTask(two_tubes(), FREE, (SnapFree(0.1), SnapFree(0.2))), "SnapFree is given twice"),
    (lambda: DesignTask(two_tubes(), FREE, (SnapFreeInUse(),)), "SnapFreeInUse needs"),
    (lambda: DesignTask(two_tubes(), FREE, (Strain((0.01,) * 3),)), "strain has 3 limits; it must be 1 or 2"),
    (lambda: DesignTask(two_tubes(), FREE, (Length("length", 4, 0.1),)), "length names tube 5"),
    (lambda: DesignTask(two_tubes(), FREE, (), Objective("margin")), "needs a certificate or task poses"),
    (lambda: DesignTask(two_tubes(), FREE, (), (Objective("strain"),) * 2), "an objective is given twice"),
    (lambda: Free("curvatur", (0,), 0, 1), "did you mean 'curvature'"),
    (lambda: Free("curvature", (0,), 2, 1), "the lower must not be greater"),
    (lambda: Free("curved_length", (0,), -1, 1), "it must be at least 0"),
    (lambda: Objective("reach_radius"), "the objective reach_radius"),
    (lambda: SnapFree(1.0), "it must be less than 1"),
    (lambda: SnapFree(0.1, box=((0.1, 0.0), (0.0, 0.0))), "box of translations"),
    (lambda: Target((0, 0, 0.1), 0.0), "tolerance of a target is 0"),
    (lambda: Target((0, 0, 0.1), direction=(0, 0, 0)), "it must point somewhere"),
    (lambda: Corridor(((0, 0, 0),), 0.1), "it must have at least 2"),
    (lambda: Poses(((0, 0),), ((0, 0), (0, 0))), "as many rows"),
    (lambda: StockTube("x", 1e-3, 1e-3), "has no wall"),
    (lambda: Tolerances(curvature=0.5), "below 30 %"),
    (lambda: DesignTask(two_tubes(), FREE, ("snap_free",)), "requirements contains 'snap_free'"),  # type: ignore[arg-type]
    (lambda: DesignTask(two_tubes(), FREE, SnapFree()), "it must be a list of requirements"),  # type: ignore[arg-type]
    (lambda: DesignTask(two_tubes(), FREE, (), "length"), "it must be a list of Objective"),  # type: ignore[arg-type]
    (lambda: Free("curvature", 0, 1, 2), "it must be a list of tubes"),  # type: ignore[arg-type]
    (lambda: Free("curvature", (0, 0), 1, 2), "has tube 1 twice"),
    (lambda: SnapFree(0.1, box=((0.0, 0.0),)), "box of translations has 1 rows"),  # type: ignore[arg-type]
    (lambda: Strain(()), "limits of the strain is empty"),
    (lambda: Coverage((0, 0, 0), (1, 1, 1), samples=-1), "it must be at least 0"),
    (lambda: Objective("reach_radius", depth=float("nan")), "depth of the objective is nan"),
    (lambda: optimize_design(DesignTask(two_tubes(), FREE), seed=-1), "seed is -1; it must be at least 0"),
    (lambda: tolerance_analysis(two_tubes(), Tolerances(), translations=[[0.0]]), "it must be 2 numbers"),
    (lambda: pareto_front(DesignTask(two_tubes(), FREE, (SnapFree(),)), [0.1, 1.5]), "it must be less than 1"),
]


@pytest.mark.parametrize(("make", "words"), WRONG, ids=[words for _, words in WRONG])
def test_wrong_input(make: Callable[[], object], words: str) -> None:
    with pytest.raises(InputError) as caught:
        make()
    assert words in str(caught.value)


def test_no_starts_and_no_workers_are_refused() -> None:
    task = DesignTask(THESIS, (Free("curvature", (0,), 0.0, 20.0),), (SnapFree(0.05),))
    with pytest.raises(InputError, match="starts is 0"):
        optimize_design(task, starts=0)
    with pytest.raises(InputError, match="workers is 0"):
        optimize_design(task, workers=0)

"""Requirements on the real robot: answers are repeated with more reserve until it keeps them with a probability.

The bounds on the real robot are those of its posterior (`validation/certainty.py`). What an answer lacks is required of
the calibrated robot in addition, since both change alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import numpy as np

from ..bodies.obstacles import Scene, scene_of
from ..design import Avoid, Coverage, DesignSolution, DesignTask, Reach, SnapFree, SnapFreeInUse
from ..design.exchange import certified_at
from ..design.requirements import Requirement, of_kind
from ..design.verify import reached
from ..equilibrium.result import Equilibrium
from ..errors import SolveError
from ..robots.calibration import PathBounds
from ..robots.robot import Robot
from ..stability import snap_free_certificate
from ..typing import Array
from ..validation.certainty import certificate_bounds, path_bounds, tip_radii

# Margins and distances do not change in proportion. The real tip comes as much closer as the tolerance is smaller; with
# more, none would remain.
MORE, CLOSER, ROUNDS = 1.3, 1.02, 4
"""Factors on what is lacking, and on what a tip lacks; maximum number of answers for a confidence."""

MOST_MARGIN = 0.99
"""Largest margin that is required for the real robot's sake."""

T = TypeVar("T")


@dataclass(frozen=True)
class Reserve:
    """Reserve of the calibrated robot above the requirements on the real one, or a lack of it."""

    margin: float = 0.0
    certificate: float = 0.0
    clearance: float = 0.0
    """m."""
    tip: float = 0.0
    """Decrease of the tolerances of targets, m."""

    def increased(self, lack: Reserve) -> Reserve:
        """Reserve with more of what is lacking."""
        return Reserve(
            self.margin + MORE * max(0.0, lack.margin),
            self.certificate + MORE * max(0.0, lack.certificate),
            self.clearance + MORE * max(0.0, lack.clearance),
            self.tip + CLOSER * max(0.0, lack.tip),
        )


@dataclass(frozen=True)
class Judged(Generic[T]):
    """Answer with what the real robot lacks in it."""

    answer: T
    faults: Sequence[str]
    """Requirements that the real robot does not keep, as clauses; none if it keeps all."""
    lack: Reserve = Reserve()


def check_confidence(confidence: Any, robot: Robot) -> None:
    """Raise ValueError for a confidence with a robot without a posterior."""
    if confidence is not None and robot.posterior is None:
        raise ValueError("confidence is given, and the robot has no posterior; tubeopt validate --fit writes one")


def kept_by_real_robot(what: str, answer_with: Callable[[Reserve], Judged[T]]) -> T:
    """Answer that the real robot keeps, from answers to a reserve.

    Raises:
        SolveError: no answer was found that the real robot keeps, or none with enough reserve.
    """
    reserve, faults = Reserve(), ""
    for _ in range(ROUNDS):
        try:
            judged = answer_with(reserve)
        except SolveError as error:
            if not faults:
                raise
            raise SolveError(
                f"no {what} was found that the real robot keeps: {faults}; with more reserve {error}"
            ) from None
        if not judged.faults:
            return judged.answer
        faults, reserve = "; ".join(judged.faults), reserve.increased(judged.lack)
    raise SolveError(f"no {what} was found that the real robot keeps: {faults}", judged.answer)


# --- designs ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class DesignBounds:
    """Bounds on a real robot of a design, which deviates from its drawing as the calibrated one does from its file.

    They are estimated, not proved; each holds at its probability on its own.
    """

    probabilities: tuple[float, ...]
    """Probabilities (Q,) of the bounds."""
    certificate: Array | None
    """(Q,) certificates; None if none is required."""
    margin: Array | None
    """(Q,) margins at the task poses, and on paths that are required; None without task poses."""
    clearance: Array | None
    """(Q,) distances from bodies at the task poses, m; None without bodies."""
    tip: Array | None
    """(Q,) distances of the tip from that of the calibrated robot at every target, m; None without targets."""
    over: Array
    """(Q,) largest distance of the tip from a target beyond its tolerance, m; -inf without targets."""


def design_bounds(solution: DesignSolution, probabilities: Sequence[float]) -> DesignBounds | None:
    """Bounds on a real robot of a design at probabilities (Q,); None without a posterior."""
    robot, program, poses = solution.robot, solution.attempt.program, solution.equilibria
    requirements = solution.task.requirements
    if robot.posterior is None:
        return None
    rows = [np.array(row) for row in certified_at(program, robot)] if of_kind(requirements, SnapFree) else []
    known = [certificate_bounds(robot, snap_free_certificate, row, probabilities) for row in rows]
    certified = [each for each in known if each is not None]
    bodies = [body for each in of_kind(requirements, Avoid) for body in each.obstacles]
    paths = any(each.paths for each in of_kind(requirements, SnapFreeInUse))
    along = [
        _along(route, probabilities, scene_of(bodies) if bodies else None) for route in _routes(poses, together=paths)
    ]
    targets = list(reached(program, poses))
    wide = np.array([tip_radii(e, probabilities) for each in targets for e in each.poses])
    apart = np.array([d - limit for each in targets for d, limit in zip(each.distance, each.tolerance, strict=True)])
    return DesignBounds(
        tuple(probabilities),
        np.min(certified, axis=0) if certified else None,
        np.min([each.margin for each in along], axis=0) if along else None,
        np.min([each.clearance for each in along], axis=0) if along and bodies else None,
        wide.max(0) if targets else None,
        (apart[:, None] + wide).max(0) if targets else np.full(len(probabilities), -np.inf),
    )


def _routes(poses: Sequence[Equilibrium], *, together: bool) -> Iterable[Sequence[Equilibrium]]:
    """Task poses that the robot passes without a new start."""
    return [poses] if together and poses else [[pose] for pose in poses]


def _along(route: Sequence[Equilibrium], probabilities: Sequence[float], scene: Scene | None) -> PathBounds:
    """Bounds on the real robot at poses, and on the joint paths between them."""
    rotations, translations = (
        np.array(table) for table in ([e.rotations for e in route], [e.translations for e in route])
    )
    bounds = path_bounds(route[0], rotations, translations, scene, probabilities)
    assert bounds is not None
    return bounds


def judged_design(solution: DesignSolution, task: DesignTask, confidence: float) -> Judged[DesignSolution]:
    """Design with what its real robot lacks of the requirements of a task."""
    bounds = design_bounds(solution, (confidence,))
    assert bounds is not None
    shown, faults, lacks = f"with {100 * confidence:g} % the real robot has", list[str](), dict[str, float]()

    def require(name: str, value: Array | None, least: float, factor: float = 1.0, sign: str = "") -> None:
        if value is not None and value[0] < least:
            lacks[name] = least - float(value[0])
            numbers = (f"{factor * x:.4g}{sign}" for x in (float(value[0]), least))
            faults.append(f"{shown} a {name} of {next(numbers)}; it must be at least {next(numbers)}")

    for requirement in task.requirements:
        match requirement:
            case SnapFree():
                require("certificate", bounds.certificate, requirement.required_margin)
            case SnapFreeInUse(margin=least):
                require("margin", bounds.margin, least)
            case Avoid(clearance=least):
                require("clearance", bounds.clearance, least, 1e3, " mm")
    if (over := float(bounds.over[0])) > 0:
        lacks["tip"] = over
        faults.append(f"{shown} a tip {1e3 * over:.4g} mm beyond the tolerance of a target")
    return Judged(solution, faults, Reserve(**lacks))


def with_reserve(task: DesignTask, reserve: Reserve) -> DesignTask:
    """Task with more required of the calibrated robot.

    Raises:
        SolveError: no tolerance of a target remains.
    """

    def raised(each: Requirement) -> Requirement:
        match each:
            case SnapFree():
                return each.eased(-min(reserve.certificate, MOST_MARGIN - each.required_margin))
            case SnapFreeInUse(margin=margin):
                return replace(each, margin=min(margin + reserve.margin, MOST_MARGIN))
            case Avoid(clearance=clearance):
                return replace(each, clearance=clearance + reserve.clearance)
            case Reach(targets=targets):
                return replace(each, targets=tuple(replace(t, tolerance=left(t.tolerance)) for t in targets))
            case Coverage(tolerance=tolerance):
                return replace(each, tolerance=left(tolerance))
        return each

    def left(tolerance: float) -> float:
        if tolerance <= reserve.tip:
            raise SolveError(
                f"the tolerance of a target, {1e3 * tolerance:.4g} mm, leaves none for the calibrated robot: the real "
                "tip is not known as well"
            )
        return tolerance - reserve.tip

    if reserve == Reserve():
        return task
    return replace(task, requirements=tuple(raised(each) for each in task.requirements))

"""Studies of inverse kinematics, for one target or a table, and of the workspace."""

from __future__ import annotations

from dataclasses import dataclass, replace
from decimal import Decimal
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from ..display import Displayed
from ..errors import SolveError
from ..files.checked import Entry, Number, Positive, Triple, check, in_file, require_one
from ..files.csv_file import read_csv, refuse
from ..files.field_metadata import key
from ..files.fields import keys_from, values
from ..files.units import MM, RAD
from ..files.yaml_file import load_yaml
from ..inverse import IkSession, InverseOptions, InverseSolution, inverse_kinematics
from ..inverse.clock import Clock
from ..robots.limits import check_target
from ..robots.robot import Robot
from ..stability import ASSUMING, follow
from ..typing import Array, Progress
from ..workspaces import Findings, examine, workspace
from ..workspaces.loss import require_centred
from .robot_keys import DEFAULT_MARGIN, HOME, Loaded, MinMargin, OnePerTube, RobotPath, joints_of
from .study_file import Arguments, Options, Study, question
from .surroundings_file import Surrounded, TipPosition

# --- files of targets and of joint values -----------------------------------------------------------------------------

POSITION = ("x_mm", "y_mm", "z_mm")
DIRECTION = ("direction_x", "direction_y", "direction_z")


@dataclass(frozen=True, eq=False)
class Targets:
    """Targets of the tip, one per row."""

    position: Array
    """Positions (T, 3) of the targets, m."""
    direction: Array | None
    """(T, 3) target directions, any length."""
    path: str = ""
    """Path of the file, for messages."""


def load_targets(path: str | PathLike[str]) -> Targets:
    """Load targets from a CSV file with columns x_mm, y_mm, z_mm and optionally direction_x, direction_y, direction_z.

    Raises:
        InputError: no such file, an unknown or missing column, a cell that is no number, a direction of length 0; one
            line per problem.
    """
    table = read_csv(path, (*POSITION, *DIRECTION))
    has_direction = table.expect(POSITION, together=DIRECTION)
    position = table.numbers(POSITION, MM)
    direction = table.numbers(DIRECTION, RAD) if has_direction else None
    if direction is not None:
        # Any length is allowed, since only the direction counts, but 0 has none.
        for k in np.flatnonzero(~direction.any(1)):
            table.complain(int(k), DIRECTION[0], "is 0, as are the other two; a direction must have a length")
    table.check()
    return Targets(position, direction, str(path))


class JointsFile(Entry):
    """Configuration of a robot from a file."""

    rotations_deg: list[Number] = Field(description="rotation of every tube, inner to outer")
    translations_mm: list[Number] | None = Field(
        None, description=f"translation of every tube, inner to outer; default {HOME}"
    )


def load_joints(path: str | PathLike[str], robot: Robot) -> tuple[Array, Array]:
    """Load joint readings from a YAML file, as rotations (n,), rad, and translations (n,), m, of the model.

    Raises:
        InputError: no such file, not YAML, an unknown key, or not one number per tube.
    """
    joints = check(JointsFile, load_yaml(path), path)
    n = robot.n_tubes
    readings = {key: joints.si(key) for key in JointsFile.model_fields}
    problems = [
        f"{key} has {len(values)} numbers; it must be {n} (one per tube)"
        for key, values in readings.items()
        if values is not None and len(values) != n
    ]
    refuse(path, problems)
    return joints_of(robot, *readings.values())


# --- studies ----------------------------------------------------------------------------------------------------------

Joints = Annotated[
    tuple[Array, Array], in_file(load_joints, "a YAML file with rotations_deg, translations_mm", of="robot")
]


@dataclass(frozen=True, eq=False)
class Postures(Displayed):
    """Inverse solutions for one target."""

    robot: Robot
    """Robot of the solutions."""
    solutions: Annotated[tuple[InverseSolution, ...], "the solutions, best first"]
    timed_out: Annotated[bool, "true if the time limit ended the search for all solutions or for their paths"] = False


@dataclass(frozen=True, eq=False)
class Row:
    """Target of a table, with its solution."""

    number: Annotated[float, key("target"), "number of the target, from 1; a fraction for an inserted one"]
    """7.25 is inserted at a quarter of the distance from target 7 to target 8, by `follow`."""
    position: Annotated[Array, key("target_mm"), "target position of the tip in the base frame"]
    """Position (3,) of the target, m."""
    direction: Annotated[Array | None, key("target_direction"), "target direction of the tip"]
    """(3,) target direction, any length."""
    solution: InverseSolution | None
    """Solution, or the closest pose if that was requested."""
    problem: Annotated[str, "reason why there is no solution"]

    @property
    def inserted(self) -> bool:
        """True if the target is not in the table, but was inserted between two of its targets."""
        return self.number != int(self.number)


@dataclass(frozen=True, eq=False)
class TargetTable(Displayed):
    """Inverse solutions for a table of targets."""

    robot: Robot
    """Robot of the solutions."""
    rows: Annotated[tuple[Row, ...], key("solutions"), "the solutions, one per target"]
    followed: bool = False
    """True if each target was solved from the previous one, on the same branch."""


@keys_from(InverseOptions)
class InverseStudy(Surrounded, Loaded, Study):
    """Joint values that bring the tip to a target in a stable equilibrium, for one target or a table."""

    doing = "solving targets"
    assuming = f"Snap-free paths are valid {ASSUMING}."

    kind: Literal["inverse_kinematics"]
    robot: RobotPath
    target_mm: TipPosition | None = Field(
        None, description="target position of the tip in the base frame", examples=["X,Y,Z"]
    )
    direction: Triple | None = Field(
        None,
        description="direction of the tip in the base frame, any length; default any direction",
        examples=["X,Y,Z"],
    )
    targets: Annotated[Targets, in_file(load_targets, "a CSV file")] | None = Field(
        None,
        description="CSV file of targets with columns x_mm, y_mm, z_mm[, direction_x, ...], instead of one target",
        examples=["TARGETS.csv"],
    )
    start: Joints | None = Field(
        None,
        description="YAML file of the current joint values, with keys rotations_deg and translations_mm; "
        "default no start",
        examples=["JOINTS.yaml"],
    )
    reference_deg: OnePerTube | None = Field(
        None, description="rotations of the reference configuration; the nearest solution is preferred"
    )
    reference_mm: OnePerTube | None = Field(
        None, description="translations of the reference configuration; the nearest solution is preferred"
    )
    min_margin: MinMargin = DEFAULT_MARGIN
    time_limit_s: Positive = Field(Decimal(20), description="time limit per target, path search included")
    all: bool = Field(False, description="find all distinct configurations for the target, best first")
    closest: bool = Field(False, description="show the closest pose if the target is out of reach")
    follow: bool = Field(False, description="solve each target of a table from the previous one, on the same branch")
    reachable: bool = Field(True, description="search a snap-free path from the start (or home) to the solution")

    @field_validator("obstacles", mode="before")
    @classmethod
    def _no_obstacles(cls, value: object) -> object:
        """Empty list for a key without value."""
        return [] if value is None else value

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        require_one(self, "target_mm", "targets")
        if self.targets is not None and (self.direction is not None or self.all):
            raise ValueError("direction and all are for a single target, not for a table of targets")
        if self.follow and self.targets is None:
            raise ValueError("follow is for a table of targets")
        if self.follow and self.closest:
            raise ValueError(
                "closest and follow are both given; with follow, the path ends at a target that is out of reach"
            )
        directed = self.direction is not None or (self.targets is not None and self.targets.direction is not None)
        if self.si("direction_weight") is not None and not directed:
            raise ValueError("direction_weight is given without a direction")
        if self.si("objective") == "nearest" and self.start is None and self._reference() is None:
            raise ValueError("objective is nearest; it needs a start or a reference")
        if self.external_load is not None and (self.all or self.follow or self.closest):
            raise ValueError("all, follow and closest are for a robot without load")
        return self

    def _reference(self) -> tuple[Array, Array] | None:
        if self.reference_deg is None and self.reference_mm is None:
            return None
        return joints_of(self.robot, self.si("reference_deg"), self.si("reference_mm"))

    def _session_options(self) -> dict[str, Any]:
        """Arguments of `IkSession`, which `inverse_kinematics` has too."""
        return {
            "start": self.start,
            "min_margin": self.si("min_margin"),
            "obstacles": self.bodies,
            "options": InverseOptions(**values(InverseOptions, self), **self.in_si("time_limit_s")),
        }

    def _options(self) -> dict[str, Any]:
        """Keyword arguments of `inverse_kinematics`, except direction and load."""
        return self._session_options() | {
            "reference": self._reference(),
            "on_failure": "closest" if self.closest else "raise",
            "reachable": self.reachable and self.external_load is None,
        }

    def run(self, progress: Progress | None = None) -> Postures | TargetTable:
        """Solve the targets; raises SolveError if a single target has no solution and `closest` is false."""
        if self.targets is not None:
            return self._table(self.targets, progress)
        if self.target_mm is None:
            raise AssertionError("a study without a target is rejected at construction")
        position, direction, options = self.si("target_mm"), self.si("direction"), self._options()
        if self.all:
            # Started before the search: if it has run out, the list may be incomplete.
            clock = Clock(self.si("time_limit_s"))
            solutions = inverse_kinematics(self.robot, position, direction=direction, all_solutions=True, **options)
            return Postures(self.robot, tuple(solutions), clock.over)
        solution = inverse_kinematics(self.robot, position, direction=direction, load=self.external_load, **options)
        return Postures(self.robot, (solution,))

    def _table(self, targets: Targets, progress: Progress | None) -> TargetTable:
        check_target(self.robot.tubes, f"{targets.path}: {', '.join(POSITION)}", targets.position)
        rows: list[Row] = []
        # The session keeps its equilibrium: the next target is solved on the same branch.
        session = IkSession(self.robot, **self._session_options()) if self.follow else None
        for k, position in enumerate(targets.position):
            direction = None if targets.direction is None else targets.direction[k]
            try:
                if session is not None:
                    rows += _rows_to(session, k + 1, position, direction)
                else:
                    solution = inverse_kinematics(
                        self.robot, position, direction=direction, load=self.external_load, **self._options()
                    )
                    rows.append(Row(k + 1, position, direction, solution, ""))
            except SolveError as error:
                # One unreachable target does not end the table.
                rows.append(Row(k + 1, position, direction, None, str(error)))
            if progress is not None:
                progress(k + 1, len(targets.position))
        return TargetTable(self.robot, tuple(_with_snaps(self.robot, rows) if self.follow else rows), self.follow)


def _rows_to(session: IkSession, number: int, position: Array, direction: Array | None) -> list[Row]:
    """Rows of the next target and of the targets inserted before it, numbered by their fraction of the distance."""
    previous = session.solution
    solutions = session.solve_path(position, direction=direction)
    rows = []
    for k, solution in enumerate(solutions[:-1], start=1):
        fraction = k / len(solutions)  # on the path from the start to the first target
        if previous is not None:
            first, distance = previous.target_position, float(np.linalg.norm(position - previous.target_position))
            fraction = float(np.linalg.norm(solution.target_position - first)) / max(distance, 1e-300)
            # Inserted rows get numbers strictly between two targets, also if the tip does not move.
            fraction = min(max(fraction, 1e-4), 1 - 1e-4)
        target = round(number - 1 + fraction, 6)
        rows.append(Row(target, solution.target_position, solution.target_direction, solution, ""))
    rows.append(Row(number, position, direction, solutions[-1], ""))
    return rows


def _with_snaps(robot: Robot, rows: list[Row]) -> list[Row]:
    """Rows with the snaps between them, from following all solutions once more from the first to the last."""
    solved = [(k, row.solution) for k, row in enumerate(rows) if row.solution is not None]
    if len(solved) < 2:
        return rows
    # Each step was solved for itself. Following all of them in one run shows snaps between rows.
    solutions = [solution for _, solution in solved]
    path = follow(
        robot, [s.rotations for s in solutions], [s.translations for s in solutions], start=solutions[0].equilibrium
    )
    out = list(rows)
    for snap in path.snaps:
        k, solution = solved[snap.index + 1]
        sentence = f"the robot snaps {100 * snap.fraction:.3g} % of the path from the last row"
        jump = f"{solution.jump}, {sentence}" if solution.jump else sentence
        after_snap = replace(solution, jump=jump, reachable=None, path=None, straight_from_seed=False)
        out[k] = replace(rows[k], solution=after_snap)
    return out


# --- workspace --------------------------------------------------------------------------------------------------------


@question("solving", keeps="finished samples are in {out}; the same command continues")
def find_workspace(
    robot: RobotPath,
    sampling: Annotated[Options, Arguments(workspace, "samples", "method", "seed", "workers")],
    examined: Annotated[Options, Arguments(examine, "size", "min_margin", "loss")],
    out: Path | None = None,
    progress: Progress | None = None,
) -> Findings:
    """Tips at many joint values within a robot's limits.

    With `out`, samples are saved during the run, and an interrupted run continues.
    """
    if examined["loss"]:
        require_centred(robot)  # before the samples, which take minutes
    samples = workspace(robot, out=out, progress=progress, **sampling)
    return examine(samples, progress=progress, **examined)

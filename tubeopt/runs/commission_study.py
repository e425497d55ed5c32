"""Commissioning of a robot: all steps between logs of encoders and trackers and a servo.

Each step is that of another command; nothing is fitted twice. With a directory every finished step is kept there, and
the same command continues an interrupted run.
"""

from __future__ import annotations

import hashlib
import math
import pickle
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Annotated, TypeVar

from pydantic import AfterValidator, Field, ValidationInfo

from .. import __version__
from ..control.c_library import CLibrary, c_library
from ..control.command import ServoOptions
from ..display import Displayed
from ..errors import InputError, SolveError
from ..files.checked import Count, Positive
from ..files.field_metadata import form, unit
from ..files.files import atomic_write, read_bytes
from ..files.shipped import resolve_file
from ..robots.file import robot_to_dict
from ..robots.robot import Robot
from ..typing import Progress
from ..validation import (
    EFFECTS,
    Comparison,
    Fit,
    FitOptions,
    Placement,
    compare_effects,
    fit,
    servo_floor,
    where_to_measure,
)
from .log_file import ReadLog, paired, read_log
from .recorded_table import TIME
from .robot_keys import RobotPath
from .study_file import question, rewording
from .validation_study import KEYS

T = TypeVar("T")

# Snap distance (rad) that the real robot keeps: turns of drives that noise and vibration may cause.
KEPT = math.radians(1.0)

# Folds of the choice of effects.
FOLDS = 10


def _paths(names: list[str], info: ValidationInfo) -> list[str]:
    directory = info.context["directory"] if info.context else Path()
    return [str(resolve_file(name, directory)) for name in names]


LogPaths = Annotated[
    list[str],
    Field(
        min_length=1,
        description="logs, one for each recording, or two for positions and joints: CSV files, exports of trackers, or "
        "YAML files of kind measurements, relative to this file",
    ),
    AfterValidator(_paths),
]


def _answers(texts: list[str]) -> list[str]:
    for text in texts:
        about, value = (part.strip() for part in text.partition("=")[::2])
        kind, _, number = about.rpartition("_")
        directed = kind in ("rotation", "translation") and number.isdigit()
        units: dict[str, tuple[str, ...]] = {
            "rotations": ("deg", "rad"),
            "translations": ("mm", "m"),
            "positions": ("mm", "m"),
        }
        allowed = ("forward", "reversed") if directed else units.get(about, ())
        allowed = tuple(TIME) if about in ("time", "joint_time") else allowed
        if value not in allowed:
            raise ValueError(
                f"has {text!r}; it must be rotation_1=forward or =reversed, translation_1=forward or =reversed, "
                "rotations=deg or =rad, translations=mm or =m, positions=mm or =m, time=s, =ms, =us or =ns"
            )
    return texts


@dataclass(frozen=True, eq=False)
class Commissioning(Displayed):
    """Calibrated robot with all that was found on the way."""

    given: Robot
    """The robot as given."""
    logs: tuple[ReadLog, ...]
    """The recordings, and how they were read."""
    comparison: Annotated[Comparison, "the choice of effects"]
    """The choice of effects, with its held-out errors."""
    fit: Fit
    """The fit of the chosen effects; of the zeros where none was chosen."""
    placement: Placement | None
    """Configurations to measure next; None if none were found."""
    floor: Annotated[float | None, unit("deg"), form(".1f"), "smallest snap distance that the servo may allow"]
    """Snap distance, rad, with which the real robot keeps `KEPT`; None if there is none."""
    library: CLibrary = field(repr=False)
    """Servo of the calibrated robot in C, with this floor."""
    remarks: Annotated[tuple[str, ...], "remarks"] = ()

    @property
    def robot(self) -> Robot:
        """The calibrated robot."""
        return self.fit.robot


class _Stages:
    """Results of finished steps in a directory, which a later run of the same question reuses."""

    def __init__(self, out: Path | None, fingerprint: str) -> None:
        self.directory, self.fingerprint = None if out is None else out / "steps", fingerprint

    def __call__(self, name: str, step: Callable[[], T]) -> T:
        """Result of a step, computed unless it was before."""
        if self.directory is None:
            return step()
        path = self.directory / f"{name}.pickle"
        if path.exists():
            try:
                mark, result = pickle.loads(read_bytes(path))
            except (pickle.UnpicklingError, EOFError, AttributeError, ImportError, ValueError):
                mark, result = "", None
            if mark == self.fingerprint:
                return result  # type: ignore[no-any-return]
        result = step()
        self.directory.mkdir(parents=True, exist_ok=True)
        with atomic_write(path) as written:
            written.write_bytes(pickle.dumps((self.fingerprint, result)))
        return result


@question("commissioning", keeps="finished steps are in {out}/steps; the same command continues")
def commission(
    robot: RobotPath,
    logs: LogPaths,
    effects: Annotated[
        list[str],
        Field(
            description="effects to try, such as curvature or friction; default all that the data can determine and "
            "that are not slow",
            examples=["NAME,.."],
        ),
    ] = [],  # noqa: B006
    answer: Annotated[
        list[str],
        AfterValidator(_answers),
        Field(
            description="answers to questions about columns, as rotation_2=reversed or rotations=deg",
            examples=["COLUMN=WHAT,.."],
        ),
    ] = [],  # noqa: B006
    confidence: Annotated[Positive, Field(lt=1, gt=0.5, description="confidence of the servo's floor")] = Decimal(
        "0.999"
    ),
    count: Annotated[Count, Field(description="number of configurations to measure next")] = 20,
    progress: Progress | None = None,
    out: Path | None = None,
) -> Commissioning:
    """Calibrated robot from logs: columns, zeros, latency, effects, errors held out, what to measure next, a servo."""
    paths = [Path(name) for name in logs]
    answers = [(about.strip(), what.strip()) for about, _, what in (text.partition("=") for text in answer)]
    stages = _Stages(out, _fingerprint(robot, paths, effects, answer, str(confidence), str(count)))
    known = stages("columns", lambda: _read(robot, paths, answers, progress))
    recordings = [each.measurements for each in known]
    folds = min(FOLDS, *map(len, recordings)) if len(recordings) else FOLDS
    options = FitOptions(folds=folds)
    with rewording(KEYS):
        comparison = stages("effects", lambda: compare_effects(robot, recordings, effects, options, progress=progress))
        fitted = comparison.fit or stages("zeros", lambda: fit(robot, recordings, _zeros(robot), options))
    remarks = list[str]()
    placement = stages("next", lambda: _next(fitted, count, remarks))
    floor = stages("floor", lambda: _floor(fitted.robot, float(confidence), remarks))
    library = c_library(
        fitted.robot,
        name=robot.name or "robot",
        options=ServoOptions(min_snap_distance=floor),
    )
    return Commissioning(
        given=robot,
        logs=tuple(known),
        comparison=comparison,
        fit=fitted,
        placement=placement,
        floor=floor,
        library=library,
        remarks=tuple(remarks),
    )


def _fingerprint(robot: Robot, paths: Sequence[Path], *options: object) -> str:
    """Digest of all that the answer depends on."""
    files = [read_bytes(path) for path in paths]
    text = repr((__version__, robot_to_dict(robot), [str(path) for path in paths], options))
    return hashlib.sha256(b"\0".join([text.encode(), *files])).hexdigest()


def _read(
    robot: Robot, paths: Sequence[Path], answers: Sequence[tuple[str, str]], progress: Progress | None
) -> list[ReadLog]:
    """All recordings; raises InputError if two of them count in opposite directions."""
    known: list[ReadLog] = []
    for pair in paired(paths, robot):
        known += read_log(pair, robot, known, answers, progress)
    readings = [(each.name, each.detection.reading) for each in known if each.detection is not None]
    for name, reading in readings[1:]:
        first, expected = readings[0]
        for kind in ("rotation_signs", "translation_signs"):
            pairs = zip(getattr(reading, kind), getattr(expected, kind), strict=True)
            for i, (sign, other) in enumerate(pairs):
                if sign != other:
                    what = f"{kind.partition('_')[0]}_{i + 1}"
                    raise InputError(
                        f"{what} counts in opposite directions in {first} and {name}: {_way(other)} and {_way(sign)}. "
                        f"Answer by --answer {what}={_way(other)} or --answer {what}={_way(sign)}"
                    )
    return known


def _way(sign: int) -> str:
    return "forward" if sign > 0 else "reversed"


def _floor(robot: Robot, confidence: float, remarks: list[str]) -> float | None:
    """Snap distance that the servo must keep, rad, so that the real robot keeps `KEPT`."""
    try:
        return servo_floor(robot, KEPT, confidence=confidence)
    except (InputError, SolveError) as error:
        remarks.append(f"the servo has no floor for the real robot: {error}")
        return None


def _zeros(robot: Robot) -> list[str]:
    """Parameters of the zeros of all drives; that of the first rotation is part of the registration."""
    return ["translation_all", *(f"rotation_{i + 1}" for i in range(1, robot.n_tubes))]


def _next(fitted: Fit, count: int, remarks: list[str]) -> Placement | None:
    """Configurations that determine the fitted parameters best; those of history need a path, not configurations."""
    names = list(dict.fromkeys(e.name.partition("@")[0] for e in fitted.estimates if not e.held))
    static = [name for name in names if not EFFECTS[_kind(name)].history]
    try:
        return where_to_measure(fitted.robot, static or _zeros(fitted.robot), count)
    except (InputError, SolveError) as error:
        remarks.append(f"configurations to measure next were not found: {error}")
        return None


def _kind(name: str) -> str:
    """Kind of a parameter: the longest known beginning of its name."""
    return max((kind for kind in EFFECTS if name == kind or name.startswith(f"{kind}_")), key=len)

"""Studies as YAML: a question about a robot, with everything that it takes to answer it.

A new kind of study is a function and a row of `STUDY_KINDS`. Its keys are the parameters of the function:

    @question("mapping the margin")
    def map_stability(
        robot: RobotPath,
        translations: Translations,
        options: Annotated[Options, Arguments(stability_map, "samples", "directions", "workers")],
    ) -> RobotMap:
        \"\"\"The margin and the snap boundary over two rotations.\"\"\"

A study whose keys must fit together, such as a plan, is a subclass of `Study` with its own keys, checks and `run`.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import re
from collections import UserDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from decimal import Decimal
from operator import attrgetter
from os import PathLike
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

from pydantic import Field, create_model

from ..arguments import typed
from ..errors import InputError
from ..files.checked import Entry, Positive, check_kind
from ..files.fields import keys_of, values
from ..files.shipped import found
from ..files.yaml_file import load_yaml
from ..solvers.time_limit import LONG_TIME_LIMIT, LateError, late_error, within
from ..typing import Progress


class Study(Entry):
    """What all kinds of study have in common."""

    doing: ClassVar[str] = "running the study"
    """What is told while its answer is computed."""

    keeps: ClassVar[str] = ""
    """What `run_in` has saved into {out} where it is interrupted."""

    either: ClassVar[tuple[frozenset[str], ...]] = ()
    """Sets of keys of which a study has one: a flag in one of them stands for the keys of the others too."""

    assuming: ClassVar[str] = ""
    """A sentence on what its answer is said under."""

    kind: str

    def run(self, progress: Progress | None = None) -> Any:
        """The answer to the question that the study asks; a kind of study has this or `run_in` of its own."""
        return self.run_in(None, progress)

    def ask(self, out: Path | None, progress: Progress | None = None) -> Any:
        """The answer of a command."""
        return self.run_in(out, progress)

    def run_in(self, out: Path | None, progress: Progress | None = None) -> Any:
        """The answer, as `run` gives it; what can be kept of it on the way is kept in `out`, to go on from there."""
        if progress is not None and getattr(self, "workers", 1) == 1:  # a bar is a thread: processes come first
            progress(0, 0)
        return self.run(progress)


class Timed(Study):
    """A study whose answer takes long: its time limit."""

    time_limit_s: Positive = Field(Decimal(int(LONG_TIME_LIMIT)), description="time limit of the command")

    def ask(self, out: Path | None, progress: Progress | None = None) -> Any:
        """The answer, as `run_in` gives it, within the time limit.

        Raises:
            TimeLimitError: it is reached before there is an answer.
        """
        # The limit covers everything: solvers inside check the same clock.
        limit = self.si("time_limit_s")
        try:
            with within(limit):
                return self.run_in(out, progress)
        except LateError as late:
            # The best result by then is kept in the error, and saved by the command.
            raise late_error(self.kind, limit, late.best) from None


@dataclass(frozen=True)
class Keys:
    """Mark of a parameter of a question that several keys make: those of an entry, of which it is an attribute."""

    entry: type[Entry]
    attribute: str

    def of(self, study: Any) -> Any:
        """The argument."""
        return getattr(study, self.attribute)


class Arguments:
    """Mark of a parameter of a question: arguments of a function of the library, each of which is a key.

    Name, unit, range, default and help of the key are those of the function's parameter.
    """

    def __init__(self, function: Callable[..., Any], *names: str) -> None:
        self.function, self.names = function, names

    def of(self, study: Any) -> dict[str, Any]:
        """The arguments by name, SI."""
        return values(self.function, study, *self.names)


Options = dict[str, Any]
"""Type of a parameter with the mark `Arguments`."""

PASSED_BY_COMMAND = ("progress", "out")
"""Parameters of a question that are no keys."""


@dataclass(frozen=True)
class Question:
    """A function whose parameters are the keys of a study: what `question` makes of it."""

    function: Callable[..., Any]
    doing: str
    timed: bool
    assuming: str
    keeps: str

    def study(self, kind: str) -> type[Study]:
        """The model of a study of this kind; its name is that of the kind."""
        # The order of the parameters is that of the flags in the help, and of the keys in docs/files.md.
        keys: dict[str, Any] = {"kind": (Literal[kind], ...)}
        bases, readers = list[type[Entry]](), dict[str, Callable[[Any], Any]]()
        parts = inspect.signature(self.function, eval_str=True).parameters
        for name, part in parts.items():
            mark = next(
                (m for m in getattr(part.annotation, "__metadata__", ()) if isinstance(m, Keys | Arguments)), None
            )
            if name in PASSED_BY_COMMAND:
                continue
            if isinstance(mark, Keys):
                bases.append(mark.entry)
            elif isinstance(mark, Arguments):
                keys |= keys_of(mark.function, mark.names)
            else:
                keys[name] = (part.annotation, ... if part.default is part.empty else part.default)
            readers[name] = attrgetter(name) if mark is None else mark.of
        # The name of the model is its heading in docs/files.md, and links there must not change with the function.
        title = "".join(map(str.title, kind.split("_"))) + "Study"
        document = (self.function.__doc__ or "").partition("\n\n")[0]
        base: tuple[type[Entry], ...] = (*bases, Answered, Timed if self.timed else Study)
        model: Any = create_model(title, __base__=base, __doc__=document, **keys)
        model.doing, model.assuming, model.keeps = self.doing, self.assuming, self.keeps
        model.function, model.readers = staticmethod(self.function), readers
        model.by_command = tuple(name for name in PASSED_BY_COMMAND if name in parts)
        return model  # type: ignore[no-any-return]


class Answered(Study):
    """A study that a function answers."""

    function: ClassVar[Callable[..., Any]]
    readers: ClassVar[Mapping[str, Callable[[Any], Any]]]
    """Parameters of the function -> their values in a study."""
    by_command: ClassVar[tuple[str, ...]]
    """Further parameters."""

    def run(self, progress: Progress | None = None) -> Any:
        """The answer."""
        return self._answer(None, progress)

    def run_in(self, out: Path | None, progress: Progress | None = None) -> Any:
        """The answer; a function that saves parts of it takes `out`."""
        return self._answer(out, progress) if "out" in self.by_command else super().run_in(out, progress)

    def _answer(self, out: Path | None, progress: Progress | None) -> Any:
        further = {"progress": progress, "out": out}
        arguments = {name: read(self) for name, read in self.readers.items()}
        return type(self).function(**arguments, **{name: further[name] for name in self.by_command})


def question(
    doing: str, *, timed: bool = True, assuming: str = "", keeps: str = ""
) -> Callable[[Callable[..., Any]], Question]:
    """Make a kind of study of a function; `doing`, `assuming` and `keeps` are those of `Study`.

    A parameter is a key of its name, or has the mark `Keys` or `Arguments`. The first paragraph of the docstring
    describes the study. With `timed` there is the key time_limit_s.
    """
    return lambda function: Question(function, doing, timed, assuming, keeps)


class Kinds(UserDict[str, Any]):
    """Kinds of a file -> the entry that reads it, from "module.name" of this package: imported when it is needed."""

    def __getitem__(self, kind: str) -> Any:
        # A command imports only the study that it asks: start-up is faster.
        module, name = self.data[kind].split(".")
        found = getattr(importlib.import_module(f".{module}", __package__), name)
        return _study(found, kind) if isinstance(found, Question) else found


@functools.lru_cache(maxsize=256)
def _study(asked: Question, kind: str) -> type[Study]:
    return asked.study(kind)


@contextmanager
def reworded(words: Mapping[str, str]) -> Iterator[None]:
    """Say an InputError of the library in the words of a study: pattern -> what replaces it.

    A function names its arguments, and a user knows keys: `{r"^max_force\b": "max_tip_force_mN"}`.
    """
    try:
        yield
    except InputError as error:
        text = str(error)
        for pattern, replacement in words.items():
            text = re.sub(pattern, replacement, text)
        # Without a match the original error keeps its traceback.
        if text == str(error):
            raise
        raise InputError(text) from None


STUDY_KINDS = Kinds(
    {
        "forward_kinematics": "forward_study.solve_shape",
        "inverse_kinematics": "inverse_study.InverseStudy",
        "equilibria": "stability_studies.equilibria",
        "snap": "stability_studies.SnapStudy",
        "follow": "stability_studies.follow_path",
        "load_limit": "stability_studies.LoadLimitStudy",
        "force": "validation_study.estimate_tip_forces",
        "certify": "stability_studies.CertifyStudy",
        "stability_map": "stability_studies.map_stability",
        "validation": "validation_study.ValidationStudy",
        "measure": "validation_study.choose_configurations",
        "design": "design_study.DesignStudy",
        "design_pair": "design_study.PairStudy",
        "plan": "plan_study.PlanStudy",
        "plan_arms": "plan_study.ArmsStudy",
        "verify": "plan_study.VerifyStudy",
        "workspace": "inverse_study.find_workspace",
        "heating": "heating_study.HeatingStudy",
        "led_heating": "heating_study.LedHeatingStudy",
        "heating_run": "heating_run.HeatingRunStudy",
        "heating_calibration": "heating_study.HeatingCalibrationStudy",
        "mold_plan": "mold_study.MoldStudy",
        "mandrel": "mold_study.mandrel",
        "mold_materials": "mold_study.MaterialsStudy",
        "mold_calibration": "mold_study.calibrate_mold",
        "fabrication": "heating_study.FabricationStudy",
    }
)
"""What the key `kind` of a study file may say."""


@typed
def load_study(path: str | PathLike[str]) -> Study:
    """The study in a YAML file, or of this name, its robot loaded; call its `run` for the answer.

    Raises:
        InputError: no such file or name, not YAML, or keys or values that make no study: one line for every problem.

    Examples:
        >>> import tubeopt
        >>> snap = tubeopt.load_study("thesis_snap").run().snap
        >>> round(snap.fraction, 6)
        0.595062
    """
    path = found(path, "studies")
    data = load_yaml(path)
    # A sweep has points, not one answer: it runs by its own command.
    if data.get("kind") == "sweep":
        raise InputError(f"{path}: kind is 'sweep'; use `tubeopt sweep`")
    return cast(Study, check_kind(STUDY_KINDS, data, path))

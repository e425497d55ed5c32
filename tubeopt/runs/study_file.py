"""Studies as YAML: a question about a robot, with all its inputs.

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
from ..files.shipped import find_file
from ..files.yaml_file import load_yaml
from ..solvers.time_limit import LONG_TIME_LIMIT, OutOfTimeError, time_limit_error, within
from ..typing import Progress


class Study(Entry):
    """Base of all kinds of study."""

    doing: ClassVar[str] = "running the study"
    """Label of the progress bar."""

    keeps: ClassVar[str] = ""
    """Message on interruption: results that `run_in` has saved in {out}."""

    either: ClassVar[tuple[frozenset[str], ...]] = ()
    """Alternative sets of keys: a flag of one set replaces the keys of the other sets in a study file."""

    assuming: ClassVar[str] = ""
    """Sentence on the assumptions of the answer, for the help."""

    kind: str

    def run(self, progress: Progress | None = None) -> Any:
        """Answer of the study. A kind of study overrides this or `run_in`."""
        return self.run_in(None, progress)

    def ask(self, out: Path | None, progress: Progress | None = None) -> Any:
        """Answer for a command."""
        return self.run_in(out, progress)

    def run_in(self, out: Path | None, progress: Progress | None = None) -> Any:
        """Answer of `run`. Intermediate results are saved in `out`, and a later run continues from them."""
        # The bar is a thread, and processes must be forked before it starts.
        if progress is not None and getattr(self, "workers", 1) == 1:
            progress(0, 0)
        return self.run(progress)


class Timed(Study):
    """Study with a time limit."""

    time_limit_s: Positive = Field(Decimal(int(LONG_TIME_LIMIT)), description="time limit of the command")

    def ask(self, out: Path | None, progress: Progress | None = None) -> Any:
        """Answer of `run_in` within the time limit.

        Raises:
            TimeLimitError: it is reached before there is an answer.
        """
        # The limit covers everything: solvers inside check the same clock.
        limit = self.si("time_limit_s")
        try:
            with within(limit):
                return self.run_in(out, progress)
        except OutOfTimeError as error:
            # The best result by then is kept in the error, and saved by the command.
            raise time_limit_error(self.kind, limit, error.best) from None


@dataclass(frozen=True)
class Keys:
    """Mark of a parameter that is read from an attribute of an entry; the keys of the entry become keys
    of the study.
    """

    entry: type[Entry]
    attribute: str

    def read(self, study: Any) -> Any:
        """Value of the argument in a study."""
        return getattr(study, self.attribute)


class Arguments:
    """Mark of a parameter that collects arguments of a library function; each of them becomes a key.

    Name, unit, range, default and help of the key are those of the function's parameter.
    """

    def __init__(self, function: Callable[..., Any], *names: str) -> None:
        self.function, self.names = function, names

    def read(self, study: Any) -> dict[str, Any]:
        """Arguments by name, SI."""
        return values(self.function, study, *self.names)


Options = dict[str, Any]
"""Type of a parameter with the mark `Arguments`."""

PASSED_BY_COMMAND = ("progress", "out")
"""Parameters of a question that the command sets; they are no keys."""


@dataclass(frozen=True)
class Question:
    """Function with the keys of a study as parameters, as returned by `question`."""

    function: Callable[..., Any]
    doing: str
    timed: bool
    assuming: str
    keeps: str

    def study(self, kind: str) -> type[Study]:
        """Model of a study of this kind, named after the kind."""
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
            readers[name] = attrgetter(name) if mark is None else mark.read
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
    """Study that is answered by a function."""

    function: ClassVar[Callable[..., Any]]
    readers: ClassVar[Mapping[str, Callable[[Any], Any]]]
    """Readers of the parameters: name -> function that reads the value from a study."""
    by_command: ClassVar[tuple[str, ...]]
    """Parameters from `PASSED_BY_COMMAND` that the function takes."""

    def run(self, progress: Progress | None = None) -> Any:
        """Return value of the function; nothing is saved."""
        return self._answer(None, progress)

    def run_in(self, out: Path | None, progress: Progress | None = None) -> Any:
        """Return value of the function, which saves intermediate results if it has a parameter `out`."""
        return self._answer(out, progress) if "out" in self.by_command else super().run_in(out, progress)

    def _answer(self, out: Path | None, progress: Progress | None) -> Any:
        further = {"progress": progress, "out": out}
        arguments = {name: read(self) for name, read in self.readers.items()}
        return type(self).function(**arguments, **{name: further[name] for name in self.by_command})


def question(
    doing: str, *, timed: bool = True, assuming: str = "", keeps: str = ""
) -> Callable[[Callable[..., Any]], Question]:
    """Decorate a function as a kind of study; `doing`, `assuming` and `keeps` are those of `Study`.

    A parameter is a key of its name, or has the mark `Keys` or `Arguments`. The first paragraph of the docstring
    describes the study. With `timed` there is the key time_limit_s.
    """
    return lambda function: Question(function, doing, timed, assuming, keeps)


class Kinds(UserDict[str, Any]):
    """Kinds of a file -> the model that reads it, as "module.name" of this package, imported on first use."""

    def __getitem__(self, kind: str) -> Any:
        # A command imports only its own study: start-up is faster.
        module, name = self.data[kind].split(".")
        study = getattr(importlib.import_module(f".{module}", __package__), name)
        return _study(study, kind) if isinstance(study, Question) else study


@functools.lru_cache(maxsize=256)
def _study(question: Question, kind: str) -> type[Study]:
    return question.study(kind)


@contextmanager
def rewording(replacements: Mapping[str, str]) -> Iterator[None]:
    """Replace names of arguments in an InputError of the library by keys of the study: pattern -> replacement.

    Example: `{r"^max_force\b": "max_tip_force_mN"}`.
    """
    try:
        yield
    except InputError as error:
        text = str(error)
        for pattern, replacement in replacements.items():
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
        "drives": "drives_study.DrivesStudy",
        "fatigue": "drives_study.size_fatigue",
        "load_limit": "stability_studies.LoadLimitStudy",
        "force": "validation_study.estimate_tip_forces",
        "certify": "stability_studies.CertifyStudy",
        "stability_map": "stability_studies.map_stability",
        "validation": "validation_study.ValidationStudy",
        "measure": "validation_study.choose_configurations",
        "commission": "commission_study.commission",
        "design": "design_study.DesignStudy",
        "design_pair": "design_study.PairStudy",
        "plan": "plan_study.PlanStudy",
        "plan_arms": "plan_study.ArmsStudy",
        "deploy": "plan_study.deploy_tip",
        "verify": "plan_study.VerifyStudy",
        "workspace": "inverse_study.find_workspace",
        "oven": "heating_study.plan_soak",
        "heating": "heating_study.HeatingStudy",
        "led_heating": "heating_study.ClosedLoopStudy",
        "heating_run": "heating_run.HeatingRunStudy",
        "heating_calibration": "heating_study.HeatingCalibrationStudy",
        "mold_plan": "mold_study.MoldStudy",
        "mandrel": "mold_study.mandrel",
        "mold_materials": "mold_study.MaterialsStudy",
        "mold_calibration": "mold_study.calibrate_mold",
        "tube_photo": "mold_study.measure_photo",
        "fabrication": "heating_study.FabricationStudy",
    }
)
"""Kinds of study files."""


@typed
def load_study(path: str | PathLike[str]) -> Study:
    """Load a study by path or built-in name, with its robot. Its method `run` returns the answer.

    Raises:
        InputError: no such file or name, not YAML, or invalid keys or values; one line per problem.

    Examples:
        >>> import tubeopt
        >>> snap = tubeopt.load_study("thesis_snap").run().snap
        >>> round(snap.fraction, 6)
        0.595062
    """
    path = find_file(path, "studies")
    data = load_yaml(path)
    # A sweep has points, not one answer: it runs by its own command.
    if data.get("kind") == "sweep":
        raise InputError(f"{path}: kind is 'sweep'; use `tubeopt sweep`")
    return cast(Study, check_kind(STUDY_KINDS, data, path))

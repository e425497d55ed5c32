"""Reports of commands about the installation, files, the C library, servers and pictures for papers."""

from __future__ import annotations

import os
import platform
import re
import time
from dataclasses import dataclass
from importlib import metadata, util
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich.console import RenderableType

from .. import __version__
from ..control.c_library import CLibrary
from ..display import Displayed
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.verification import verify_equilibrium
from ..errors import SolveError
from ..files.csv_file import to_csv
from ..files.field_metadata import key, unit
from ..files.files import write_text
from ..files.shipped import FOLDER as SHIPPED_FOLDER
from ..files.shipped import description_of, shipped
from ..files.units import TO_MM
from ..files.yaml_file import load_yaml
from ..robots.concentric import ConcentricRobot
from ..robots.file import robot_from_dict
from ..robots.robot import Robot
from ..robots.tubes import Tube
from ..runs.templates import WrittenFile
from ..solvers.compiled.library import cache_directory, library
from ..solvers.compiled.packaged import FOLDER
from .page import HEADINGS
from .quantities import Quantity, described, line, of_field
from .report import Report, file_name

LIBRARIES = ("casadi", "numpy", "scipy", "matplotlib")

EXTRAS = {
    "planning": ("ompl", "trimesh", "rtree", "manifold3d"),
    "fabrication": ("ezdxf", "trimesh", "manifold3d"),
    "view": ("viser", "trimesh", "manifold3d"),
    "anatomy": ("nibabel", "nrrd", "trimesh", "manifold3d"),
    "control": ("websockets", "pyigtl"),
    "cluster": ("dask", "distributed"),
    "data": ("pandas", "pyarrow", "xarray"),
    "gym": ("gymnasium",),
    "notebook": ("ipykernel", "plotly"),
    "rig": ("serial",),
}
"""Extra of the package -> modules that it installs."""

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

TOLERANCE = 1e-9
"""Largest difference of the tip from an adaptive re-integration of the equations, m."""


@dataclass(frozen=True)
class Doctor:
    """Installation and its self-test: a robot solved, and integrated again by another method."""

    versions: Annotated[dict[str, str], "versions of Python and of the packages"]
    system: Annotated[str, "system"]
    kernel: Annotated[str, "compiled kernel"]
    threads: Annotated[dict[str, str], "environment variables that set the number of threads"]
    cache: Path
    cache_bytes: Annotated[int, "size of the cache, bytes"]
    missing: dict[str, tuple[str, ...]]
    """Extra -> modules that it lacks."""
    difference: Annotated[float, unit("mm"), "difference of the tip from re-integration"]
    solve: Annotated[float, unit("us"), "time of one solve of two tubes, microseconds"]
    passed: Annotated[bool, "true if the self-test passed"]


def _extras_text(a: Doctor) -> str:
    """Installed extras, and the functions that missing extras would add."""
    installed = ", ".join(name for name, lacks in a.missing.items() if not lacks)
    absent = (
        f"{name} lacks {', '.join(lacks)} (pip install 'tubeopt[{name}]')" for name, lacks in a.missing.items() if lacks
    )
    return "; ".join([f"installed: {installed or 'none'}", *absent])


def _self_test_text(a: Doctor) -> str:
    """Result of the self-test, as text."""
    verdict = "passed" if a.passed else "FAILED"
    return f"{verdict}: off by {a.difference * TO_MM:.0e} mm from a re-integration; {a.solve * 1e6:.0f} us a solve"


DOCTOR = described(
    Doctor,
    of_field(Doctor, "versions", label="versions",
             text=lambda a: ", ".join(f"{name} {v}" for name, v in a.versions.items())),
    of_field(Doctor, "system", text="{system}"),
    of_field(Doctor, "kernel", text="{kernel}"),
    of_field(Doctor, "threads", label="threads", text=lambda a: ", ".join(f"{k}={v}" for k, v in a.threads.items())
             or "as the libraries choose, one for small problems"),
    Quantity("cache", "folder of the cache", lambda a: str(a.cache),
             text=lambda a: f"{a.cache}, {a.cache_bytes / 1e6:.1f} MB", label="cache"),
    "cache_bytes",
    Quantity("missing", "missing packages of each extra",
             lambda a: {name: list(lacks) for name, lacks in a.missing.items()}, label="extras", text=_extras_text),
    "passed difference solve",
    line("self-test", _self_test_text),
)  # fmt: skip


class DoctorReport(Report[Doctor]):
    command = "doctor"
    quantities = DOCTOR
    file = "doctor.json"

    def title(self) -> str:
        return f"tubeopt {__version__}"

    def conclude(self) -> None:
        """Raise SolveError if the self-test failed."""
        if not self.answer.passed:
            off = self.answer.difference
            raise SolveError(f"the self-test failed: re-integration moves the tip by {off:.1e} m")


def examine() -> Doctor:
    """Report on the running installation, with a self-test."""
    cache = cache_directory()
    difference, solve = _self_test()
    files = [path for path in cache.rglob("*") if path.is_file()] if cache.exists() else []
    return Doctor(
        versions={"tubeopt": __version__} | {name: metadata.version(name) for name in LIBRARIES},
        system=f"Python {platform.python_version()}, {platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        kernel=_kernel(),
        threads={name: os.environ[name] for name in THREADS if name in os.environ},
        cache=cache,
        cache_bytes=sum(path.stat().st_size for path in files),
        missing={extra: tuple(n for n in names if util.find_spec(n) is None) for extra, names in EXTRAS.items()},
        difference=difference,
        solve=solve,
        passed=difference < TOLERANCE,
    )


def _kernel() -> str:
    """Origin of the compiled kernel, as text."""
    if os.environ.get("TUBEOPT_COMPILE") == "0":
        return "switched off by TUBEOPT_COMPILE=0"
    compiled = library(2, False)
    if compiled is None:
        return "none: the package brings none, and no C compiler made one"
    return f"of the package, {compiled.path.name}" if compiled.path.parent == FOLDER else "compiled on this machine"


def _self_test() -> tuple[float, float]:
    """Two tubes at a right angle, collocated and solved, then integrated by DOP853: difference (m), time (s)."""
    # Outer and inner diameter, straight and curved length (m), curvature (1/m).
    tubes = (Tube(1.2e-3, 1.0e-3, 0.05, 0.1, 10.0), Tube(1.8e-3, 1.4e-3, 0.05, 0.08, 12.0))
    robot, rotations = ConcentricRobot(tubes), np.array([np.pi / 2, 0.0])
    checked = verify_equilibrium(forward_kinematics(robot, rotations)).verification
    # Without a verification the self-test has not passed.
    difference = np.inf if checked is None else checked.tip_position
    seconds = []
    # The least of many: other processes can only make a solve longer.
    for _ in range(50):
        start = time.perf_counter()
        forward_kinematics(robot, rotations)
        seconds.append(time.perf_counter() - start)
    return difference, min(seconds)


@dataclass(frozen=True)
class ShippedFile(Displayed):
    """Built-in file."""

    name: Annotated[str, "name for commands"]

    folder: Annotated[str, "folder: robots, rigs, studies, ..."]

    kind: Annotated[str | None, "its key `kind`; null without one"]

    n_tubes: Annotated[int | None, key("tubes"), "number of tubes of a robot"]

    about: Annotated[str, "description"]


@dataclass(frozen=True)
class ShippedFiles(Displayed):
    """Built-in files of one folder, or all."""

    files: tuple[ShippedFile, ...]
    """Files, sorted by folder and name."""


def shipped_folders() -> tuple[str, ...]:
    """Names of the folders of built-in files."""
    return tuple(sorted({path.parent.name for path in shipped().values()}))


def shipped_files(folder: str = "*") -> ShippedFiles:
    """Built-in files of a folder; of all folders by default."""
    listed = sorted(shipped(folder).values(), key=lambda path: path.relative_to(SHIPPED_FOLDER))
    return ShippedFiles(tuple(map(_described, listed)))


def _described(path: Path) -> ShippedFile:
    """Name, kind and description of a built-in file."""
    folder = path.parent.name
    data = load_yaml(path) if path.suffix == ".yaml" else {}
    n_tubes = robot_from_dict(data, path).n_tubes if folder == "robots" else None
    return ShippedFile(path.stem, folder, data.get("kind"), n_tubes, description_of(path))


FILE = described(ShippedFile)


class ShippedReport(Report[ShippedFiles]):
    command = "list"
    quantities = (Quantity("shipped", "the files", lambda a: a.files, of=FILE),)
    file = "shipped.json"

    def table(self) -> str:
        """Table with a line per file, not wrapped, for search; robots have their number of tubes in place of the
        folder.
        """
        files = self.answer.files
        if {file.folder for file in files} == {"robots"}:
            rows = [("name", "kind", "tubes"), *((f.name, f.kind or "", str(f.n_tubes)) for f in files)]
        else:
            rows = [("name", "folder", "kind"), *((f.name, f.folder, f.kind or "") for f in files)]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        descriptions = ["", *(f.about[:1].upper() + f.about[1:] for f in files)]
        described_rows = zip(rows, descriptions, strict=True)
        lines = ("  ".join([*map(str.ljust, row, widths), about]) for row, about in described_rows)
        return "\n".join(line.rstrip() for line in lines)


class WrittenReport(Report[WrittenFile]):
    command = "init"
    quantities = (Quantity("then", "command that uses the file", text="{then}", label="next"),)

    def title(self) -> str:
        return ""


LIBRARY = described(
    CLibrary,
    "name",
    Quantity("tubes", "number of tubes", lambda a: a.robot.n_tubes),
    "prefix",
    Quantity("sources", "files of the library", lambda a: list(a.files), label="files",
             text=lambda a: ", ".join(a.files)),
    Quantity("lines", "lines of C", lambda a: sum(
        text.count("\n") for file, text in a.files.items() if file.endswith((".c", ".h")))),
)  # fmt: skip


class CLibraryReport(Report[CLibrary]):
    command = "export"
    quantities = LIBRARY
    file = "library.json"

    def title(self) -> str:
        return f"{self.answer.name} in C"


@dataclass(frozen=True)
class Viewed(Displayed):
    """A robot in the browser."""

    robot: Robot
    """Robot that the page shows first."""

    url: str
    """Address of its page."""

    name: str
    """Name of the robot in texts."""


@dataclass(frozen=True)
class Served(Viewed):
    """A robot over WebSocket."""

    token: str
    """Token that clients must send."""


VIEWED: tuple[Quantity[Viewed], ...] = (
    Quantity("url", "address of the page"),
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
)

SERVED: tuple[Quantity[Served], ...] = (
    Quantity("url", "address of the server"),
    Quantity("token", "token for clients"),
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
)


class ViewedReport(Report[Viewed]):
    command = "view"
    quantities = VIEWED

    def table(self) -> str:
        return f"showing {self.answer.name} at {self.answer.url}   (Ctrl-C to stop)"


class ServedReport(Report[Served]):
    command = "serve"
    quantities = SERVED

    def table(self) -> str:
        answer = self.answer
        return f"serving {answer.name} at {answer.url}, token {answer.token}   (Ctrl-C to stop)"


# --- pictures for papers ---------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Journal:
    """Requirements of a publisher for pictures."""

    width_mm: int
    """Width of one column."""
    format: str
    fonts: tuple[str, ...]
    """Font families in order of preference."""


JOURNALS = {
    "ieee": Journal(88, "pdf", ("Helvetica", "Arial", "Liberation Sans", "Nimbus Sans")),
    "elsevier": Journal(90, "pdf", ("Arial", "Helvetica", "Liberation Sans", "Nimbus Sans")),
    "springer": Journal(84, "tiff", ("Helvetica", "Arial", "Liberation Sans", "Nimbus Sans")),
    "sage": Journal(88, "tiff", ("Arial", "Helvetica", "Liberation Sans", "Nimbus Sans")),
}
"""Name on the command line -> requirements of its publisher."""


@dataclass(frozen=True)
class Figures(Displayed):
    """Result with pictures for a paper."""

    shown: Report[Any]
    """Report on the result."""
    command: str
    """Command line that made the pictures."""


class FigureReport(Report[Figures]):
    """Report of a study for a paper, with a caption and data for each picture."""

    def record(self) -> dict[str, Any]:
        return self.answer.shown.record()

    def table(self) -> RenderableType:
        return self.answer.shown.table()

    def save(self, directory: Path) -> list[Path]:
        """Write the files of the study's command, the centrelines of its arms (CSV), and command.txt."""
        from .plots.style import families

        paths = self.answer.shown.save(directory)
        for name, arm in self.answer.shown.solids().items():
            paths.append(directory / f"{name}_centreline.csv")
            rows = TO_MM * np.column_stack([arm.arc_length, arm.position])
            write_text(paths[-1], to_csv(["s_mm", "x_mm", "y_mm", "z_mm"], rows.tolist()))
        paths.append(directory / "command.txt")
        versions = f"tubeopt {__version__}, Python {platform.python_version()}"
        versions += f", Matplotlib {metadata.version('matplotlib')}"
        write_text(paths[-1], f"{self.answer.command}\n{versions}, letters {families()[0]}\n")
        return paths

    def draw(self, directory: Path) -> list[Path]:
        """Write every picture without a heading, its data (CSV) where it has scales, and captions.txt."""
        from .plots.figure import drawn_data

        paths, captions = list[Path](), list[str]()
        for name, draw in self.answer.shown.pictures().items():
            picture = directory / file_name(name)
            headings: list[str] = []
            # A context variable reaches all pictures without an argument through every plot function.
            token = HEADINGS.set(headings)
            try:
                figure = draw(picture)
            finally:
                HEADINGS.reset(token)
            paths.append(picture)
            captions.append(f"{picture.name}: {_caption(headings)}")
            if rows := list(drawn_data(figure)):
                paths.append(picture.with_name(f"{picture.stem}_data.csv"))
                write_text(paths[-1], to_csv(["panel", "curve", "x", "y", "value"], rows))
        paths.append(directory / "captions.txt")
        write_text(paths[-1], "\n".join(captions) + "\n")
        return paths

    def conclude(self) -> None:
        self.answer.shown.conclude()


def _caption(headings: list[str]) -> str:
    """Caption of a picture, a sentence made of its headings."""
    lines = [line.rstrip(",:") for heading in dict.fromkeys(headings) for line in heading.split("\n")]
    return f"{re.sub(r' {2,}', ' ', '; '.join(lines)) or 'No heading'}. Computed with tubeopt {__version__}."

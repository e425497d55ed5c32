"""What an installation consists of, and whether it computes what it should, as fast as it can."""

from __future__ import annotations

import os
import platform
import time
from dataclasses import asdict, dataclass
from importlib import metadata, util
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Group
from rich.table import Table
from rich.text import Text

from .. import __version__
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.verification import verify_equilibrium
from ..robots.concentric import ConcentricRobot
from ..robots.tubes import Tube
from ..solvers.compiled.library import cache_directory, library
from ..solvers.compiled.packaged import FOLDER
from .report import two_columns

LIBRARIES = ("casadi", "numpy", "scipy", "matplotlib")

EXTRAS = {
    "planning": ("ompl", "trimesh", "rtree", "manifold3d"),
    "fabrication": ("ezdxf", "trimesh", "manifold3d"),
    "view": ("viser", "manifold3d"),
    "cluster": ("dask", "distributed"),
}
"""What each extra of the package brings."""

THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

TOLERANCE = 1e-9
"""The tip (m) may differ by so much from an adaptive re-integration of the equations."""


@dataclass(frozen=True)
class SelfTest:
    """A robot solved, and integrated again by another method: `difference` of the tips, m; `seconds` of one solve."""

    difference: float
    seconds: float
    passed: bool


@dataclass(frozen=True)
class Doctor:
    """An installation: versions by library, the compiled kernel (its place, or why there is none), variables that set
    threads, the cache and its bytes, what each extra lacks, and the self-test."""

    versions: dict[str, str]
    system: str
    kernel: str
    threads: dict[str, str]
    cache: Path
    cache_bytes: int
    missing: dict[str, tuple[str, ...]]
    test: SelfTest

    def record(self) -> dict[str, Any]:
        """The answer as JSON."""
        return asdict(self) | {"cache": str(self.cache)}

    def table(self) -> Group:
        """The answer for a person."""
        versions = ", ".join(f"{name} {version}" for name, version in self.versions.items())
        extras = [f"{name}: all there" for name, lacks in self.missing.items() if not lacks]
        hints = [
            Text(f"extra {name} lacks {', '.join(lacks)}: pip install 'tubeopt[{name}]'")
            for name, lacks in self.missing.items()
            if lacks
        ]
        t = self.test
        verdict = "passed" if t.passed else "FAILED"
        rows = [
            ("versions", versions),
            ("system", self.system),
            ("compiled kernel", self.kernel),
            ("threads", ", ".join(f"{k}={v}" for k, v in self.threads.items()) or "as the libraries choose"),
            ("cache", f"{self.cache}, {self.cache_bytes / 1e6:.1f} MB"),
            ("extras", ", ".join(extras) or "none"),
            (
                "self-test",
                f"{verdict}: off by {t.difference:.0e} m from a re-integration; {1e6 * t.seconds:.0f} us",
            ),
        ]
        table: Table = two_columns("tubeopt", rows)
        return Group(table, *hints)

    def save(self, directory: Path) -> list[Path]:
        """Nothing to save."""
        return []

    def draw(self, directory: Path) -> list[Path]:
        """No picture."""
        return []


def examine() -> Doctor:
    """The installation that runs."""
    cache = cache_directory()
    files = [path for path in cache.rglob("*") if path.is_file()] if cache.exists() else []
    return Doctor(
        versions={"tubeopt": __version__} | {name: metadata.version(name) for name in LIBRARIES},
        system=f"Python {platform.python_version()}, {platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        kernel=_kernel(),
        threads={name: os.environ[name] for name in THREADS if name in os.environ},
        cache=cache,
        cache_bytes=sum(path.stat().st_size for path in files),
        missing={extra: tuple(n for n in names if util.find_spec(n) is None) for extra, names in EXTRAS.items()},
        test=_self_test(),
    )


def _kernel() -> str:
    if os.environ.get("TUBEOPT_COMPILE") == "0":
        return "switched off by TUBEOPT_COMPILE=0"
    found = library(2, False)
    if found is None:
        return "none: the package brings none, and no C compiler was found"
    return f"of the package, {found.path.name}" if found.path.parent == FOLDER else "compiled on this machine"


def _self_test() -> SelfTest:
    """Two tubes at a right angle: collocated and solved, then integrated by DOP853."""
    tubes = (Tube(1.2e-3, 1.0e-3, 0.05, 0.1, 10.0), Tube(1.8e-3, 1.4e-3, 0.05, 0.08, 12.0))
    robot, rotations = ConcentricRobot(tubes), np.array([np.pi / 2, 0.0])
    checked = verify_equilibrium(forward_kinematics(robot, rotations)).verification
    difference = np.inf if checked is None else checked.tip_position
    seconds = []
    for _ in range(50):
        began = time.perf_counter()
        forward_kinematics(robot, rotations)
        seconds.append(time.perf_counter() - began)
    return SelfTest(difference, min(seconds), difference < TOLERANCE)

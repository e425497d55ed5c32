"""Build and load the compiled kernel: C files of this folder with mechanics that CasADi generates.

If there is no C compiler, or if it fails, `library` is None, and the general solver computes the same results slower.
"""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import hashlib
import logging
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import platformdirs
import scipy

from ...block.transcription.arm import SHAPE_RATIO, ArmShape
from ...block.transcription.collocated import SHAPE_STEPS
from ...block.transcription.mesh import BEND_PER_ELEMENT, WAVES_PER_ELEMENT
from ...errors import InputError
from ...files.files import write_text
from ...physics.certificate import coupling_rate_function
from ...physics.shape import carry_function
from ...physics.torsion import section_functions
from ...robots.assembly import LENGTH_ROUND_OFF as ROUND_OFF_LENGTH
from ...robots.order import SAME_END
from ..settings import (
    LARGEST_RATIO,
    LARGEST_SHIFT,
    LARGEST_TURN,
    LARGEST_TWIST,
    LAST_STEP,
    LONGEST_STEP,
    NEWTON,
    NEWTON_ROUND_OFF,
    SOFT_TWIST,
)
from .constants import COARSE_DEGREE, DEGREE, arm_constants, rule_constants, slope_constants
from .packaged import Kind, packaged_kernel, processor, processor_features
from .text import HERE, c_text, side_by_side

PACKAGE = Path(__file__).parents[2]

FLAGS = ("-O3", "-fno-math-errno", "-fno-trapping-math", "-fassociative-math", "-fno-signed-zeros")
"""Flags of the compiler.

Sums may be reordered into vectors; infinities and NaN keep their meaning, since the kernel tests for them.
"""

OWN_PROCESSOR = "-march=native"
"""Flag for all instructions of this processor; it is left out where a compiler does not accept it."""

MOST_CUTS = 512
"""Largest number of breakpoints in the kernel."""

MOST_PIECES, MOST_UNKNOWNS = 32, 404
"""Largest numbers of pieces and unknowns in the kernel, with four unknowns as padding of matrices.

The general solver solves larger problems.
"""


class Capacity(NamedTuple):
    """Largest mesh in a kernel."""

    pieces: int = MOST_PIECES
    """Largest number of pieces."""
    unknowns: int = MOST_UNKNOWNS
    """Largest number of unknowns, a multiple of four."""


CAPACITY = Capacity()
"""Capacity of the kernels that Python calls."""

ABREAST_UNKNOWNS = 100
"""Largest number of unknowns where robots are solved side by side: matrices must stay in the cache."""

MOST_TUBES = 6
"""Largest number of tubes in the kernel; more tubes need the blocked elimination of LAPACK, in the general solver."""


@dataclass(frozen=True, eq=False)
class Kernel:
    """Loaded kernel."""

    functions: Any
    """Shared library with the functions."""
    path: Path
    """File of the library."""
    answer: np.dtype[np.void]
    """C struct Answer."""
    workspace_size: int
    """Size of the workspace, bytes."""

    @property
    def differentiable(self) -> bool:
        """True if the kernel has derivatives, as for concentric tubes."""
        return hasattr(self.functions, "differentiate")


def cache_directory() -> Path:
    """Folder of compiled kernels and tables: TUBEOPT_CACHE, else the user's cache directory."""
    folder = os.environ.get("TUBEOPT_CACHE")
    return Path(folder) if folder else platformdirs.user_cache_path("tubeopt", appauthor=False)


def source(n: int, eccentric: bool) -> str:
    """C text of the kernel for n concentric or eccentric tubes."""
    parts = ["entries.c"] if eccentric else ["dimensions.c", "entries.c"]
    return kernel_text(n, eccentric) + "".join((HERE / name).read_text() for name in parts)


def abreast_source(n: int) -> str:
    """C text of the kernel that solves n concentric tubes of several robots side by side."""
    return kernel_text(n, capacity=CAPACITY._replace(unknowns=ABREAST_UNKNOWNS), abreast=True)


def kernel_text(n: int, eccentric: bool = False, capacity: Capacity = CAPACITY, *, abreast: bool = False) -> str:
    """`source` without the functions that Python calls; only CasADi's functions are visible from outside."""
    slopes = not eccentric and not abreast
    generator, layout = ca.CodeGenerator("mechanics.c"), ca.CodeGenerator("layout.c")
    concentric, actual = section_functions(n, False), section_functions(n, eccentric)
    generator.add(concentric["balance"])
    (layout if abreast else generator).add(coupling_rate_function(n))
    section = actual["section"]
    symbols = section.sx_in()
    moment, stretch, curvature, bending = section.call(symbols)
    for name, inputs, outputs in (
        ("section_curvature", symbols, [curvature, stretch]),
        ("section_moment", symbols, [moment, stretch, bending]),
        ("carry", *signature(carry_function())),
    ):
        generator.add(ca.Function(name, inputs, [ca.densify(out) for out in outputs], {"cse": True}))
    if slopes:
        for name in ("curvature_slope", "variation", "linear"):
            generator.add(concentric[name])
    if eccentric:
        generator.add(ca.Function("stretched", *signature(actual["balance"]), {"cse": True}))
    constants = {
        "ABREAST": int(abreast),
        "ECCENTRIC": int(eccentric),
        "SLOPES": int(slopes),
        "MOST_SECTIONS": capacity.pieces,
        "MOST_CUTS": MOST_CUTS,
        "N": n,
        "STEPS": SHAPE_STEPS,
        "SHAPE_RATIO": SHAPE_RATIO,
        "COARSE_DEGREE": COARSE_DEGREE,
        "MOST_DEGREE": DEGREE,
        "MOST_PIECES": capacity.pieces,
        "MOST_UNKNOWNS": capacity.unknowns,
        "MOST_ITERATIONS": NEWTON.descent_iterations,
        "WAVES_PER_ELEMENT": WAVES_PER_ELEMENT,
        "BEND_PER_ELEMENT": BEND_PER_ELEMENT,
        "ROUND_OFF_LENGTH": ROUND_OFF_LENGTH,
        "SAME_END": SAME_END,
        "ROUND_OFF": NEWTON_ROUND_OFF,
        "LAST_STEP": LAST_STEP,
        "LONGEST_STEP": LONGEST_STEP,
        "LARGEST_RATIO": LARGEST_RATIO,
        "LARGEST_TWIST": LARGEST_TWIST,
        "SOFT_TWIST": SOFT_TWIST,
        "LARGEST_TURN": LARGEST_TURN,
        "LARGEST_SHIFT": LARGEST_SHIFT,
    }
    tables = rule_constants(eccentric) + arm_constants() + slope_constants() * slopes
    generated = side_by_side(layout.dump(), generator.dump()) if abreast else generator.dump()
    return tables + c_text(constants, generated, "kernel.c")


def signature(function: ca.Function) -> tuple[list[Any], list[Any]]:
    """Symbols and outputs of a function."""
    symbols = function.sx_in()
    return symbols, list(function.call(symbols))


def compiler() -> list[str] | None:
    """C compiler: CC, else cc, gcc or clang; None without any, or if TUBEOPT_COMPILE is 0.

    The flags are those of gcc and clang; Visual Studio has other ones, and is not searched.
    """
    if os.environ.get("TUBEOPT_COMPILE") == "0":
        return None
    command = os.environ.get("CC")
    if command:
        return shlex.split(command)
    path = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
    return [path] if path else None


def _cached_or_built(kind: Kind, text: Callable[[], str]) -> Path | None:
    """Shared library of a kind, from an earlier build of the same sources, or built from its C text."""
    command = compiler()
    if command is None:
        return None
    # A note has the name of the library of these sources: CasADi takes longer to generate the text than a command runs.
    key = "\0".join((_sources(), *map(str, kind), *command, *_tuning()))
    note = cache_directory() / "kernels" / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}.name"
    try:
        path = note.parent / note.read_text().strip()
        if path.is_file():
            return path
    except (OSError, UnicodeDecodeError):
        pass
    built = _build(text())
    if built is not None and built.parent == note.parent:
        with contextlib.suppress(InputError):  # without a note the text is generated the next time
            write_text(note, built.name)
    return built


SOURCES = ("block", "physics", "robots", "solvers")
"""Packages that the C text depends on."""

COMPILING = logging.getLogger("tubeopt.kernel")
"""Logger of compilations."""


@lru_cache(maxsize=1)
def _sources() -> str:
    """Hash of the sources and of the versions of libraries."""
    digest = hashlib.sha256("\0".join((ca.CasadiMeta.version(), np.__version__, scipy.__version__)).encode())
    for name in SOURCES:
        for path in sorted((PACKAGE / name).rglob("*.[cp]*")):
            if path.suffix in (".c", ".py"):
                digest.update(f"\0{path.relative_to(PACKAGE)}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def _tuning() -> tuple[str, ...]:
    """Flags of the compiler, and the machine."""
    return *FLAGS, OWN_PROCESSOR, f"{platform.machine()} {platform.system()} {processor()}"


def _build(text: str) -> Path | None:
    """Shared library of a C text, compiled unless it is in the cache; None if it cannot be compiled."""
    command = compiler()
    if command is None:
        return None
    for folder in (cache_directory, _temporary_folder):
        path = cache_path(text, folder)
        if path.exists():
            return path
        COMPILING.info("compiling for this question; it takes some seconds, once")
        for tuned in ([OWN_PROCESSOR], []):
            try:
                compile_to(text, path, tuned)
            except (OSError, subprocess.SubprocessError):
                continue
            if not tuned:
                _warn_once(
                    f"{command[0]} cannot compile the kernel with {OWN_PROCESSOR}: it is compiled for any processor of "
                    "this kind. Results are the same, about 2 times slower. Set CC to a newer compiler"
                )
            return path
    return None


def cache_path(text: str, folder: Callable[[], Path] = cache_directory) -> Path:
    """Path of the shared library of a C text, as compiled by this machine's compiler for its processor."""
    name = hashlib.sha256("\0".join((text, *(compiler() or ()), *_tuning())).encode()).hexdigest()[:32]
    return folder() / "kernels" / f"{name}.so"


def compile_to(text: str, path: Path, flags: Sequence[str]) -> None:
    """Compile a C text to a shared library, completely or not at all; raises SubprocessError or OSError on failure."""
    compile_command = compiler()
    if compile_command is None:
        raise OSError("there is no C compiler")
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as work:
        (Path(work) / "kernel.c").write_text(text)
        command = [*compile_command, *FLAGS, *flags, "-w", "-shared", "-o", "kernel.so", "kernel.c"]
        # Libraries of Windows need neither flag, and clang refuses the first one there.
        command += [] if platform.system() == "Windows" else ["-fPIC", "-lm"]
        # A busy machine needs minutes, so the limit is 1200 s.
        subprocess.run(command, cwd=work, capture_output=True, timeout=1200, check=True)
        os.replace(Path(work) / "kernel.so", path)


@lru_cache(maxsize=1)
def _temporary_folder() -> Path:
    """Folder of this process that replaces a cache that is not writable; removed at exit."""
    folder = tempfile.mkdtemp(prefix="tubeopt-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _answer(n: int) -> np.dtype[np.void]:
    """C struct Answer."""
    points, shape = MOST_PIECES * DEGREE, MOST_PIECES * SHAPE_STEPS + 1
    reals = ("margin", "residual", "mesh_error", "tip_error", "energy", "contraction", "largest_change")
    whole = ("pieces", "points", "sections", "iterations", "elements")
    fields: list[Any] = [(name, "f8") for name in reals] + [(name, "i8") for name in whole]
    fields += [
        ("tip_rotations", "f8", n),
        ("tube_end", "f8", n),
        ("section_start", "f8", MOST_PIECES + 1),
    ]
    fields += [("point", "f8", points), ("point_rotation", "f8", (points, n))]
    fields += [("arc_length", "f8", shape), ("rotation", "f8", (shape, n)), ("torsion", "f8", (shape, n))]
    fields += [("curvature", "f8", (shape, 2)), ("position", "f8", (shape, 3)), ("frame", "f8", (shape, 3, 3))]
    return np.dtype(fields)


@lru_cache(maxsize=8)
def _warn_once(message: str) -> None:
    logging.getLogger("tubeopt").warning(message)


def kernel_path(kind: Kind, text: Callable[[], str], *, required: bool = True) -> Path | None:
    """Path of the kernel of a kind, from the package or compiled from its C text; None without a kernel.

    `required`: log a warning without a kernel.
    """
    if os.environ.get("TUBEOPT_COMPILE") == "0":
        return None
    path = packaged_kernel(kind, processor_features()) or _cached_or_built(kind, text)
    if path is None and required:
        command = compiler()
        lacks = "no C compiler to make one" if command is None else f"the C compiler {command[0]} cannot make one"
        _warn_once(
            f"there is no compiled kernel and {lacks}. Results are the same, about 20 times slower. "
            "Install a C compiler (apt install gcc; xcode-select --install; winget install LLVM.LLVM) or a wheel with "
            "the kernel"
        )
    return path


def open_library(path: Path) -> Any:
    """Shared library; None if its folder does not allow execution, or if the file is broken."""
    try:
        return ctypes.CDLL(str(path))
    except OSError:
        return None


@lru_cache(maxsize=16)
def abreast_library(n: int) -> Kernel | None:
    """Compiled kernel of `abreast_source` for n tubes; None without a kernel."""
    kernel = load_kernel((n, "abreast"), lambda: abreast_source(n), _answer(n), required=False)
    if kernel is not None:
        pointer, whole = ctypes.c_void_p, ctypes.c_longlong
        kernel.functions.follow_abreast.argtypes = [pointer, whole, *[pointer] * 9]
        kernel.functions.solve_abreast.argtypes = [pointer, whole, *[pointer] * 6]
        kernel.functions.follow_abreast.restype = kernel.functions.solve_abreast.restype = None
    return kernel


def load_kernel(
    kind: Kind, text: Callable[[], str], answer: np.dtype[np.void], *, required: bool = True
) -> Kernel | None:
    """Kernel of a kind with this C struct Answer (without fields for none); None without a kernel."""
    path = kernel_path(kind, text, required=required)
    loaded = None if path is None else open_library(path)
    if path is None or loaded is None:
        return None
    for size in (loaded.workspace_size, loaded.answer_size):
        size.restype = ctypes.c_size_t
    if answer.itemsize not in (0, loaded.answer_size()):
        raise RuntimeError(f"the compiled kernel has answers of {loaded.answer_size()} bytes, not {answer.itemsize}")
    return Kernel(loaded, path, answer, loaded.workspace_size())


@lru_cache(maxsize=16)
def library(n: int, eccentric: bool) -> Kernel | None:
    """Compiled kernel of `source` for n tubes; None without a kernel."""
    kind, answer = (n, "eccentric" if eccentric else "concentric"), _answer(n)
    kernel = load_kernel(kind, lambda: source(n, eccentric), answer)
    if kernel is None:
        return None
    pointer, whole, functions = ctypes.c_void_p, ctypes.c_longlong, kernel.functions
    functions.solve.argtypes = [pointer] * 6
    functions.solve_many.argtypes = [pointer, whole, *[pointer] * 4, whole, *[pointer] * 3]
    functions.follow_many.argtypes = [pointer, whole, *[pointer] * 9]
    functions.solve_many.restype = functions.follow_many.restype = None
    if kernel.differentiable:
        functions.differentiate.argtypes = [pointer] * 5
        functions.differentiate_dimensions.argtypes = [pointer, pointer, ctypes.c_int, pointer, pointer]
        functions.differentiate_dimensions.restype, functions.varied_size.restype = None, ctypes.c_size_t
        functions.snap_distance.argtypes = [pointer, ctypes.c_double, ctypes.c_double, pointer]
        functions.motion_distance.argtypes = [*[pointer] * 5, *[ctypes.c_double] * 4]
        functions.snap_distance.restype = functions.motion_distance.restype = ctypes.c_double
    return kernel


def copied_shape(answer: dict[str, Any], points: int, curvature: str = "curvature") -> ArmShape:
    """Copy of the shape points in a kernel's answer; `curvature` is the name of the curvature there."""
    return ArmShape(
        arc_length=answer["arc_length"][:points].copy(),
        rotation=answer["rotation"][:points].T.copy(),
        torsion=answer["torsion"][:points].T.copy(),
        curvature=answer[curvature][:points].copy(),
        position=answer["position"][:points].copy(),
        frame=answer["frame"][:points].copy(),
    )

"""Building and loading the compiled kernel: C of this folder with the mechanics that CasADi generates.

Where there is no C compiler, or it fails, `library` is None, and the general solver finds the same answers more slowly.
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

from ...block.transcription.arm import SHAPE_RATIO
from ...block.transcription.collocated import STEPS
from ...block.transcription.mesh import BEND_PER_PIECE, WAVES_PER_ELEMENT
from ...errors import InputError
from ...files.files import write_text
from ...physics.certificate import coupling_rate_function
from ...physics.shape import carry_function
from ...physics.torsion import section_functions
from ...robots.assembly import ROUND_OFF as ROUND_OFF_LENGTH
from ...robots.order import SAME_END
from ..settings import LAST_STEP, LONGEST_STEP, NEWTON, ROUND_OFF
from .constants import COARSE_DEGREE, DEGREE, arm_constants, rule_constants, slope_constants
from .packaged import Kind, packaged_kernel, processor, processor_features
from .text import HERE, c_text

PACKAGE = Path(__file__).parents[2]

FLAGS = ("-O3", "-fno-math-errno", "-fno-trapping-math", "-fassociative-math", "-fno-signed-zeros")
"""Sums may be reordered into vectors; infinities and NaN keep their meaning, since the kernel asks for them."""

OWN_PROCESSOR = "-march=native"
"""Uses all that the processor has. Not every compiler knows it for every processor: left out where it fails."""

MOST_CUTS = 512
"""Breakpoints that the kernel has room for."""

MOST_PIECES, MOST_UNKNOWNS = 32, 404
"""What the kernel has room for, four unknowns of it to fill up squares; larger arms go to the general solver."""


class Room(NamedTuple):
    """What a kernel of its own has room for: pieces of the mesh, and unknowns, a multiple of four."""

    pieces: int = MOST_PIECES
    unknowns: int = MOST_UNKNOWNS


ROOM = Room()
"""Of the kernels that Python calls."""

MOST_TUBES = 6
"""Robots of more tubes go to the general solver: their matrices ask for a blocked elimination, as LAPACK has it."""


@dataclass(frozen=True, eq=False)
class Kernel:
    """A loaded kernel: its functions, where it is, the fields of its answer, and the bytes that it works in."""

    functions: Any
    path: Path
    answer: np.dtype[np.void]
    workspace_size: int

    @property
    def differentiable(self) -> bool:
        """Whether it has derivatives: that of concentric tubes."""
        return hasattr(self.functions, "differentiate")


def cache_directory() -> Path:
    """Where compiled kernels and tables are kept: TUBEOPT_CACHE, else the user's cache directory."""
    own = os.environ.get("TUBEOPT_CACHE")
    return Path(own) if own else platformdirs.user_cache_path("tubeopt", appauthor=False)


def source(n: int, eccentric: bool) -> str:
    """The C text of the kernel for n tubes, concentric or off the centreline."""
    return kernel_text(n, eccentric) + (HERE / "entries.c").read_text()


def kernel_text(n: int, eccentric: bool = False, room: Room = ROOM) -> str:
    """`source` without the functions that Python calls: of it, only what CasADi makes can be seen from outside."""
    slopes = not eccentric
    generator = ca.CodeGenerator("mechanics.c")
    concentric, own = section_functions(n, False), section_functions(n, eccentric)
    generator.add(concentric["balance"])
    generator.add(coupling_rate_function(n))
    section = own["section"]
    symbols = section.sx_in()
    moment, stretch, curvature, bending = section.call(symbols)
    for name, given, outputs in (
        ("section_curvature", symbols, [curvature, stretch]),
        ("section_moment", symbols, [moment, stretch, bending]),
        ("carry", *signature(carry_function())),
    ):
        generator.add(ca.Function(name, given, [ca.densify(out) for out in outputs], {"cse": True}))
    if slopes:
        for name in ("curvature_slope", "variation", "linear"):
            generator.add(concentric[name])
    if eccentric:
        generator.add(ca.Function("stretched", *signature(own["balance"]), {"cse": True}))
    constants = {
        "ECCENTRIC": int(eccentric),
        "SLOPES": int(slopes),
        "MOST_SECTIONS": room.pieces,
        "MOST_CUTS": MOST_CUTS,
        "N": n,
        "STEPS": STEPS,
        "SHAPE_RATIO": SHAPE_RATIO,
        "COARSE_DEGREE": COARSE_DEGREE,
        "MOST_DEGREE": DEGREE,
        "MOST_PIECES": room.pieces,
        "MOST_UNKNOWNS": room.unknowns,
        "MOST_ITERATIONS": NEWTON.descent_iterations,
        "WAVES_PER_ELEMENT": WAVES_PER_ELEMENT,
        "BEND_PER_PIECE": BEND_PER_PIECE,
        "ROUND_OFF_LENGTH": ROUND_OFF_LENGTH,
        "SAME_END": SAME_END,
        "ROUND_OFF": ROUND_OFF,
        "LAST_STEP": LAST_STEP,
        "LONGEST_STEP": LONGEST_STEP,
    }
    tables = rule_constants(eccentric) + arm_constants() + slope_constants() * slopes
    return tables + c_text(constants, generator, "kernel.c")


def signature(function: ca.Function) -> tuple[list[Any], list[Any]]:
    """Symbols of a function, and its outputs."""
    symbols = function.sx_in()
    return symbols, list(function.call(symbols))


def compiler() -> list[str] | None:
    """The C compiler: CC, else the usual names; None where there is none, or TUBEOPT_COMPILE is 0.

    What is typed are the options of gcc and clang; those of Visual Studio are others, and it is not asked.
    """
    if os.environ.get("TUBEOPT_COMPILE") == "0":
        return None
    wanted = os.environ.get("CC")
    if wanted:
        return shlex.split(wanted)
    found = next((path for name in ("cc", "gcc", "clang") if (path := shutil.which(name))), None)
    return [found] if found else None


def _found_or_built(kind: Kind, text: Callable[[], str]) -> Path | None:
    """The shared library of a kind, by what its sources made before, else by its C text."""
    own = compiler()
    if own is None:
        return None
    # A note names the library that the sources made: CasADi takes longer to generate the text than a command to run.
    words = "\0".join((_sources(), *map(str, kind), *own, *_tuning()))
    note = cache_directory() / "kernels" / f"{hashlib.sha256(words.encode()).hexdigest()[:32]}.name"
    try:
        path = note.parent / note.read_text().strip()
        if path.is_file():
            return path
    except (OSError, UnicodeDecodeError):
        pass
    built = _build(text())
    if built is not None and built.parent == note.parent:
        with contextlib.suppress(InputError):  # without a note the text is generated again
            write_text(note, built.name)
    return built


SOURCES = ("block", "physics", "robots", "solvers")
"""Packages whose source makes the C text, or numbers in it."""


COMPILING = logging.getLogger("tubeopt.kernel")
"""Says when a kernel is compiled."""


@lru_cache(maxsize=1)
def _sources() -> str:
    """What the sources and versions are, as a hash."""
    found = hashlib.sha256("\0".join((ca.CasadiMeta.version(), np.__version__, scipy.__version__)).encode())
    for name in SOURCES:
        for path in sorted((PACKAGE / name).rglob("*.[cp]*")):
            if path.suffix in (".c", ".py"):
                found.update(f"\0{path.relative_to(PACKAGE)}\0".encode() + path.read_bytes())
    return found.hexdigest()


def _tuning() -> tuple[str, ...]:
    """What is asked of the compiler, and for which machine."""
    return *FLAGS, OWN_PROCESSOR, f"{platform.machine()} {platform.system()} {processor()}"


def _build(text: str) -> Path | None:
    """The shared library of a C text, compiled unless it is in the cache; None where that cannot be."""
    own = compiler()
    if own is None:
        return None
    for folder in (cache_directory, _own_folder):
        path = kept_as(text, folder)
        if path.exists():
            return path
        COMPILING.info("compiling for this question; it takes some seconds, once")
        for tuned in ([OWN_PROCESSOR], []):
            try:
                compile_to(text, path, tuned)
            except (OSError, subprocess.SubprocessError):
                continue
            if not tuned:
                _tell_once(
                    f"{own[0]} cannot compile the kernel with {OWN_PROCESSOR}: it is compiled for any processor of "
                    "this kind; answers are the same,about 2 times slower; a newer compiler, named by CC, mends that"
                )
            return path
    return None


def kept_as(text: str, folder: Callable[[], Path] = cache_directory) -> Path:
    """Where the shared library of a C text is kept, compiled by this machine's compiler for its processor."""
    name = hashlib.sha256("\0".join((text, *(compiler() or ()), *_tuning())).encode()).hexdigest()[:32]
    return folder() / "kernels" / f"{name}.so"


def compile_to(text: str, path: Path, flags: Sequence[str]) -> None:
    """Compile a C text to a shared library, whole or not at all; raises SubprocessError or OSError where it cannot."""
    own = compiler()
    if own is None:
        raise OSError("there is no C compiler")
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent) as work:
        (Path(work) / "kernel.c").write_text(text)
        command = [*own, *FLAGS, *flags, "-w", "-shared", "-o", "kernel.so", "kernel.c"]
        # Libraries of Windows need neither, and clang refuses the first for them.
        command += [] if platform.system() == "Windows" else ["-fPIC", "-lm"]
        subprocess.run(
            command, cwd=work, capture_output=True, timeout=1200, check=True
        )  # s: a busy machine needs minutes
        os.replace(Path(work) / "kernel.so", path)


@lru_cache(maxsize=1)
def _own_folder() -> Path:
    """A folder that only this process knows, for where the cache cannot be written; removed in the end."""
    folder = tempfile.mkdtemp(prefix="tubeopt-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return Path(folder)


def _answer(n: int) -> np.dtype[np.void]:
    """The C struct Answer."""
    points, shape = MOST_PIECES * DEGREE, MOST_PIECES * STEPS + 1
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
def _tell_once(words: str) -> None:
    logging.getLogger("tubeopt").warning(words)


def kernel_path(kind: Kind, text: Callable[[], str]) -> Path | None:
    """Where the kernel of a kind is, from the package or compiled here from its C text; None where it cannot be had."""
    if os.environ.get("TUBEOPT_COMPILE") == "0":
        return None
    path = packaged_kernel(kind, processor_features()) or _found_or_built(kind, text)
    if path is None:
        own = compiler()
        lacks = "no C compiler to make one" if own is None else f"the C compiler {own[0]} cannot make one"
        _tell_once(
            f"there is no compiled kernel and {lacks}. Results are the same, about 20 times slower. "
            "Install a C compiler (apt install gcc; xcode-select --install; winget install LLVM.LLVM) or a wheel with "
            "the kernel"
        )
    return path


def open_library(path: Path) -> Any:
    """A shared library; None in a folder from which nothing may be executed, or where the file is broken."""
    try:
        return ctypes.CDLL(str(path))
    except OSError:
        return None


def load_kernel(kind: Kind, text: Callable[[], str], answer: np.dtype[np.void]) -> Kernel | None:
    """The kernel of a kind with this answer, of no fields where it is not asked for one; None where there is none."""
    path = kernel_path(kind, text)
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
    """The compiled kernel for n tubes, as `source`; None where it cannot be had."""
    kind, answer = (n, "eccentric" if eccentric else "concentric"), _answer(n)
    kernel = load_kernel(kind, lambda: source(n, eccentric), answer)
    if kernel is None:
        return None
    pointer, whole, functions = ctypes.c_void_p, ctypes.c_longlong, kernel.functions
    functions.solve.argtypes = [pointer] * 6
    functions.solve_many.argtypes = [pointer, whole, *[pointer] * 4, whole, *[pointer] * 3]
    functions.solve_many.restype = None
    if kernel.differentiable:
        functions.differentiate.argtypes = [pointer] * 5
    return kernel

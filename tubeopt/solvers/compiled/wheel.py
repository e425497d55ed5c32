"""Compiling all kernels for a wheel."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from .bundle import MOST_TUBES as MOST_BUNDLED
from .bundle import bundle_source
from .friction import friction_source
from .heating import heating_source
from .library import MOST_TUBES, abreast_source, cache_path, compile_to, compiler, source
from .loaded import loaded_source
from .packaged import Generation, Kind, generations, processor_features
from .quadratic import quadratic_source


def package_kernels(folder: Path, *, everywhere: bool) -> list[Path]:
    """Compile all kernels for a wheel, for this processor, or `everywhere` for every generation of its kind.

    Without a compiler there are none. Raises SubprocessError or OSError if the compiler fails.
    """
    if compiler() is None:
        return []
    features = processor_features()
    supported = known(generations())
    chosen = supported if everywhere else [generation for generation in supported if generation.needs <= features][:1]
    if not chosen:
        raise subprocess.SubprocessError("the compiler cannot compile a text of one line")
    return build_kernels(texts(), folder, chosen)


def known(among: Sequence[Generation]) -> list[Generation]:
    """Generations with flags that the compiler accepts, tested by a text of one line."""
    with tempfile.TemporaryDirectory() as scratch:

        def compiles(generation: Generation) -> bool:
            try:
                compile_to("int known = 1;\n", Path(scratch) / "known.so", generation.flags)
            except (OSError, subprocess.SubprocessError):
                return False
            return True

        return [generation for generation in among if compiles(generation)]


def build_kernels(sources: Mapping[Kind, str], folder: Path, chosen: Sequence[Generation]) -> list[Path]:
    """Compile the C texts of kernels, by kind, for some generations, and return the paths.

    Raises OSError or SubprocessError if one cannot be compiled: nobody would notice a missing kernel in a wheel.
    """
    folder.mkdir(parents=True, exist_ok=True)

    def build(job: tuple[Kind, Generation]) -> Path:
        kind, generation = job
        path = generation.kernel(folder, kind)
        compile_to(sources[kind], path, generation.flags)
        return path

    with ThreadPoolExecutor() as pool:
        return list(pool.map(build, [(kind, generation) for kind in sources for generation in chosen]))


def texts() -> dict[Kind, str]:
    """C texts of all kernels, by kind."""
    result: dict[Kind, str] = {(0, "heating"): heating_source(), (0, "quadratic"): quadratic_source()}
    for n in range(1, MOST_TUBES + 1):
        result |= {
            (n, "concentric"): source(n, False),
            (n, "abreast"): abreast_source(n),
            (n, "eccentric"): source(n, True),
            (n, "loaded"): loaded_source(n),
            (n, "friction"): friction_source(n),
        }
    return result | {(n, "bundle"): bundle_source(n) for n in range(1, MOST_BUNDLED + 1)}


def keep(folder: Path) -> int:
    """Copy the kernels of an unpacked wheel into the cache of this machine, and return their number.

    The source then runs without compiling them again.
    """
    count = 0
    for kind, text in texts().items():
        for generation in generations():
            path = generation.kernel(folder, kind)
            cached = cache_path(text)
            if path.exists() and generation.needs <= processor_features() and not cached.exists():
                cached.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, cached)
                count += 1
    return count


if __name__ == "__main__":
    print(f"{keep(Path(sys.argv[1]))} kernels of the wheel are kept")

"""Compiling all kernels for a wheel."""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from .heating import heating_source
from .library import MOST_TUBES, compile_to, compiler, kept_as, source
from .loaded import loaded_source
from .packaged import Generation, Kind, generations, processor_features
from .quadratic import quadratic_source
from .rubbing import rubbing_source


def package_kernels(folder: Path, *, everywhere: bool) -> list[Path]:
    """Compile all kernels for a wheel: for this processor, or `everywhere` for every generation of its
    kind; none where there is no compiler. Raises SubprocessError or OSError where the compiler fails."""
    if compiler() is None:
        return []
    here = processor_features()
    all_known = known(generations())
    chosen = all_known if everywhere else [one for one in all_known if one.needs <= here][:1]
    if not chosen:
        raise subprocess.SubprocessError("it compiles not even a line")
    return build_kernels(texts(), folder, chosen)


def known(among: Sequence[Generation]) -> list[Generation]:
    """Those generations whose flags the compiler knows, found by a text of one line."""
    with tempfile.TemporaryDirectory() as scratch:

        def compiles(generation: Generation) -> bool:
            try:
                compile_to("int known = 1;\n", Path(scratch) / "known.so", generation.flags)
            except (OSError, subprocess.SubprocessError):
                return False
            return True

        return [generation for generation in among if compiles(generation)]


def build_kernels(sources: Mapping[Kind, str], folder: Path, chosen: Sequence[Generation]) -> list[Path]:
    """Compile the C texts of kernels, by kind, for some generations; return the paths. Raises OSError or
    SubprocessError where the compiler cannot: a wheel that lacks one of its kernels would be noticed by nobody."""
    folder.mkdir(parents=True, exist_ok=True)

    def build(job: tuple[Kind, Generation]) -> Path:
        kind, generation = job
        path = generation.kernel(folder, kind)
        compile_to(sources[kind], path, generation.flags)
        return path

    with ThreadPoolExecutor() as pool:
        return list(pool.map(build, [(kind, generation) for kind in sources for generation in chosen]))


def texts() -> dict[Kind, str]:
    """The C texts of all kernels."""
    found: dict[Kind, str] = {(0, "heating"): heating_source(), (0, "quadratic"): quadratic_source()}
    for n in range(1, MOST_TUBES + 1):
        found |= {
            (n, "concentric"): source(n, False),
            (n, "eccentric"): source(n, True),
            (n, "loaded"): loaded_source(n),
            (n, "rubbing"): rubbing_source(n),
        }
    return found


def keep(folder: Path) -> int:
    """Put the kernels of a wheel, unpacked into a folder, where those of this machine are kept, so that who runs the
    source compiles none again; their number."""
    count = 0
    for kind, text in texts().items():
        for generation in generations():
            path = generation.kernel(folder, kind)
            kept = kept_as(text)
            if path.exists() and generation.needs <= processor_features() and not kept.exists():
                kept.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy(path, kept)
                count += 1
    return count


if __name__ == "__main__":
    print(f"{keep(Path(sys.argv[1]))} kernels of the wheel are kept")

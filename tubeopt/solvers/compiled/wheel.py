"""Compiling all kernels for a wheel."""

from __future__ import annotations

import tempfile
from pathlib import Path

from .heating import heating_source
from .library import MOST_TUBES, compile_to, compiler, source
from .loaded import loaded_source
from .packaged import Kind, build_kernels, generations, known, processor_features
from .rubbing import rubbing_source


def package_kernels(folder: Path, *, everywhere: bool) -> list[Path]:
    """Compile all kernels for a wheel: for this processor, or `everywhere` for every generation of its
    kind; none where there is no compiler. Raises SubprocessError or OSError where the compiler fails."""
    if compiler() is None:
        return []
    here = processor_features()
    with tempfile.TemporaryDirectory() as scratch:
        all_known = known(generations(), compile_to, Path(scratch))
    chosen = all_known if everywhere else [next(g for g in all_known if g.needs <= here)]
    texts: dict[Kind, str] = {(0, "heating"): heating_source()}
    for n in range(1, MOST_TUBES + 1):
        texts |= {
            (n, "concentric"): source(n, False),
            (n, "eccentric"): source(n, True),
            (n, "general"): source(n, False, True),
            (n, "loaded"): loaded_source(n),
            (n, "rubbing"): rubbing_source(n),
        }
    return build_kernels(texts, compile_to, folder, chosen)

"""Compiling the kernels of all robots for a wheel."""

from __future__ import annotations

from pathlib import Path

from .library import MOST_TUBES, compile_to, compiler, source
from .loaded import loaded_source
from .packaged import Kind, build_kernels, generations, processor_features
from .rubbing import rubbing_source


def package_kernels(folder: Path, *, everywhere: bool) -> list[Path]:
    """Compile the kernels of all robots for a wheel: for this processor, or `everywhere` for every generation of its
    kind; none where there is no compiler."""
    if compiler() is None:
        return []
    texts: dict[Kind, str] = {}
    for n in range(1, MOST_TUBES + 1):
        texts |= {
            (n, "concentric"): source(n, False),
            (n, "eccentric"): source(n, True),
            (n, "general"): source(n, False, True),
            (n, "loaded"): loaded_source(n),
            (n, "rubbing"): rubbing_source(n),
        }
    here = processor_features()
    chosen = generations() if everywhere else [next(g for g in generations() if g.needs <= here)]
    return build_kernels(texts, compile_to, folder, chosen)

"""Kernels in the package, compiled when its wheel was built, for several generations of processors."""

from __future__ import annotations

import importlib
import platform
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

Kind = tuple[int, str]
"""Kind of a kernel: number of tubes, and "concentric", "abreast", "eccentric", "loaded", "friction" or "bundle".

(0, "heating") and (0, "quadratic") are the kernels of heat and of small least squares, for all robots.
"""

FOLDER = Path(__file__).parent / "kernels"
"""Folder of the kernels in a wheel."""


@dataclass(frozen=True)
class Generation:
    """Processors with certain instructions: flags of the compiler, and features that the processor `needs`."""

    name: str
    flags: tuple[str, ...] = ()
    needs: frozenset[str] = field(default_factory=frozenset)

    def kernel(self, folder: Path, kind: Kind) -> Path:
        """Path of the kernel of a kind."""
        n, what = kind
        return folder / f"{what}-{n}-{self.name}.so"


_V3 = frozenset({"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"})
_X86 = (
    Generation("v4", ("-march=x86-64-v4",), _V3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}),
    Generation("v3", ("-march=x86-64-v3",), _V3),
    Generation("any"),
)


def generations() -> tuple[Generation, ...]:
    """Generations of this machine's kind of processor, the newest first; the last one runs on all of them."""
    return _X86 if platform.machine() in ("x86_64", "AMD64") else (Generation("any"),)


def processor_features() -> frozenset[str]:
    """Features of the processor, such as "avx2"."""
    return frozenset(processor().split())


def processor() -> str:
    """Features of the processor as one text: the flags of Linux (features on ARM), elsewhere those known to NumPy."""
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return " ".join((platform.processor(), *sorted(_features_by_numpy())))
    return next((line for line in info.read_text().splitlines() if line.startswith(("flags", "Features"))), "")


def _features_by_numpy() -> frozenset[str]:
    """Features of the processor that NumPy detected, by their names in Linux; incomplete before NumPy 2.4."""
    try:
        features = importlib.import_module("numpy._core._multiarray_umath").__cpu_features__
    except (ImportError, AttributeError):
        return frozenset()
    linux_names = {"BMI": "bmi1", "FMA3": "fma", "LZCNT": "abm"}
    return frozenset(linux_names.get(name, name.lower()) for name, present in features.items() if present)


def packaged_kernel(kind: Kind, features: Iterable[str]) -> Path | None:
    """Path of the newest kernel of this package for a processor with these features; None without any."""
    available = frozenset(features)
    paths = (g.kernel(FOLDER, kind) for g in generations() if g.needs <= available)
    return next((path for path in paths if path.exists()), None)

"""Kernels that come with the package, compiled when its wheel was built, for several generations of processors."""

from __future__ import annotations

import importlib
import platform
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

Kind = tuple[int, str]
"""Of a kernel: for how many tubes, and what: "concentric", "eccentric", "loaded" or
"rubbing"; 0 and "heating" or "quadratic" are those of
heat and of small least squares, for all robots."""

FOLDER = Path(__file__).parent / "kernels"
"""Where a wheel has them."""


@dataclass(frozen=True)
class Generation:
    """Processors that have certain instructions: what a compiler is told, and what the processor must say of itself."""

    name: str
    flags: tuple[str, ...] = ()
    needs: frozenset[str] = field(default_factory=frozenset)

    def kernel(self, folder: Path, kind: Kind) -> Path:
        """Path of the kernel of a kind of robot."""
        n, what = kind
        return folder / f"{what}-{n}-{self.name}.so"


_V3 = frozenset({"avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "abm", "movbe"})
_X86 = (
    Generation("v4", ("-march=x86-64-v4",), _V3 | {"avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"}),
    Generation("v3", ("-march=x86-64-v3",), _V3),
    Generation("any"),
)


def generations() -> tuple[Generation, ...]:
    """The generations of this machine's kind of processor, the best first; the last runs on all of them."""
    return _X86 if platform.machine() in ("x86_64", "AMD64") else (Generation("any"),)


def processor_features() -> frozenset[str]:
    """What the processor can do, in words."""
    return frozenset(processor().split())


def processor() -> str:
    """What the processor can do, for which the kernel is tuned: Linux calls it flags, on ARM features; elsewhere NumPy
    has asked the processor."""
    info = Path("/proc/cpuinfo")
    if not info.exists():
        return " ".join((platform.processor(), *sorted(_features_by_numpy())))
    return next((line for line in info.read_text().splitlines() if line.startswith(("flags", "Features"))), "")


def _features_by_numpy() -> frozenset[str]:
    """What NumPy found the processor to have, in the words of Linux; before NumPy 2.4 not all of it."""
    try:
        found = importlib.import_module("numpy._core._multiarray_umath").__cpu_features__
    except (ImportError, AttributeError):
        return frozenset()
    words = {"BMI": "bmi1", "FMA3": "fma", "LZCNT": "abm"}
    return frozenset(words.get(name, name.lower()) for name, there in found.items() if there)


def packaged_kernel(kind: Kind, features: Iterable[str]) -> Path | None:
    """The best kernel of this package for a processor with these features; None where there is none."""
    have = frozenset(features)
    paths = (g.kernel(FOLDER, kind) for g in generations() if g.needs <= have)
    return next((path for path in paths if path.exists()), None)

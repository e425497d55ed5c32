"""The build of a wheel: `configs/` goes into it, and the compiled kernels if TUBEOPT_WHEEL asks for them.

Without that variable the kernels are compiled at first use, a few seconds each, so that an installation takes seconds
and not minutes. TUBEOPT_WHEEL=here compiles all of them for the processor of this machine, TUBEOPT_WHEEL=everywhere for
every generation of its kind, as a wheel to publish needs.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

GENERATORS = ["casadi>=3.7", "lazy-loader>=0.4", "numpy>=2", "platformdirs>=4", "scipy>=1.15"]
"""What the package generates the C of its kernels with."""


def wanted() -> str:
    """For which processors kernels go into the wheel: "", "here" or "everywhere"."""
    value = os.environ.get("TUBEOPT_WHEEL", "")
    if value not in ("", "here", "everywhere"):
        raise ValueError(f"TUBEOPT_WHEEL is {value!r}; it must be 'here' or 'everywhere'")
    return value


class KernelHook(BuildHookInterface):
    """Compiles the kernels from the C that the package itself generates."""

    def dependencies(self) -> list[str]:
        """Packages that this build needs."""
        return GENERATORS if wanted() else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add `configs/` to the wheel, and the kernels, with which it is for this platform alone."""
        if version == "editable":
            return
        # Robots, rigs and studies that are typed by their name: one source, in `configs/`.
        build_data["force_include"]["configs"] = "tubeopt/configs"
        if not wanted():
            return
        sys.path.insert(0, self.root)
        from tubeopt.solvers.compiled.wheel import package_kernels

        self._folder = tempfile.TemporaryDirectory()
        everywhere = wanted() == "everywhere"
        lacks = "no C compiler"
        try:
            kernels = package_kernels(Path(self._folder.name), everywhere=everywhere)
        except (OSError, subprocess.SubprocessError) as error:
            if everywhere:  # a wheel to publish
                raise
            kernels, lacks = [], f"the C compiler failed ({error})"
        if not kernels:
            self.app.display_warning(f"{lacks}: the wheel has no compiled kernel, and solvesabout 20 times slower")
            return
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        build_data["force_include"] |= {str(path): f"tubeopt/solvers/compiled/kernels/{path.name}" for path in kernels}

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what is in the wheel now."""
        if version != "editable" and wanted():
            self._folder.cleanup()

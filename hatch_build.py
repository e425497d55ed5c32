"""The build of a wheel: `configs/` goes into it, and the compiled kernels where there is a C compiler."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class KernelHook(BuildHookInterface):
    """Compiles the kernels from the C that the package itself generates.

    For this machine's processor; for every generation of its kind, as a wheel to publish needs, with
    TUBEOPT_WHEEL=everywhere.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add them to the wheel, which then is for this platform; an editable install compiles at first use."""
        if version == "editable":
            return
        # Robots, rigs and studies that are typed by their name: one source, in `configs/`.
        build_data["force_include"]["configs"] = "tubeopt/configs"
        sys.path.insert(0, self.root)
        from tubeopt.solvers.compiled.wheel import package_kernels

        self._folder = tempfile.TemporaryDirectory()
        everywhere = os.environ.get("TUBEOPT_WHEEL") == "everywhere"
        lacks = "no C compiler"
        try:
            kernels = package_kernels(Path(self._folder.name), everywhere=everywhere)
        except (OSError, subprocess.SubprocessError) as error:
            if everywhere:  # a wheel to publish
                raise
            kernels, lacks = [], f"the C compiler failed ({error})"
        if not kernels:
            self.app.display_warning(f"{lacks}: the wheel has no compiled kernel, and solves some 20 times slower")
            return
        platform = sysconfig.get_platform().replace("-", "_").replace(".", "_")
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform}"
        build_data["force_include"] |= {str(path): f"tubeopt/solvers/compiled/kernels/{path.name}" for path in kernels}

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """The kernels are in the wheel."""
        if version != "editable":
            self._folder.cleanup()

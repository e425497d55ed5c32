"""The robot in the page: the kernel as WebAssembly, and the page of `docs/page` with it.

A hook of MkDocs, and a command: `python .ci/page.py FOLDER` writes the page with its kernel into a folder, which any
server of files can show. The kernel is the text that Python compiles, with the numbers of the robot as variables
(`docs/page/kernel`). It is compiled by Zig (`pip install ziglang`), and kept in the cache of compiled kernels.
"""

from __future__ import annotations

import hashlib
import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from tubeopt import ConcentricRobot, load_robot
from tubeopt.control.c_library import header_text, library_text, loads_text
from tubeopt.robots.materials import MATERIALS
from tubeopt.robots.robot import is_general
from tubeopt.solvers.compiled.library import cache_directory, kernel_text

PAGE = Path(__file__).resolve().parents[1] / "docs" / "page"
KERNEL = PAGE / "kernel"
ROBOTS = PAGE.parents[1] / "configs" / "robots"
FIRST = "thesis_ctr"

TUBES = 4
"""Most tubes of a robot in the page: one kernel serves all robots, with tubes of no length in place of missing ones."""

COMPILER = (sys.executable, "-m", "ziglang", "cc", "--target=wasm32-wasi")
FLAGS = ("-O2", "-msimd128", "-std=gnu99", "-w")
LINK = ("-mexec-model=reactor", "-Wl,--strip-all", "-Wl,-z,stack-size=4194304")

MISSING = "no compiler for WebAssembly, so the page has no kernel: python -m pip install ziglang"


def sources() -> dict[str, str]:
    """Name of a file -> its text."""
    numbers, last = ((KERNEL / f"{name}.c").read_text() for name in ("numbers", "page"))
    inputs = "extern Pieces PIECES;\nextern Tubes ROBOT;\nextern double MASS[];\n"
    return {
        "tubeopt_robot.h": header_text("robot in the page", TUBES, loads=True),
        "robot.c": library_text("robot in the page", kernel_text(TUBES), numbers) + last,
        "loads.c": loads_text("robot in the page", TUBES, inputs),
    }


def compile_kernel(texts: dict[str, str], out: Path) -> None:
    """Compile the kernel; raises CalledProcessError where that fails."""
    with tempfile.TemporaryDirectory() as scratch:
        for name, text in texts.items():
            (Path(scratch) / name).write_text(text)

        def run(*words: str) -> None:
            subprocess.run([*COMPILER, *words], cwd=scratch, check=True)

        with ThreadPoolExecutor() as pool:
            list(pool.map(lambda name: run(*FLAGS, "-c", f"{name}.c", "-o", f"{name}.o"), ("robot", "loads")))
        run(*FLAGS, *LINK, "robot.o", "loads.o", "-o", "kernel.wasm")
        out.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(Path(scratch) / "kernel.wasm", out)


def kernel() -> Path | None:
    """The compiled kernel, from the cache where its sources are as they were; None where there is no compiler."""
    texts = sources()
    text = "\0".join((*FLAGS, *LINK, *texts.values()))
    retained = cache_directory() / "kernels" / f"page-{hashlib.sha256(text.encode()).hexdigest()[:32]}.wasm"
    if not retained.exists():
        if importlib.util.find_spec("ziglang") is None:
            return None
        compile_kernel(texts, retained)
    return retained


def robots() -> dict[str, Any]:
    """Robot files of `configs/robots` that the page shows, the thesis robot first, and its materials, in SI."""
    shown = []
    for path in sorted(ROBOTS.glob("*.yaml"), key=lambda path: (path.stem != FIRST, path.stem)):
        robot = load_robot(path)
        plain = not is_general(robot) and isinstance(robot, ConcentricRobot)
        if plain and robot.n_tubes <= TUBES and robot.calibration is None:
            shown.append({"name": robot.name, "text": path.read_text()})
    materials = {name: {"youngs": m.youngs_modulus, "shear": m.shear_modulus} for name, m in MATERIALS.items()}
    return {"robots": shown, "materials": materials}


def on_post_build(config: Any) -> None:
    """Add what is made to the page of the site that MkDocs has built."""
    complete(Path(config.site_dir) / "page")


def complete(folder: Path) -> bool:
    """Put kernel and robots into a page; whether there is a kernel."""
    (folder / "robots.json").write_text(json.dumps(robots()))
    result = kernel()
    if result is None:
        print(MISSING, file=sys.stderr)
        return False
    shutil.copyfile(result, folder / "kernel.wasm")
    return True


def main(folder: Path) -> None:
    """The whole page into a folder."""
    shutil.copytree(PAGE, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("kernel"))
    if not complete(folder):
        sys.exit(1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

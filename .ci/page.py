"""The robot in the page: the kernel as WebAssembly, and the page of `docs/page` with it.

A hook of MkDocs, and a command: `python .ci/page.py FOLDER` writes the page with its kernel into a folder, from which any
server of files shows it. The kernel is the text that Python compiles, with the numbers of the robot as variables
(`docs/page/kernel`). It is compiled by Zig (`pip install ziglang`), and kept in the cache of compiled kernels.
"""

from __future__ import annotations

import hashlib
import importlib.util
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from tubeopt.control.c_library import header_text, library_text
from tubeopt.control.c_loads import loads_text
from tubeopt.solvers.compiled.library import cache_directory, kernel_text

PAGE = Path(__file__).resolve().parents[1] / "docs" / "page"
KERNEL = PAGE / "kernel"

TUBES = 4
"""Most tubes of a robot in the page: one kernel serves all robots, with tubes of no length in place of those that lack."""

COMPILER = (sys.executable, "-m", "ziglang", "cc", "--target=wasm32-wasi")
FLAGS = ("-O2", "-msimd128", "-std=gnu99", "-w")
LINK = ("-mexec-model=reactor", "-Wl,--strip-all", "-Wl,-z,stack-size=4194304")

MISSING = "no compiler for WebAssembly, so the page has no kernel: python -m pip install ziglang"


def sources() -> dict[str, str]:
    """Name of a file -> its text."""
    numbers, last = ((KERNEL / f"{name}.c").read_text() for name in ("numbers", "page"))
    given = "extern Pieces PIECES;\nextern Tubes ROBOT;\nextern double MASS[];\n"
    return {
        "tubeopt_robot.h": header_text("robot in the page", TUBES, loads=True),
        "robot.c": library_text("robot in the page", kernel_text(TUBES), numbers) + last,
        "loads.c": loads_text("robot in the page", TUBES, given),
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
    words = "\0".join((*FLAGS, *LINK, *texts.values()))
    kept = cache_directory() / "kernels" / f"page-{hashlib.sha256(words.encode()).hexdigest()[:32]}.wasm"
    if not kept.exists():
        if importlib.util.find_spec("ziglang") is None:
            return None
        compile_kernel(texts, kept)
    return kept


def on_post_build(config: Any) -> None:
    """Put the kernel beside the page of the site that MkDocs has built."""
    put_kernel(Path(config.site_dir) / "page")


def put_kernel(folder: Path) -> bool:
    """Put the kernel into a page; whether there is one."""
    found = kernel()
    if found is None:
        print(MISSING, file=sys.stderr)
        return False
    shutil.copyfile(found, folder / "kernel.wasm")
    return True


def main(folder: Path) -> None:
    """The whole page into a folder."""
    shutil.copytree(PAGE, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("kernel"))
    if not put_kernel(folder):
        sys.exit(1)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

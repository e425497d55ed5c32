#!/usr/bin/env python
"""Break one place of the code, many times, and see whether a test notices.

    .ci/mutate code [COUNT [SEED]] [--area AREA] [--only GLOB] [--seconds S]

takes COUNT places of the areas in mutants.py at random, changes one operator, constant, condition or call of each in a
copy of the tree, and runs the tests that run the changed function, the likeliest first. A mutant is killed by a test
that fails with it and passes without it. A survivor needs a test, or changes no answer. All tests are collected once;
each mutant gets a process of its own, in which the changed function has the new code.

mutmut skips decorated functions and constants of modules, cosmic-ray has one command for all tests; neither knows C++.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import os
import random
import re
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import CodeType, FrameType, FunctionType

import platformdirs
import pytest
from mutants import AREAS, ROOT, Mutant, files_of, sample

READ_BY = {"control/c/": "control/c_library.py", "shaping/firmware/sketch/": "shaping/firmware/sketch_files.py"}
"""Folder of C and C++ -> the module that reads it, whose tests run it."""

CACHE = platformdirs.user_cache_path("tubeopt", appauthor=False)
MAP = CACHE / "test_map.json"
"""Test -> seconds that it takes, and the functions that it runs, as "file::name"; measured when it is first seen."""

Tests = dict[str, tuple[float, list[str]]]


class Copy:
    """A copy of the tree, in which files are changed and tests run, with a cache of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.tree, self.cache = folder, folder / "tree", folder / "cache"
        self.when = int(time.time()) - 10**6
        names = ["git", "ls-files", "-co", "--exclude-standard", "-z"]
        listed = subprocess.run(names, cwd=ROOT, capture_output=True, check=True).stdout.decode()
        for name in filter(None, listed.split("\0")):
            if (ROOT / name).is_file():
                (self.tree / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(ROOT / name, self.tree / name)
        shutil.copytree(CACHE, self.cache) if CACHE.exists() else self.cache.mkdir()
        self.proper = set(self.cache.rglob("*"))

    def write(self, file: str, text: bytes) -> None:
        """A file of tubeopt/, with a time that no compiled file knows: these are told apart by size and second."""
        path = self.tree / "tubeopt" / file
        path.write_bytes(text)
        self.when += 2
        os.utime(path, (self.when, self.when))

    def clear(self) -> None:
        """Remove tables that a mutant made."""
        for new in set(self.cache.rglob("*")) - self.proper:
            if new.is_file() and new.suffix not in (".so", ".name"):
                new.unlink()


class Session:
    """A plugin of pytest that in place of all tests runs those that may notice a mutant, for many mutants."""

    def __init__(self, copy: Copy, chosen: dict[str, list[Mutant]], seconds: float) -> None:
        self.copy, self.chosen, self.seconds = copy, chosen, seconds
        self.killed = dict.fromkeys(chosen, 0)
        self.sound: dict[tuple[str, bool], bool] = {}
        self.failed = self.passed = ""
        self.took = 0.0

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self.failed = report.nodeid
        if report.when == "call" and report.passed:
            self.passed, self.took = report.nodeid, round(report.duration, 3)

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        self.items = {item.nodeid: item for item in session.items}
        tests = self.measured()
        for area, mutants in self.chosen.items():
            for mutant in mutants:
                start_time = time.monotonic()
                killer = self.killer(mutant, likely(mutant, tests, self.seconds), area != "physics")
                self.killed[area] += bool(killer)
                word, took = "killed" if killer else "SURVIVED", time.monotonic() - start_time
                print(f"{word:8}  {mutant}    {killer} {took:.0f} s", flush=True)
        return True

    def measured(self) -> Tests:
        """What each test runs; those that are new are run once, to see that."""
        known = json.loads(MAP.read_text()) if MAP.exists() else {}
        note, package = self.copy.folder / "new.json", f"{self.copy.tree}/tubeopt/"
        new = [test for test in self.items if test not in known]
        for some in (new[k : k + 100] for k in range(0, len(new), 100)):
            found: Tests = {}
            called: set[CodeType] = set()

            def look(frame: FrameType, event: str, arg: object, called: set[CodeType] = called) -> None:
                called.add(frame.f_code)

            def measure(some: list[str] = some, found: Tests = found, called: set[CodeType] = called) -> None:
                for test in some:
                    called.clear()
                    sys.settrace(look)
                    self.passed = ""
                    self.run(test)
                    sys.settrace(None)
                    names = {
                        f"{code.co_filename.removeprefix(package)}::{code.co_qualname.split('.<locals>')[0]}"
                        for code in called
                        if code.co_filename.startswith(package)
                    }
                    found[test] = (self.took, sorted(names)) if self.passed else (0.0, [])
                note.write_text(json.dumps(found))

            note.write_text("{}")
            self.in_child(measure, 3000.0)
            known |= json.loads(note.read_text())
            MAP.write_text(json.dumps(known))
        return {test: tuple(known[test]) for test in self.items if test in known}

    def run(self, test: str, then: str | None = None) -> None:
        """Run a test as pytest does; what is built for it stays for the one that comes then."""
        item, after = self.items[test], None if then is None else self.items[then]
        item.ihook.pytest_runtest_protocol(item=item, nextitem=after)

    def in_child(self, work: Callable[[], None], seconds: float) -> bool:
        """Do something in a process of its own; whether it came to its end in time."""
        child = os.fork()
        if child == 0:
            os.setpgid(0, 0)
            resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds) + 5))
            with open(os.devnull, "w") as nothing:
                os.dup2(nothing.fileno(), 1), os.dup2(nothing.fileno(), 2)
            with contextlib.suppress(BaseException):  # the child ends by itself whatever its tests raise
                work()
                os._exit(0)
            os._exit(1)
        end, code = time.monotonic() + 8 * seconds, None
        while code is None and time.monotonic() < end:
            done, status = os.waitpid(child, os.WNOHANG)
            code = status if done else None
            time.sleep(0.02)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, 9)
        if code is None:
            os.waitpid(child, 0)
        self.copy.clear()
        return code == 0

    def first_failure(self, tests: list[str], compiled: bool, change: Callable[[], None] | None = None) -> str:
        """The first of these tests that fails after a change; "" if none does, "no end" if they do not end."""
        note = self.copy.folder / "failed"

        def work() -> None:
            if not compiled:
                os.environ["TUBEOPT_COMPILE"] = "0"
            if change:
                change()
            for test, then in zip(tests, [*tests[1:], None], strict=True):
                self.run(test, then)
                if self.failed:
                    note.write_text(self.failed)
                    return

        note.write_text("")
        ended = self.in_child(work, 4 * self.seconds + 60)
        return note.read_text() or ("" if ended else "no end")

    def killer(self, mutant: Mutant, tests: list[str], compiled: bool) -> str:
        """The test that kills a mutant, or "no end"; "" if it survives."""
        proper = (self.copy.tree / "tubeopt" / mutant.file).read_bytes()
        start, end = mutant.start, mutant.start + len(mutant.old.encode())
        broken = proper[:start] + mutant.new.encode() + proper[end:]
        change = partial(exchange, str(self.copy.tree / "tubeopt" / mutant.file), proper, broken)
        while tests:
            self.copy.write(mutant.file, broken)
            if mutant.function:
                result = self.first_failure(tests, compiled, change)
            elif mutant.file.endswith(".py"):
                result = self.afresh(tests, compiled)
            else:
                result = self.first_failure(tests, compiled)
            self.copy.write(mutant.file, proper)
            if result and "::" not in result:
                return "" if self.first_failure(tests, compiled) else result
            if not result or self.passes(result, compiled):
                return result
            tests = [test for test in tests if test != result]  # it fails without the mutant too
        return ""

    def passes(self, test: str, compiled: bool) -> bool:
        """Whether a test passes where nothing is changed."""
        if (test, compiled) not in self.sound:
            self.sound[test, compiled] = not self.first_failure([test], compiled)
        return self.sound[test, compiled]

    def afresh(self, tests: list[str], compiled: bool) -> str:
        """As `first_failure`, by a new interpreter: what runs when a module is imported cannot be exchanged later."""
        command = [sys.executable, "-m", "pytest", "-x", *ARGUMENTS, "--tb=no", "-rfE", *tests]
        try:
            run = subprocess.run(
                command,
                cwd=self.copy.tree,
                env={**os.environ, "COLUMNS": "500"} | ({} if compiled else {"TUBEOPT_COMPILE": "0"}),
                capture_output=True,
                text=True,
                timeout=8 * (4 * self.seconds + 60),
            )
        except subprocess.TimeoutExpired:
            return "no end"
        failed = re.search(r"^(?:FAILED|ERROR) (.*?)(?: - .*)?$", run.stdout, re.MULTILINE)
        return failed[1] if failed else "" if run.returncode == 0 else "no end"


ARGUMENTS = ("-n0", "-q", "-s", "-p", "no:cacheprovider", "-m", "not night")


def exchange(path: str, proper: bytes, broken: bytes) -> None:
    """Give the functions of a loaded module the code that they have in another text of it."""

    def functions(code: CodeType) -> list[CodeType]:
        """Those of a module and of its classes."""
        inner = [each for each in code.co_consts if isinstance(each, CodeType)]
        return [each for part in inner for each in ([part] if part.co_flags & 1 else functions(part))]

    olds, news = (functions(compile(text, path, "exec", dont_inherit=True)) for text in (proper, broken))
    new_of = {(old.co_qualname, old.co_firstlineno): new for old, new in zip(olds, news, strict=True)}
    gc.unfreeze()
    for each in gc.get_objects():
        if isinstance(each, FunctionType) and each.__code__.co_filename == path:
            new = new_of.get((each.__code__.co_qualname, each.__code__.co_firstlineno))
            each.__code__ = new or each.__code__
    for name, module in list(sys.modules.items()):
        if name.startswith("tubeopt"):
            for each in list(vars(module).values()):
                if hasattr(each, "cache_clear"):
                    each.cache_clear()


def likely(mutant: Mutant, tests: Tests, seconds: float) -> list[str]:
    """The tests that run the changed function, else its module: those named like it first, then the quickest."""
    file = next((module for folder, module in READ_BY.items() if mutant.file.startswith(folder)), mutant.file)
    folder, *inside = Path(mutant.file).parent.parts
    stem, inner = Path(mutant.file).stem, set(inside)
    function = f"{file}::{mutant.function}"
    ranked = []
    for test, (cost, ran) in tests.items():
        runs = mutant.function and function in ran, any(name.startswith(f"{file}::") for name in ran)
        own = test.startswith(f"tests/{folder}/")
        name = test.split("::")[0].removesuffix(".py")
        named = own and (f"_{stem}" in name or stem.replace("_", " ") in test or not inner.isdisjoint(name.split("_")))
        if cost and (any(runs) or named):
            ranked.append((not named, not runs[0], not own, cost, test))
    chosen, total = [], 0.0
    for *_, cost, test in sorted(ranked):
        if total + cost <= seconds:
            chosen.append(test)
            total += cost
    return chosen


def main() -> int:
    """0 if nine mutants of ten are killed."""
    parser = argparse.ArgumentParser(prog=".ci/mutate code", description="Break one place of the code, many times.")
    parser.add_argument("count", nargs="?", type=int, default=50)
    parser.add_argument("seed", nargs="?", type=int, default=0)
    parser.add_argument("--area", action="append", choices=AREAS, help="of these areas alone")
    parser.add_argument("--only", default="*", metavar="GLOB", help="of files that match, as planning/branch.py")
    parser.add_argument("--seconds", type=float, default=60, help="of tests, as long as they take without a mutant")
    args = parser.parse_args()
    random_, areas = random.Random(args.seed), [area for area in args.area or AREAS if files_of(area, args.only)]
    fractions = [args.count // len(areas) + (k < args.count % len(areas)) for k in range(len(areas))]
    chosen = {area: sample(area, args.only, fraction, random_) for area, fraction in zip(areas, fractions, strict=True)}
    with tempfile.TemporaryDirectory() as folder:
        copy = Copy(Path(folder))
        os.chdir(copy.tree)
        os.environ |= {"PYTHONPATH": str(copy.tree), "TUBEOPT_CACHE": str(copy.cache), "CI": "true"}
        sys.path.insert(0, str(copy.tree))
        session = Session(copy, chosen, args.seconds)
        pytest.main([*ARGUMENTS, "--no-header", "--no-summary", f"--basetemp={folder}/tmp"], plugins=[session])
        os.chdir(ROOT)
    for area, mutants in chosen.items():
        print(f"{area:10} {session.killed[area]:4} of {len(mutants):4} mutants killed")
    return 0 if sum(session.killed.values()) >= 0.9 * sum(map(len, chosen.values())) else 1


if __name__ == "__main__":
    sys.exit(main())

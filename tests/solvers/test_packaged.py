"""Kernels that come with a wheel: which of them a processor gets, and that they answer as those compiled here."""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.examples import TWO_TUBE
from tubeopt import forward_kinematics
from tubeopt.solvers.compiled import binding, packaged, wheel
from tubeopt.solvers.compiled import library as building
from tubeopt.solvers.compiled.bundle import bundle_source
from tubeopt.solvers.compiled.friction import friction_source
from tubeopt.solvers.compiled.heating import heating_source
from tubeopt.solvers.compiled.loaded import loaded_source
from tubeopt.solvers.compiled.quadratic import quadratic_source

CONCENTRIC = (3, "concentric")


@pytest.fixture
def generations(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> tuple[packaged.Generation, ...]:
    """Two generations of processors, in a folder of their own."""
    both = packaged.Generation("new", (), frozenset({"wide"})), packaged.Generation("any")
    monkeypatch.setattr(packaged, "generations", lambda: both)
    monkeypatch.setattr(packaged, "FOLDER", tmp_path)
    return both


def test_a_processor_gets_the_best_that_it_runs(generations: tuple[packaged.Generation, ...], tmp_path: Path) -> None:
    new, old = (generation.kernel(tmp_path, CONCENTRIC) for generation in generations)
    assert packaged.packaged_kernel(CONCENTRIC, ["wide"]) is None
    old.touch()
    assert packaged.packaged_kernel(CONCENTRIC, ["wide"]) == old
    new.touch()
    assert packaged.packaged_kernel(CONCENTRIC, ["wide", "other"]) == new
    assert packaged.packaged_kernel(CONCENTRIC, ["other"]) == old
    assert packaged.packaged_kernel((3, "eccentric"), ["wide"]) is None


@pytest.mark.skipif(platform.machine() != "x86_64" or not Path("/proc/cpuinfo").exists(), reason="no Linux on x86-64")
def test_where_the_system_does_not_tell_the_processor_has_the_same_generation() -> None:
    """From NumPy 2.4 on, which knows them all; an older one gives an older generation, which runs as well."""
    report, requested = packaged.processor_features(), packaged._features_by_numpy()
    by_numpy = [generation.needs <= requested for generation in packaged.generations()]
    by_linux = [generation.needs <= report for generation in packaged.generations()]
    new = tuple(int(part) for part in np.__version__.split(".")[:2]) >= (2, 4)
    assert by_numpy == by_linux if new else all(a <= b for a, b in zip(by_numpy, by_linux, strict=True))


@pytest.mark.parametrize("eccentric", [False, True])
@pytest.mark.parametrize("target", ["x86_64-windows-gnu", "aarch64-linux-gnu"])
def test_it_compiles_for_other_machines(target: str, eccentric: bool, tmp_path: Path) -> None:
    """By clang: for Windows with what Python calls to be seen from outside, for ARM with its vectors."""
    pytest.importorskip("ziglang", reason="no ziglang")
    (tmp_path / "kernel.c").write_text(building.source(2, eccentric))
    zig = [sys.executable, "-m", "ziglang", "cc", f"--target={target}", "-O2", "-w", "-S", "kernel.c"]
    subprocess.run(zig, cwd=tmp_path, check=True, timeout=240)
    assembly = (tmp_path / "kernel.s").read_bytes()
    if "windows" in target:
        assert all(
            f'-export:{name}"'.encode() in assembly for name in ("solve", "solve_many", "answer_size", "workspace_size")
        )
    else:
        assert assembly.count(b".2d") > 100


def test_a_generation_that_the_compiler_does_not_know_is_left_out_and_no_kernel_else(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A kernel that does not compile is an error: the wheel would lack it, and nobody would know."""

    def compile_to(text: str, path: Path, flags: object) -> None:
        if flags or text == "broken":
            raise subprocess.TimeoutExpired("cc", 1)
        path.write_text(text)

    monkeypatch.setattr(wheel, "compile_to", compile_to)
    kinds = packaged.Generation("new", ("-march=unheard-of",)), packaged.Generation("any")
    chosen = wheel.known(kinds)
    texts = {(1, "concentric"): "a", (2, "eccentric"): "b", (2, "loaded"): "c"}
    made = wheel.build_kernels(texts, tmp_path / "kernels", chosen)
    assert [path.name for path in made] == ["concentric-1-any.so", "eccentric-2-any.so", "loaded-2-any.so"]
    with pytest.raises(subprocess.TimeoutExpired):
        wheel.build_kernels(texts | {(3, "loaded"): "broken"}, tmp_path / "kernels", chosen)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_without_a_compiler_the_kernel_of_the_package_answers(
    generations: tuple[packaged.Generation, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("TUBEOPT_COMPILE", raising=False)
    expected = forward_kinematics(TWO_TUBE, [0.0, 1.0])
    path = generations[1].kernel(tmp_path, (2, "concentric"))
    building.compile_to(building.source(2, False), path, ("-O0",))  # is made soon
    monkeypatch.setattr(building, "compiler", lambda: None)
    kernel = building.library.__wrapped__(2, False)
    assert kernel is not None
    assert kernel.path.parent == tmp_path
    tubes = binding._tubes(TWO_TUBE, 0)
    prepared = binding.Prepared(kernel, tubes, binding.address(tubes[0]))
    monkeypatch.setattr(binding, "with_kernel", lambda robot, n: prepared)
    answer = binding.solve_compiled(TWO_TUBE, np.array([0.0, 1.0]), TWO_TUBE.home_translations)
    assert answer is not None
    assert answer.solution.arm.position[-1] == pytest.approx(expected.tip_position, abs=1e-12)


def test_where_there_is_no_kernel_it_is_said_once(
    generations: object, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.delenv("TUBEOPT_COMPILE", raising=False)
    monkeypatch.setattr(building, "compiler", lambda: None)
    building._warn_once.cache_clear()
    assert building.library.__wrapped__(3, False) is None
    assert building.library.__wrapped__(2, False) is None
    (record,) = caplog.records
    assert "no C compiler" in record.getMessage()


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_every_kernel_compiles_for_processors_with_fused_multiplication() -> None:
    # Where it does not, it is compiled without the processor's own instructions, and is half as fast, unnoticed.
    texts = [building.source(2, eccentric) for eccentric in (False, True)]
    for text in (
        *texts,
        *(make(2) for make in (loaded_source, friction_source, bundle_source)),
        heating_source(),
        quadratic_source(),
    ):
        report = subprocess.run(
            ["cc", "-fsyntax-only", "-D__FMA__", "-w", "-x", "c", "-"], input=text, text=True, capture_output=True
        )
        assert report.returncode == 0, report.stderr


def test_a_compiler_that_compiles_nothing_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`CC=/bin/false pip install .` ended with StopIteration; the build hook now makes a wheel without kernels."""
    monkeypatch.setenv("CC", "/bin/false")
    with pytest.raises(subprocess.SubprocessError, match="cannot compile a text of one line"):
        wheel.package_kernels(tmp_path, everywhere=False)
    with pytest.raises(subprocess.SubprocessError, match="cannot compile a text of one line"):
        wheel.package_kernels(tmp_path, everywhere=True)

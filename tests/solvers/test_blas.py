"""Small problems are solved with one thread of linear algebra, whatever the libraries are set to, and leave it so."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from threading import Thread

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from tests.examples import THESIS
from tubeopt import IkSession, Load, assess_snapping, find_load_limit, forward_kinematics, stability_map, worst_margin
from tubeopt.inverse import gauss_newton
from tubeopt.solvers.blas import _libraries, small
from tubeopt.solvers.compiled.quadratic import LeastSquares


def counts() -> set[int]:
    """Threads that the libraries of linear algebra may use."""
    return {one.get_num_threads() for one in _libraries()}


@pytest.fixture
def two_threads() -> Iterator[None]:
    _libraries()
    with threadpool_limits(2, "blas"):
        if counts() != {2}:
            pytest.skip("there is no library here whose threads can be set")
        yield


@pytest.mark.usefixtures("two_threads")
def test_a_block_has_one_thread_and_gives_them_back() -> None:
    with small:
        assert counts() == {1}
        with pytest.raises(ZeroDivisionError), small:
            raise ZeroDivisionError
        assert counts() == {1}
    assert counts() == {2}


@pytest.mark.usefixtures("two_threads")
def test_blocks_beside_each_other_end_with_the_last() -> None:
    def beside() -> None:
        with small:
            pass

    with small:
        thread = Thread(target=beside)
        thread.start()
        thread.join()
        assert counts() == {1}
    assert counts() == {2}


@pytest.mark.usefixtures("two_threads")
def test_a_servo_step_runs_in_one(monkeypatch: pytest.MonkeyPatch) -> None:
    observed: list[set[int]] = []
    solve = gauss_newton.constrained_least_squares

    def asked(*arguments: np.ndarray) -> LeastSquares | None:
        observed.append(counts())
        return solve(*arguments)

    monkeypatch.setattr(gauss_newton, "constrained_least_squares", asked)
    current = forward_kinematics(THESIS, [0.1, 0.2, 0.3])
    IkSession(THESIS, start=current).solve(current.tip_position + 1e-4)
    assert observed
    assert set().union(*observed) == {1}
    assert counts() == {2}


@pytest.mark.usefixtures("two_threads")
def test_searches_and_fits_run_in_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every question that solves many small problems, by what it first does with its robot."""

    class SeenError(Exception):
        """The number of threads was looked at."""

    def look(*_: object) -> None:
        assert counts() == {1}
        raise SeenError

    start = forward_kinematics(THESIS, [0.0, 0.0, 0.0])
    monkeypatch.setattr(type(THESIS), "assembly", look)
    monkeypatch.setattr(type(THESIS), "n_tubes", property(look))
    questions: tuple[Callable[[], object], ...] = (
        lambda: assess_snapping(THESIS),
        lambda: worst_margin(THESIS),
        lambda: stability_map(THESIS),
        lambda: find_load_limit(THESIS, start.rotations, None, Load((0.01, 0.0, 0.0)), equilibrium=start),
    )
    for ask in questions:
        with pytest.raises(SeenError):
            ask()
    assert counts() == {2}

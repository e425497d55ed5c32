"""Small problems are solved with one thread of linear algebra, whatever the libraries are set to, and leave it so."""

from __future__ import annotations

from collections.abc import Iterator
from threading import Thread

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from tests.examples import THESIS
from tubeopt import IkSession, forward_kinematics
from tubeopt.inverse import session as sessions
from tubeopt.inverse.least_squares import LeastSquares
from tubeopt.solvers.parallel.blas import _libraries, one_blas_thread


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
    with one_blas_thread():
        assert counts() == {1}
        with pytest.raises(ZeroDivisionError), one_blas_thread():
            raise ZeroDivisionError
        assert counts() == {1}
    assert counts() == {2}


@pytest.mark.usefixtures("two_threads")
def test_blocks_beside_each_other_end_with_the_last() -> None:
    def beside() -> None:
        with one_blas_thread():
            pass

    with one_blas_thread():
        thread = Thread(target=beside)
        thread.start()
        thread.join()
        assert counts() == {1}
    assert counts() == {2}


@pytest.mark.usefixtures("two_threads")
def test_a_servo_step_runs_in_one(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[set[int]] = []
    solve = sessions.constrained_least_squares

    def asked(*arguments: np.ndarray) -> LeastSquares | None:
        seen.append(counts())
        return solve(*arguments)

    monkeypatch.setattr(sessions, "constrained_least_squares", asked)
    here = forward_kinematics(THESIS, [0.1, 0.2, 0.3])
    IkSession(THESIS, seed=here).solve(here.tip_position + 1e-4)
    assert seen
    assert set().union(*seen) == {1}
    assert counts() == {2}

"""What is in the way of a servo step."""

from __future__ import annotations

import enum


class Why(enum.IntFlag):
    """Why a servo step is not all that was asked for; 0: nothing is in the way. The C library has the first six."""

    RATE = 1
    RANGE = 2
    ORDER = 4
    MARGIN = 8
    SHORTENED = 16
    HELD = 32
    OBSTACLE = 64

    @property
    def words(self) -> str:
        """In words, empty where nothing is in the way."""
        return "; ".join(WORDS[bit] for bit in Why if bit in self)


WORDS = {
    Why.RATE: "a joint moves as fast as it may",
    Why.RANGE: "a joint is at the end of its range",
    Why.ORDER: "tubes or carriages touch",
    Why.MARGIN: "the margin is held at its floor",
    Why.SHORTENED: "the guard has shortened the step",
    Why.HELD: "no step is safe, the robot stays where it is",
    Why.OBSTACLE: "the arm slides along an obstacle",
}

"""What is said about a robot that a page or a server has, until it is stopped."""

from __future__ import annotations

from dataclasses import dataclass

from ..display import Displayed
from ..robots.robot import Robot
from .quantities import Quantity
from .report import Report


@dataclass(frozen=True)
class Viewed(Displayed):
    """A robot in the browser."""

    robot: Robot
    """As it is first."""

    url: str
    """Address of its page."""

    name: str
    """What texts call it."""


@dataclass(frozen=True)
class Served(Viewed):
    """A robot over WebSocket."""

    token: str
    """What clients must know."""


VIEWED: tuple[Quantity[Viewed], ...] = (
    Quantity("url", "address of the page"),
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
)

SERVED: tuple[Quantity[Served], ...] = (
    Quantity("url", "address of the server"),
    Quantity("token", "token for clients"),
    Quantity("robot", "name of the robot", lambda a: a.robot.name),
)


class ViewedReport(Report[Viewed]):
    command = "view"
    quantities = VIEWED

    def table(self) -> str:
        return f"showing {self.answer.name} at {self.answer.url}   (Ctrl-C to stop)"


class ServedReport(Report[Served]):
    command = "serve"
    quantities = SERVED

    def table(self) -> str:
        answer = self.answer
        return f"serving {answer.name} at {answer.url}, token {answer.token}   (Ctrl-C to stop)"

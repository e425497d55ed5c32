"""Interactive viewer: a robot that the user moves in a browser.

`session` holds what the robot does and how it came there, as plain data; the modules that know viser only show it.
"""

from __future__ import annotations

from .server import serve
from .session import Session, SessionEvent, go_home, move, move_joint, open_session, other_equilibria
from .view import View

__all__ = [
    "Session",
    "SessionEvent",
    "View",
    "go_home",
    "move",
    "move_joint",
    "open_session",
    "other_equilibria",
    "serve",
]

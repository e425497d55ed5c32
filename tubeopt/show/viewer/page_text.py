"""Texts of the page in HTML: readout, log, messages, legend; and the commands of the page. Texts are escaped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Protocol

import numpy as np

from ...bodies.frames import Plane
from ...equilibrium.result import Equilibrium
from ..formatting import counted
from ..page import margin_colour, tube_colour
from ..quantities import Quantity, known_distance, record
from .session import Session, SessionEvent

SHOWN_EVENTS = 12
"""Number of events in the log; earlier events are counted."""

BOX = "font:12px/1.45 sans-serif;padding:2px 10px 6px"
BADGE = {"stable": "#009660", "close to a snap": "#b8860b", "snapped": "#c81e1e"}


SIDEBAR: tuple[Quantity[Equilibrium], ...] = (
    Quantity("tip_position_mm", "tip", form=".4f"),
    Quantity("energy_mJ", "energy", form=".4f"),
    Quantity("margin", "margin", form=".4f"),
)
"""Quantities of the shown equilibrium; a bar shows the last."""


def readout(session: Session, certificate: float | None) -> str:
    """Text on the state of the robot; `certificate` is None while it is not computed."""
    e = session.equilibrium
    known = record(e, SIDEBAR)
    lines = "<br>".join(f'{q.about} <span data-testid="{q.about}">{q.number(known)}</span> {q.sign}' for q in SIDEBAR)
    # Negative margins, of unstable equilibria, have no bar.
    percent = 100 * min(max(e.margin, 0.0), 1.0)
    state = session.verdict
    bar = (
        '<div style="height:9px;border-radius:4px;background:#8883;overflow:hidden">'
        f'<div style="width:{percent:.1f}%;height:100%;background:rgb{margin_colour(e.margin)}"></div></div>'
    )
    badge = (
        f'<b data-testid="state" style="background:{BADGE[state]};color:white;border-radius:4px;padding:1px 7px">'
        f"{state}</b>"
    )
    return (
        f'<div style="{BOX}" data-testid="readout">'
        f"<b>{escape(e.robot.name or 'robot')}</b> &nbsp; {badge}<br>"
        f"{tube_colours(e.robot.n_tubes)}<br>{lines} {bar}"
        f'<span data-testid="snap distance">{snap_distance_text(e)}</span>'
        f'<span data-testid="certificate">{certificate_text(certificate)}</span></div>'
    )


def typed(value: float, digits: int) -> str:
    """Number for a text box, without trailing zeros."""
    # +0.0 turns -0 into 0.
    return f"{round(float(value), digits) + 0.0:.{digits}f}".rstrip("0").rstrip(".")


def tube_colours(n_tubes: int) -> str:
    """Legend of the colours of the tubes, innermost first."""
    marks = (
        f'<span style="color:{tube_colour(i)}">\N{BLACK CIRCLE}</span>\N{NO-BREAK SPACE}tube\N{NO-BREAK SPACE}{i + 1}'
        for i in range(n_tubes)
    )
    return f'<span data-testid="tubes">{" ".join(marks)}</span>'


def certificate_text(certificate: float | None) -> str:
    """Certificate at these translations, as text."""
    if certificate is None:
        return "certificate: …"
    if certificate > 0:
        return f"certificate {certificate:.3f}: cannot snap at any rotation here, unloaded"
    shown = f"{certificate:.3f}".replace("-", "\N{MINUS SIGN}")
    return f"certificate {shown}: not proved free of snaps"


def snap_distance_text(e: Equilibrium) -> str:
    """Proved snap distance, as text and a line break; "" where none is known, or where the certificate is positive.

    Under a load it takes too long for a page that follows the mouse: 0.1 to 0.5 s.
    """
    distance = known_distance(lambda: e.snap_distance) if e.load is None else None
    return (
        "" if distance is None or np.isinf(distance) else f"snap distance: at least {np.degrees(distance):.1f} deg<br>"
    )


def log_text(log: Sequence[SessionEvent]) -> str:
    """Log of events, latest first."""
    rows = [
        f'<li data-testid="event" value="{number}" style="{"color:#c81e1e" if event.snap else ""}">'
        f"{escape(event.text)}</li>"
        for number, event in reversed([*enumerate(log, start=1)][-SHOWN_EVENTS:])
    ]
    more = len(log) - len(rows)
    rows += [f"<li value='{more}'>and earlier ones</li>"] if more > 0 else []
    body = f'<ol reversed style="margin:0;padding-left:22px">{"".join(rows)}</ol>' if rows else "<i>nothing yet</i>"
    return f'<div style="{BOX};max-height:220px;overflow-y:auto" data-testid="log">{body}</div>'


def message_text(text: str, *, bad: bool = False) -> str:
    """Message to the user, a line for each sentence.

    Messages that are `bad` stay visible while the panel scrolls (`page.css`).
    """
    if not text:
        return '<div data-testid="message"></div>'
    role, colour = ("alert", "#c81e1e") if bad else ("status", "#3b6fb5")
    return (
        f'<div data-testid="message" role="{role}" style="{BOX};border-left:4px solid {colour};margin:2px 8px 8px">'
        f"{'<br>'.join(escape(line) for line in text.splitlines())}</div>"
    )


def ghost_text(ghosts: Sequence[Equilibrium]) -> str:
    """Number of other equilibria at these joint values, as text."""
    stable = sum(ghost.stable for ghost in ghosts)
    count = counted(len(ghosts), "other equilibrium", "other equilibria")
    kinds = f": {stable} stable (blue), {len(ghosts) - stable} unstable (red)" if ghosts else ""
    return f"{count} at these joint values{kinds}"


LEGEND = (
    ("rgb(200,30,30)", "the plate's x axis, 5 cm long"),
    ("rgb(30,150,60)", "its y axis"),
    ("rgb(40,80,200)", "its z axis, along which the arm leaves"),
    ("linear-gradient(90deg,{0},{1},{2})", "margin: 0, a snap, to 1"),
    ("rgb(70,110,190)", "other stable equilibria"),
    ("rgb(205,60,60)", "unstable ones"),
    ("#8888", "squares of the floor: 1 cm, and bold 10 cm"),
)
"""Colours of the scene and their meanings."""


def legend() -> str:
    """Legend of colours, axes and floor."""
    scale = [f"rgb{margin_colour(margin)}" for margin in (0.0, 0.5, 1.0)]
    rows = (
        f'<div><span style="display:inline-block;width:34px;height:9px;border-radius:3px;margin-right:8px;'
        f'background:{colour.format(*scale)}"></span>{escape(meaning)}</div>'
        for colour, meaning in LEGEND
    )
    return f'<div style="{BOX}" data-testid="legend">{"".join(rows)}</div>'


def keys_text(token: str, keys: str) -> str:
    """Note on the keys that move the tip, with the token of the robot for the script of the page."""
    return f'<div style="{BOX}" data-testid="hand" data-hand="{escape(token)}">{escape(keys)}</div>'


Change = Callable[[Session], Session | tuple[Session, str]]
"""Function that changes a session; it may also return the reason why it stopped early."""


class Commands(Protocol):
    """Commands of the page; every method returns at once."""

    def change(
        self, change: Change, *, dragged: int | str | None = None, key: str | None = None, pause: bool = True
    ) -> None:
        """Change the robot.

        Args:
            dragged: joint, or name of another control, that the user is dragging; all changes by one drag are one step
                of undo.
            key: a waiting change with the same key is dropped; by default the name of the dragged control.
            pause: True pauses the playback of a trajectory.
        """

    def undo(self) -> None:
        """Undo the last change of joint values, branch or tubes."""

    def move_tip(self, target: np.ndarray, *, released: bool) -> None:
        """Move the tip towards a target, m; `released` puts the target's mark back onto the tip."""

    def ghosts(self) -> None:
        """Show all other equilibria, or hide them."""

    def show(self, layer: str, on: bool) -> None:
        """Show or hide a layer: trail, workspace, obstacles, swept, target, hand, force, map, beside."""

    def cut(self, plane: Plane | None) -> None:
        """Show bodies up to a plane, with their cross-sections in it; None: whole bodies."""

    def load(self, what: str, name: str, content: bytes) -> None:
        """Load a file: a trajectory, obstacles, or a robot to compare."""

    def play(self) -> None:
        """Start or pause the playback."""

    def replay(self) -> None:
        """Play the recorded motion."""

    def look(self, side: str) -> None:
        """Move the camera to a side: side, front, above, corner."""

    def scrub(self, seconds: float) -> None:
        """Go to a time of the trajectory."""

    def save(self, what: str) -> None:
        """Send an export to the browser: joints, robot, recording, picture, page."""

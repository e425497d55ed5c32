"""The readout in HTML: tip, margin, energy, certificate, what happened. Everything from files is escaped."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from html import escape
from typing import Protocol

import numpy as np

from ...bodies.frames import Plane
from ...equilibrium.result import Equilibrium
from ..formatting import counted
from ..page import margin_colour, tube_colour
from ..quantities import Quantity, record
from .session import Event, Session

SHOWN_EVENTS = 12
"""The latest events are shown, the others counted."""

BOX = "font:12px/1.45 sans-serif;padding:2px 10px 6px"
BADGE = {"stable": "#009660", "close to a snap": "#b8860b", "snapped": "#c81e1e"}


SIDEBAR: tuple[Quantity[Equilibrium], ...] = (
    Quantity("tip_position_mm", "tip", form=".4f"),
    Quantity("energy_mJ", "energy", form=".4f"),
    Quantity("margin", "margin", form=".4f"),
)
"""Quantities of the shown equilibrium; a bar shows the last."""


def readout(session: Session, certificate: float | None) -> str:
    """State of the robot as text. `certificate` None: not computed yet."""
    e = session.equilibrium
    known = record(e, SIDEBAR)
    lines = "<br>".join(f'{q.about} <span data-testid="{q.about}">{q.number(known)}</span> {q.sign}' for q in SIDEBAR)
    # Negative margins, of unstable equilibria, have no bar.
    share = 100 * min(max(e.margin, 0.0), 1.0)
    state = session.verdict
    bar = (
        '<div style="height:9px;border-radius:4px;background:#8883;overflow:hidden">'
        f'<div style="width:{share:.1f}%;height:100%;background:rgb{margin_colour(e.margin)}"></div></div>'
    )
    badge = (
        f'<b data-testid="state" style="background:{BADGE[state]};color:white;border-radius:4px;padding:1px 7px">'
        f"{state}</b>"
    )
    return (
        f'<div style="{BOX}" data-testid="readout">'
        f"<b>{escape(e.robot.name or 'robot')}</b> &nbsp; {badge}<br>"
        f"{tube_colours(e.robot.n_tubes)}<br>{lines} {bar}"
        f'<span data-testid="certificate">{certificate_words(certificate)}</span></div>'
    )


def typed(value: float, digits: int) -> str:
    """A number as one would type it."""
    # Trailing zeros go; +0.0 turns -0 into 0.
    return f"{round(float(value), digits) + 0.0:.{digits}f}".rstrip("0").rstrip(".")


def tube_colours(n_tubes: int) -> str:
    """Colours of the tubes, the innermost first."""
    marks = (
        f'<span style="color:{tube_colour(i)}">\N{BLACK CIRCLE}</span>\N{NO-BREAK SPACE}tube\N{NO-BREAK SPACE}{i + 1}'
        for i in range(n_tubes)
    )
    return f'<span data-testid="tubes">{" ".join(marks)}</span>'


def certificate_words(certificate: float | None) -> str:
    """Certificate at these translations, as text."""
    if certificate is None:
        return "certificate: …"
    if certificate > 0:
        return f"certificate {certificate:.3f}: cannot snap at any rotation here, unloaded"
    shown = f"{certificate:.3f}".replace("-", "\N{MINUS SIGN}")
    return f"certificate {shown}: not proved free of snaps"


def log_words(log: Sequence[Event]) -> str:
    """Events, the latest first."""
    rows = [
        f'<li data-testid="event" value="{number}" style="{"color:#c81e1e" if event.snap else ""}">'
        f"{escape(event.text)}</li>"
        for number, event in reversed([*enumerate(log, start=1)][-SHOWN_EVENTS:])
    ]
    more = len(log) - len(rows)
    rows += [f"<li value='{more}'>and earlier ones</li>"] if more > 0 else []
    body = f'<ol reversed style="margin:0;padding-left:22px">{"".join(rows)}</ol>' if rows else "<i>nothing yet</i>"
    return f'<div style="{BOX};max-height:220px;overflow-y:auto" data-testid="log">{body}</div>'


def message_words(text: str, *, bad: bool = False) -> str:
    """Sentences to the user, each on a line of its own; none takes no room, `bad` ones stay in sight (`page.css`)."""
    if not text:
        return '<div data-testid="message"></div>'
    role, colour = ("alert", "#c81e1e") if bad else ("status", "#3b6fb5")
    return (
        f'<div data-testid="message" role="{role}" style="{BOX};border-left:4px solid {colour};margin:2px 8px 8px">'
        f"{'<br>'.join(escape(line) for line in text.splitlines())}</div>"
    )


def others_words(others: Sequence[Equilibrium]) -> str:
    """Number of other equilibria at these joint values, as text."""
    stable = sum(each.stable for each in others)
    many = counted(len(others), "other equilibrium", "other equilibria")
    kinds = f": {stable} stable (blue), {len(others) - stable} unstable (red)" if others else ""
    return f"{many} at these joint values{kinds}"


LEGEND = (
    ("rgb(200,30,30)", "the plate's x axis, 5 cm long"),
    ("rgb(30,150,60)", "its y axis"),
    ("rgb(40,80,200)", "its z axis, along which the arm leaves"),
    ("linear-gradient(90deg,{0},{1},{2})", "margin: 0, a snap, to 1"),
    ("rgb(70,110,190)", "other stable equilibria"),
    ("rgb(205,60,60)", "unstable ones"),
    ("#8888", "squares of the floor: 1 cm, and bold 10 cm"),
)
"""Colours of the scene, and what they mean."""


def legend() -> str:
    """Legend of colours, axes and floor."""
    scale = [f"rgb{margin_colour(margin)}" for margin in (0.0, 0.5, 1.0)]
    rows = (
        f'<div><span style="display:inline-block;width:34px;height:9px;border-radius:3px;margin-right:8px;'
        f'background:{colour.format(*scale)}"></span>{escape(words)}</div>'
        for colour, words in LEGEND
    )
    return f'<div style="{BOX}" data-testid="legend">{"".join(rows)}</div>'


def hand_words(word: str, keys: str) -> str:
    """Note on the keys that move the tip, with the id of the robot for the script of the page."""
    return f'<div style="{BOX}" data-testid="hand" data-hand="{escape(word)}">{escape(keys)}</div>'


Verb = Callable[[Session], Session | tuple[Session, str]]
"""Changes a session; it may also tell in words what stopped it."""


class Wishes(Protocol):
    """Commands of the page; every method returns at once."""

    def change(self, verb: Verb, *, held: int | str | None = None, key: str | None = None, pause: bool = True) -> None:
        """Do something to the robot.

        Args:
            held: the joint, or by a name the other thing, that the hand has and does not let go of.
            key: what waits under the same key is not done any more; by default a name that is held.
            pause: whether a trajectory that is being played pauses for it.
        """

    def undo(self) -> None:
        """Take the last change back: joint values, branch and tubes."""

    def lead(self, target: np.ndarray, *, done: bool) -> None:
        """Lead the tip towards a target, m; `done` puts the target's mark back onto the tip."""

    def ghosts(self) -> None:
        """Show all other equilibria, or hide them."""

    def show(self, layer: str, on: bool) -> None:
        """Show or hide a layer: trail, workspace, obstacles, swept, target, hand, force, map, beside."""

    def cut(self, plane: Plane | None) -> None:
        """Show bodies up to a plane, with what it cuts; None: all of them."""

    def load(self, what: str, name: str, content: bytes) -> None:
        """Take a file: a trajectory, bodies to keep clear of, the robot beside."""

    def play(self) -> None:
        """Start or pause the playback."""

    def replay(self) -> None:
        """Play the recording."""

    def look(self, side: str) -> None:
        """Look from a side: side, front, above, corner."""

    def scrub(self, seconds: float) -> None:
        """Go to a time of the trajectory."""

    def save(self, what: str) -> None:
        """Send an export to the browser: joints, robot, recording, picture, page."""

"""The server of the viewer: on this machine alone unless told otherwise, a robot of its own for every tab."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import resources
from types import FrameType
from typing import Any

from .export import page_title
from .host import LOCAL, Added, address_of, quiet_server
from .scene import look_from
from .tab import Tab
from .teleoperation import PATH, Hands
from .view import View

PORT = 8080


def serve(
    view: View,
    *,
    host: str = LOCAL,
    port: int = PORT,
    ready: Callable[[str], object] | None = None,
    stop: threading.Event | None = None,
) -> None:
    """Serve a view until `stop` is set, or until Ctrl-C or SIGTERM where this is the main thread.

    Args:
        host: address to listen on. Any but 127.0.0.1 lets others move the robot, and read what is shown.
        port: 0 takes any that is free.
        ready: called with the address of the page once it is served.

    Raises:
        InputError: the address or port cannot be had, viser is not installed, joint values that are not allowed.
        SolveError: no stable equilibrium to begin with.
    """
    first = view.session()
    over = stop or threading.Event()
    tabs: dict[int, Tab] = {}
    lock = threading.Lock()
    hands = Hands()
    added = Added(head(), PATH, hands.attend)
    with _signals(over), quiet_server(host, port, page_title(first), added) as server:
        look_from(server.initial_camera, first.equilibrium)
        # Red, green, blue: x, y, z of the plate, 5 cm long.
        server.scene.world_axes.visible = True
        server.gui.configure_theme(show_share_button=False, show_logo=False)

        def came(client: Any) -> None:
            tab = Tab(client, view, hands)
            with lock:
                if client.client_id in server.get_clients():
                    tabs[client.client_id] = tab
                    return
            tab.close()

        def left(client: Any) -> None:
            with lock:
                tab = tabs.pop(client.client_id, None)
            if tab is not None:
                tab.close()

        server.on_client_connect(came)
        server.on_client_disconnect(left)
        if ready is not None:
            ready(address_of(host, server.get_port()))
        try:
            over.wait()
        finally:
            with lock:
                for tab in tabs.values():
                    tab.close()


def head() -> str:
    """What the page looks like and runs beside viser."""
    files = resources.files(__package__)
    style, script = (files.joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "hand.js"))
    return f"<style>{style}</style><script>{script}</script>"


@contextmanager
def _signals(over: threading.Event) -> Iterator[None]:
    """End quietly on Ctrl-C and SIGTERM; elsewhere than in the main thread signals are not ours."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(number: int, frame: FrameType | None) -> None:
        over.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

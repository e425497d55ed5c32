"""The server of the viewer: on this machine alone unless told otherwise, a robot of its own for every tab."""

from __future__ import annotations

import signal
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http import HTTPStatus
from pathlib import Path
from types import FrameType
from typing import Any

from ..errors import InputError
from ..obstacles import Obstacle
from ..robots.assembly import Array
from ..robots.robot import Robot
from .reel import Waypoints
from .session import Session, open_session

LOCAL = "127.0.0.1"
LOCAL_NAMES = ("127.0.0.1", "localhost", "::1")
"""Under what a browser on this machine may ask for the page."""

PORT = 8080


@dataclass(frozen=True, eq=False)
class View:
    """What to show.

    Args:
        robot: in every tab, from `rotations`, `translations` (n,) rad and m; by default from home.
        obstacles: drawn, and kept away from when the tip is dragged.
        waypoints: of a trajectory to be played, or None.
        min_margin: to keep when the tip is dragged; the slider's first value.
        out: directory into which exports are saved besides being sent to the browser.
    """

    robot: Robot
    rotations: Array | None = None
    translations: Array | None = None
    obstacles: tuple[Obstacle, ...] = ()
    waypoints: Waypoints | None = None
    min_margin: float = 0.05
    out: Path | None = None

    def session(self) -> Session:
        """A new session; raises InputError and SolveError as `open_session` does."""
        return open_session(self.robot, self.rotations, self.translations)


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
    from .desk import Desk

    first = view.session()
    over = stop or threading.Event()
    desks: dict[int, Desk] = {}
    lock = threading.Lock()
    with _signals(over), quiet_server(host, port) as server:
        _frame_camera(server, first)

        def came(client: Any) -> None:
            desk = Desk(client, view)
            with lock:
                if client.client_id in server.get_clients():
                    desks[client.client_id] = desk
                    return
            desk.close()

        def left(client: Any) -> None:
            with lock:
                desk = desks.pop(client.client_id, None)
            if desk is not None:
                desk.close()

        server.on_client_connect(came)
        server.on_client_disconnect(left)
        if ready is not None:
            ready(f"http://{LOCAL if host in ('', '0.0.0.0') else host}:{server.get_port()}")
        try:
            over.wait()
        finally:
            with lock:
                for desk in desks.values():
                    desk.close()


def _frame_camera(server: Any, session: Session) -> None:
    from .scene import camera

    position, look_at = camera(session.equilibrium)
    server.initial_camera.position = tuple(position)
    server.initial_camera.look_at = tuple(look_at)
    server.gui.configure_theme(show_share_button=False, show_logo=False)


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


@contextmanager
def quiet_server(host: str, port: int) -> Iterator[Any]:
    """A viser server that says nothing on the terminal, hands itself to no relay, and answers to its own page alone.

    Raises:
        InputError: viser is not installed, the address is none of this machine's, the port is taken.
    """
    try:
        import rich
        import viser
    except ImportError:
        raise InputError("the viewer needs viser: python -m pip install 'tubeopt[view]'") from None
    _bind(host, port)
    console = rich.get_console()
    loud, console.quiet = console.quiet, True
    try:
        with _own_page_alone(host):
            server = viser.ViserServer(host=host, port=port, verbose=False)
        # viser's relay would put the page on the public internet at the press of a key.
        server.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
        try:
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = loud


def _bind(host: str, port: int) -> None:
    """Raise InputError where the address or port cannot be had; viser would take another port without a word."""
    if not 0 <= port <= 65535:
        raise InputError(f"port is {port}; it must be from 0 to 65535 (0 takes any that is free)")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"cannot listen on {host}, port {port}: {why}; choose another --port, or 0 for any") from None


@contextmanager
def _own_page_alone(host: str) -> Iterator[None]:
    """Have the server that is made meanwhile refuse requests that other pages in the same browser make.

    viser checks neither the host that a browser believes to talk to nor the page that opens a websocket: any site that
    is open in another tab could move the robot. There is no setting for it, so the server's maker is wrapped.
    """
    import websockets.asyncio.server as library

    make = library.serve

    def guarded(handler: Any, address: str, port: int, *, process_request: Any, **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            if not is_own(request.headers.get("Host", ""), request.headers.get("Origin"), host):
                return connection.respond(HTTPStatus.FORBIDDEN, "tubeopt view answers to its own page alone\n")
            return process_request(connection, request)

        return make(handler, address, port, process_request=answer, **options)

    library.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        library.serve = make  # type: ignore[misc]


def is_own(host_header: str, origin: str | None, host: str) -> bool:
    """Whether a request is from the server's own page: right host, and origin the same where the browser tells one."""
    if origin is not None and origin.split("://", 1)[-1] != host_header:
        return False
    name = host_header.rsplit(":", 1)[0].strip("[]")
    return name in LOCAL_NAMES if host in LOCAL_NAMES else True

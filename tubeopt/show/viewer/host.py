"""A viser server that listens where it is told to, and answers to its own page alone."""

from __future__ import annotations

import logging
import socket
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from html import escape
from http import HTTPStatus
from typing import Any

from ...errors import InputError

logging.getLogger("websockets").addHandler(logging.NullHandler())  # a traceback for each client that is none

UNTITLED = b"<title>Viser</title>"

LOCAL = "127.0.0.1"
LOCAL_NAMES = ("127.0.0.1", "localhost", "::1")
"""Under what a browser on this machine may ask for the page."""


@dataclass(frozen=True)
class Added:
    """What a server has that viser has not."""

    head: str
    """HTML, at the end of the head of its page."""
    path: str
    """Of a socket."""
    attend: Callable[[Any], Awaitable[None]]
    """Does what the messages of the socket say."""


@contextmanager
def quiet_server(host: str, port: int, title: str = "tubeopt", added: Added | None = None) -> Iterator[Any]:
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
        with _own_page_alone(host, title, added):
            server = viser.ViserServer(host=host, port=port, verbose=False)
        # viser's relay would put the page on the public internet at the press of a key.
        server.request_share_url = lambda verbose=True: None  # type: ignore[method-assign]
        try:
            yield server
        finally:
            server.stop()
    finally:
        console.quiet = loud


def address_of(host: str, port: int) -> str:
    """Where a browser on this machine finds the page."""
    if host in ("0.0.0.0", "::"):
        host = LOCAL if host == "0.0.0.0" else "::1"
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


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
def _own_page_alone(host: str, title: str, added: Added | None) -> Iterator[None]:
    """Have the server that is made meanwhile refuse requests that other pages in the same browser make.

    viser checks neither the host that a browser believes to talk to nor the page that opens a websocket: any site that
    is open in another tab could move the robot. There is no setting for it, nor for the page's title, so the server's
    maker is wrapped.
    """
    import websockets.asyncio.server as library
    from websockets.exceptions import ConnectionClosed

    make = library.serve

    def guarded(handler: Any, address: str, port: int, *, process_request: Any, **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            if not is_own(request.headers.get("Host", ""), request.headers.get("Origin"), host):
                return connection.respond(HTTPStatus.FORBIDDEN, "tubeopt view answers to its own page alone\n")
            if request.path.split("?")[0] in ("/", "/index.html"):
                with suppress(KeyError):  # not every client sends it
                    del request.headers["Accept-Encoding"]
                return titled(process_request(connection, request), title, "" if added is None else added.head)
            return process_request(connection, request)

        async def handle(connection: Any) -> None:
            if added is not None and connection.request.path == added.path:
                with suppress(ConnectionClosed):
                    await added.attend(connection)
            else:
                await handler(connection)

        return make(handle, address, port, process_request=answer, **options)

    library.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        library.serve = make  # type: ignore[misc]


def titled(response: Any, title: str, head: str = "") -> Any:
    """A response of the server with the page's title in place of viser's, and more in its head; None, for a websocket,
    stays None."""
    if response is not None and UNTITLED in response.body:
        page = titled_page(response.body.decode(), title)
        response.body = page.replace("</head>", f"{head}</head>", 1).encode()
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
    return response


def titled_page(page: str, title: str) -> str:
    """The text of a page of viser's with another title."""
    return page.replace(UNTITLED.decode(), f"<title>{escape(title)}</title>", 1)


def is_own(host_header: str, origin: str | None, host: str) -> bool:
    """Whether a request is from the server's own page: right host, and origin the same where the browser tells one."""
    if origin is not None and origin.split("://", 1)[-1] != host_header:
        return False
    name = host_header.rsplit(":", 1)[0].strip("[]")
    return name in LOCAL_NAMES if host in LOCAL_NAMES else True

"""The page of the viewer: served from the background, and saved as a file that plays by itself."""

from __future__ import annotations

import io
import logging
import socket
from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from html import escape
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...equilibrium.readings import to_readings
from ...errors import InputError
from ...files.files import atomic_write
from ...files.units import DEG, MM, in_unit
from ...files.yaml_file import to_yaml
from ...planning import ArmsPlan
from ...planning.trajectory import branch_line, timed_csv
from ...robots.file import robot_to_yaml
from ..surfaces import Part, plate_part, plate_radius
from .scene import SCALE, ViewerScene, look_from, obstacle_parts
from .session import Session
from .view import recorded

logging.getLogger("websockets").addHandler(logging.NullHandler())  # a traceback for each client that is none

UNTITLED = b"<title>Viser</title>"

LOCAL = "127.0.0.1"
LOCAL_NAMES = ("127.0.0.1", "localhost", "::1")
"""Names of this machine in requests of a local browser."""


@dataclass(frozen=True)
class AddedHandler:
    """HTML and web socket that are added to the server of viser."""

    head: str
    """HTML, at the end of the head of its page."""
    path: str
    """Path of a socket."""
    attend: Callable[[Any], Awaitable[None]]
    """Task that handles the messages of the socket."""


@contextmanager
def quiet_server(host: str, port: int, title: str = "tubeopt", added: AddedHandler | None = None) -> Iterator[Any]:
    """Server of viser without output on the terminal and without a relay, for requests of its own page only.

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
    # viser prints its address and clients on the console of rich, which is shared by the process.
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
    """Address of the page for a browser on this machine."""
    if host in ("0.0.0.0", "::"):
        # "Any address" is for listening; a browser cannot open it.
        host = LOCAL if host == "0.0.0.0" else "::1"
    # Brackets part the colons of an IPv6 address from that of the port.
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def _bind(host: str, port: int) -> None:
    """Raise InputError if the address or port is not available; viser would silently use another port."""
    if not 0 <= port <= 65535:
        raise InputError(f"port is {port}; it must be from 0 to 65535 (0 takes any that is free)")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            # A server that has just ended leaves its port waiting for a minute.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(address)
    except OSError as error:
        why = error.strerror or error
        raise InputError(f"cannot listen on {host}, port {port}: {why}; choose another --port, or 0 for any") from None


@contextmanager
def _own_page_alone(host: str, title: str, added: AddedHandler | None) -> Iterator[None]:
    """Context that makes the new server refuse requests of other pages in the same browser."""
    import websockets.asyncio.server as library
    from websockets.exceptions import ConnectionClosed

    # viser checks neither the host that a browser believes to talk to nor the page that opens a websocket.
    # Any site that is open in another tab could move the robot (DNS rebinding, cross-site WebSocket hijacking).
    # There is no setting for it, nor for the page's title, so the server's maker is wrapped.
    make = library.serve

    def guarded(handler: Any, address: str, port: int, *, process_request: Any, **options: Any) -> Any:
        def answer(connection: Any, request: Any) -> Any:
            if not is_own(request.headers.get("Host", ""), request.headers.get("Origin"), host):
                return connection.respond(HTTPStatus.FORBIDDEN, "tubeopt view answers to its own page alone\n")
            if request.path.split("?")[0] in ("/", "/index.html"):
                # Compressed, the page could not be given its title and script.
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
    """Response of the server with the page's title instead of viser's, and with `head` added to its head.

    A response None, for a websocket, is returned unchanged.
    """
    if response is not None and UNTITLED in response.body:
        page = titled_page(response.body.decode(), title)
        response.body = page.replace("</head>", f"{head}</head>", 1).encode()
        del response.headers["Content-Length"]
        # Headers of this library are a multimap: set without being deleted, there would be two lengths.
        response.headers["Content-Length"] = str(len(response.body))
    return response


def titled_page(page: str, title: str) -> str:
    """Text of an HTML page of viser with another title."""
    return page.replace(UNTITLED.decode(), f"<title>{escape(title)}</title>", 1)


def is_own(host_header: str, origin: str | None, host: str) -> bool:
    """True for a request from the server's own page: right host, and same origin if the browser sends one."""
    # Browsers send the origin with every websocket, other programs none: these are not the danger.
    if origin is not None and origin.split("://", 1)[-1] != host_header:
        return False
    # Without the port, and without the brackets of an IPv6 address.
    name = host_header.rsplit(":", 1)[0].strip("[]")
    return name in LOCAL_NAMES if host in LOCAL_NAMES else True


def joints_yaml(session: Session) -> str:
    """YAML text of joint values with the keys rotations_deg and translations_mm, as `tubeopt ik --from` reads them.

    For a robot with a calibration the values are readings.
    """
    equilibrium = session.equilibrium
    rotations, translations = to_readings(session.robot, equilibrium.rotations, equilibrium.translations)
    data = {
        "rotations_deg": [in_unit(x, DEG) for x in rotations.tolist()],
        "translations_mm": [in_unit(x, MM) for x in translations.tolist()],
    }
    return to_yaml(data, f"Joint values of {session.robot.name or 'a robot'}.")


def recording_csv(session: Session) -> str:
    """Recorded joint values with times and the branch at the start, in the format of `load_trajectory`.

    The robot passes them at constant speed of its fastest tube: the times at which a hand moved sliders mean nothing.

    Raises:
        InputError: as `recorded`.
    """
    waypoints = recorded(session)
    assert waypoints.start is not None
    comment = [f"A recording of {session.robot.name or 'a robot'}.", branch_line(waypoints.start)]
    return timed_csv(waypoints.time, *to_readings(session.robot, waypoints.rotations, waypoints.translations), comment)


def png(picture: np.ndarray) -> bytes:
    """An image (h, w, 3 or 4) of 0 to 255 as PNG, on white."""
    from PIL import Image

    image = Image.fromarray(np.asarray(picture, dtype=np.uint8))
    if image.mode == "RGBA":
        # The background is transparent, which some programs show as black.
        white = Image.new("RGBA", image.size, (255, 255, 255, 255))
        image = Image.alpha_composite(white, image).convert("RGB")
    out = io.BytesIO()
    image.save(out, "PNG")
    return out.getvalue()


FRAMES = 48
"""Pictures of the motion of several robots."""

REST = 1.0
"""Time, s, that the ends of that motion are shown."""


def page_title(session: Session) -> str:
    """Title of the page of a session."""
    return f"{session.robot.name or 'robot'}, tubeopt"


def scene_html(session: Session, layers: Mapping[str, Sequence[Part]], *, trail: bool = True) -> str:
    """A page that shows the scene, with layers, without any server or network: to be turned and zoomed, not moved."""
    with quiet_server("127.0.0.1", 0) as server:
        look_from(server.initial_camera, session.equilibrium)
        server.scene.world_axes.visible = True
        scene = ViewerScene(server.scene)
        scene.set_stage(session.equilibrium)
        scene.show(session.equilibrium)
        scene.show_trail(session, trail)
        for name, parts in layers.items():
            scene.layer(name, parts)
        return titled_page(str(server.scene.as_html()), page_title(session))


def arms_page(plan: ArmsPlan) -> str:
    """Motions of a plan as a page that plays by itself, without server or network.

    The view can be turned and zoomed; it shows all arms and bodies in their common frame. Raises InputError without
    viser.
    """
    names = " and ".join(arm.called for arm in plan.arms)
    with quiet_server("127.0.0.1", 0) as server:
        # All arms must be in sight.
        longest = max((each.end for each in plan.trajectories), key=lambda e: float(e.arc_length[-1]))
        look_from(server.initial_camera, longest, far=1.3)
        reach = max(tube.length for arm in plan.arms for tube in arm.robot.tubes)
        ViewerScene(server.scene).layer("obstacles", obstacle_parts(plan.obstacles, reach))
        scenes = []
        for k, (arm, motion) in enumerate(zip(plan.arms, plan.trajectories, strict=True)):
            wxyz = Rotation.from_matrix(arm.base.axes).as_quat(scalar_first=True)
            prefix = f"/arm_{k + 1}"
            server.scene.add_frame(prefix, show_axes=False, wxyz=tuple(wxyz), position=tuple(arm.base.origin * SCALE))
            server.scene.add_label(f"{prefix}/name", arm.called)
            scenes.append(ViewerScene(server.scene, prefix))
            scenes[-1].layer(f"{prefix[1:]}/plate", [plate_part(plate_radius(motion.start))])
            scenes[-1].show(motion.start)
        film = server.get_scene_serializer()
        film.insert_sleep(REST)
        # The first instant is there already, in the scenes as they were built.
        for t in np.linspace(0.0, plan.duration, FRAMES)[1:]:
            for scene, motion, row in zip(scenes, plan.trajectories, plan.rows_at(float(t)), strict=True):
                scene.show(motion.arms[row])
            film.insert_sleep(plan.duration / FRAMES)
        film.insert_sleep(REST)
        return titled_page(str(film.as_html()), f"{names}, tubeopt")


def exported(what: str, session: Session, scene: ViewerScene, client: Any, *, trail: bool) -> tuple[str, bytes]:
    """File name and content of an export: joints, robot, recording, picture, page."""
    if what == "joints":
        return "joints.yaml", joints_yaml(session).encode()
    if what == "robot":
        return "robot.yaml", robot_to_yaml(session.robot).encode()
    if what == "recording":
        return "trajectory.csv", recording_csv(session).encode()
    if what == "picture":
        camera = client.camera
        height, width = min(camera.image_height, 1600), min(camera.image_width, 2400)
        return "view.png", png(client.get_render(height, width, transport_format="png", timeout=60))
    return "view.html", scene_html(session, scene.contents, trail=trail).encode()


def saved(what: str, session: Session, scene: ViewerScene, client: Any, *, trail: bool, out: Path | None) -> str:
    """Message after sending an export to the browser, and saving it into an optional directory.

    Raises:
        InputError, RuntimeError, OSError: it cannot be made, or not be saved.
    """
    name, content = exported(what, session, scene, client, trail=trail)
    if out is not None:
        with atomic_write(out / name) as temporary:
            temporary.write_bytes(content)
    client.send_file_download(name, content, save_immediately=True)
    return f"saved {name}"

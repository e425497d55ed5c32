"""What leaves the viewer: joint values, a recorded trajectory, the robot, a picture, a page for a colleague."""

from __future__ import annotations

import io
import tempfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...equilibrium.readings import to_readings
from ...errors import InputError
from ...files.files import atomic_write
from ...files.units import DEG, MM, in_unit
from ...files.yaml_file import save_yaml
from ...planning.file import branch_line, timed_csv
from ...robots.file import save_robot
from ...robots.robot import Robot
from ..arm_surfaces import Part
from .host import quiet_server, titled_page
from .playback import passed
from .scene import Scene, look_from
from .session import Session


def joints_yaml(session: Session) -> str:
    """Joint values (readings, of a robot with a calibration) with the keys rotations_deg and translations_mm, as
    `tubeopt ik --from` reads them."""
    here = session.equilibrium
    rotations, translations = to_readings(session.robot, here.rotations, here.translations)
    data = {
        "rotations_deg": [in_unit(x, DEG) for x in rotations.tolist()],
        "translations_mm": [in_unit(x, MM) for x in translations.tolist()],
    }
    return _text(lambda path: save_yaml(path, data, f"Joint values of {session.robot.name or 'a robot'}."), ".yaml")


def robot_yaml(robot: Robot) -> str:
    """The robot as `load_robot` reads it."""
    return _text(lambda path: save_robot(robot, path), ".yaml")


def recording_csv(session: Session) -> str:
    """The recorded joint values with times, and with the branch on which they begin, as `load_trajectory` reads them.

    The robot passes them at constant speed of its fastest tube: the times at which a hand moved sliders mean nothing.

    Raises:
        InputError: nothing was recorded.
    """
    start = session.recorded_from
    if start is None or session.recording is None or len(session.recording) < 2:
        raise InputError("nothing is recorded: switch recording on and move the robot first")
    way = passed(session)
    comment = [f"A recording of {session.robot.name or 'a robot'}.", branch_line(start)]
    return timed_csv(way.time, *to_readings(session.robot, way.rotations, way.translations), comment)


def _text(write: Callable[[Path], None], suffix: str) -> str:
    """What `write` writes into a file."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / f"file{suffix}"
        write(path)
        return path.read_text(encoding="utf-8")


def png(picture: np.ndarray) -> bytes:
    """An image (h, w, 3 or 4) of 0 to 255 as PNG, on white."""
    from PIL import Image

    image = Image.fromarray(np.asarray(picture, dtype=np.uint8))
    if image.mode == "RGBA":
        white = Image.new("RGBA", image.size, (255, 255, 255, 255))
        image = Image.alpha_composite(white, image).convert("RGB")
    out = io.BytesIO()
    image.save(out, "PNG")
    return out.getvalue()


def page_title(session: Session) -> str:
    """What the page of a session is called."""
    return f"{session.robot.name or 'robot'}, tubeopt"


def scene_html(session: Session, layers: Mapping[str, Sequence[Part]], *, trail: bool = True) -> str:
    """A page that shows the scene, with layers, without any server or network: to be turned and zoomed, not moved."""
    with quiet_server("127.0.0.1", 0) as server:
        look_from(server.initial_camera, session.equilibrium)
        server.scene.world_axes.visible = True
        scene = Scene(server.scene)
        scene.set_stage(session.equilibrium)
        scene.show(session.equilibrium)
        scene.show_trail(session, trail)
        for name, parts in layers.items():
            scene.layer(name, parts)
        return titled_page(str(server.scene.as_html()), page_title(session))


def exported(what: str, session: Session, scene: Scene, client: Any, *, trail: bool) -> tuple[str, bytes]:
    """File name and content of an export: joints, robot, recording, picture, page."""
    if what == "joints":
        return "joints.yaml", joints_yaml(session).encode()
    if what == "robot":
        return "robot.yaml", robot_yaml(session.robot).encode()
    if what == "recording":
        return "trajectory.csv", recording_csv(session).encode()
    if what == "picture":
        seen = client.camera
        height, width = min(seen.image_height, 1600), min(seen.image_width, 2400)
        return "view.png", png(client.get_render(height, width, transport_format="png", timeout=60))
    return "view.html", scene_html(session, scene.contents, trail=trail).encode()


def saved(what: str, session: Session, scene: Scene, client: Any, *, trail: bool, out: Path | None) -> str:
    """Send an export to the browser, and save it into a directory if there is one; what is to be said of it.

    Raises:
        InputError, RuntimeError, OSError: it cannot be made, or not be saved.
    """
    name, content = exported(what, session, scene, client, trail=trail)
    if out is not None:
        with atomic_write(out / name) as temporary:
            temporary.write_bytes(content)
    client.send_file_download(name, content, save_immediately=True)
    return f"saved {name}"

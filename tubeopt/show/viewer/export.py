"""What leaves the viewer: joint values, a recorded trajectory, the robot, a picture, a page for a colleague; and a page
on which several robots move past each other."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from ...equilibrium.readings import to_readings
from ...files.files import atomic_write
from ...files.units import DEG, MM, in_unit
from ...files.yaml_file import to_yaml
from ...planning import ArmsPlan
from ...planning.trajectory import branch_line, timed_csv
from ...robots.file import robot_to_yaml
from ..arm_surfaces import Part, plate_part, plate_radius
from .host import quiet_server, titled_page
from .playback import recorded
from .scene import SCALE, Scene, look_from, obstacle_parts
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
    return to_yaml(data, f"Joint values of {session.robot.name or 'a robot'}.")


def recording_csv(session: Session) -> str:
    """The recorded joint values with times, and with the branch on which they begin, as `load_trajectory` reads them.

    The robot passes them at constant speed of its fastest tube: the times at which a hand moved sliders mean nothing.

    Raises:
        InputError: as `recorded`.
    """
    way = recorded(session)
    assert way.start is not None
    comment = [f"A recording of {session.robot.name or 'a robot'}.", branch_line(way.start)]
    return timed_csv(way.time, *to_readings(session.robot, way.rotations, way.translations), comment)


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


FRAMES = 48
"""Pictures of the motion of several robots."""

REST = 1.0
"""Seconds for which the ends of that motion stand still."""


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


def arms_page(plan: ArmsPlan) -> str:
    """The motions of a plan as a page that plays by itself, without any server or network, to be turned and zoomed: all
    arms and bodies in the frame that they share. Raises InputError where viser is not installed."""
    names = " and ".join(arm.called for arm in plan.arms)
    with quiet_server("127.0.0.1", 0) as server:
        longest = max((each.end for each in plan.trajectories), key=lambda e: float(e.arc_length[-1]))
        look_from(server.initial_camera, longest, far=1.3)
        reach = max(tube.length for arm in plan.arms for tube in arm.robot.tubes)
        Scene(server.scene).layer("obstacles", obstacle_parts(plan.obstacles, reach))
        scenes = []
        for k, (arm, motion) in enumerate(zip(plan.arms, plan.trajectories, strict=True)):
            turn = Rotation.from_matrix(arm.base.axes).as_quat(scalar_first=True)
            place = f"/arm_{k + 1}"
            server.scene.add_frame(place, show_axes=False, wxyz=tuple(turn), position=tuple(arm.base.origin * SCALE))
            server.scene.add_label(f"{place}/name", arm.called)
            scenes.append(Scene(server.scene, place))
            scenes[-1].layer(f"{place[1:]}/plate", [plate_part(plate_radius(motion.start))])
            scenes[-1].show(motion.start)
        film = server.get_scene_serializer()
        film.insert_sleep(REST)
        for t in np.linspace(0.0, plan.duration, FRAMES)[1:]:
            for scene, motion, row in zip(scenes, plan.trajectories, plan.rows_at(float(t)), strict=True):
                scene.show(motion.arms[row])
            film.insert_sleep(plan.duration / FRAMES)
        film.insert_sleep(REST)
        return titled_page(str(film.as_html()), f"{names}, tubeopt")


def exported(what: str, session: Session, scene: Scene, client: Any, *, trail: bool) -> tuple[str, bytes]:
    """File name and content of an export: joints, robot, recording, picture, page."""
    if what == "joints":
        return "joints.yaml", joints_yaml(session).encode()
    if what == "robot":
        return "robot.yaml", robot_to_yaml(session.robot).encode()
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

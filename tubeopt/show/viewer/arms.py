"""A page on which several robots move past each other: it plays by itself, without server or network."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np
import scipy

from ...files.files import write_text
from ...planning import ArmsPlan
from ..arm_surfaces import plate_part, plate_radius
from .host import quiet_server, titled_page
from .scene import SCALE, Scene, look_from, obstacle_parts

FRAMES = 48
"""Pictures of the motion."""

REST = 1.0
"""Seconds for which the ends of the motion stand still."""


def arms_page(plan: ArmsPlan, *, frames: int = FRAMES) -> str:
    """The motions of a plan as a page to be turned and zoomed while it plays, all arms and bodies in the frame that
    they share."""
    names = " and ".join(arm.called for arm in plan.arms)
    with quiet_server("127.0.0.1", 0) as server:
        longest = max((each.end for each in plan.trajectories), key=lambda e: float(e.arc_length[-1]))
        look_from(server.initial_camera, longest, far=1.3)
        reach = max(tube.length for arm in plan.arms for tube in arm.robot.tubes)
        Scene(server.scene).layer("obstacles", obstacle_parts(plan.obstacles, reach))
        scenes = []
        for k, (arm, motion) in enumerate(zip(plan.arms, plan.trajectories, strict=True)):
            turn = scipy.spatial.transform.Rotation.from_matrix(arm.base.axes).as_quat(scalar_first=True)
            place = f"/arm_{k + 1}"
            server.scene.add_frame(place, show_axes=False, wxyz=tuple(turn), position=tuple(arm.base.origin * SCALE))
            server.scene.add_label(f"{place}/name", arm.called)
            scenes.append(Scene(server.scene, place))
            scenes[-1].layer(f"{place[1:]}/plate", [plate_part(plate_radius(motion.start))])
            scenes[-1].show(motion.start)
        film = server.get_scene_serializer()
        film.insert_sleep(REST)
        for t in np.linspace(0.0, plan.duration, frames)[1:]:
            for scene, motion, row in zip(scenes, plan.trajectories, plan.rows_at(float(t)), strict=True):
                scene.show(motion.arms[row])
            film.insert_sleep(plan.duration / frames)
        film.insert_sleep(REST)
        return titled_page(str(film.as_html()), f"{names}, tubeopt")


def save_arms_page(plan: ArmsPlan, path: str | PathLike[str]) -> Path:
    """Write the page of `arms_page`.

    Raises:
        InputError: viser is not installed, or the file cannot be written.
    """
    write_text(path, arms_page(plan))
    return Path(path)

"""Loads in the C library of a robot: the compiled kernel of loaded arms, with the robot's numbers and its mesh."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import ceil

import casadi as ca
import numpy as np

from .. import __version__
from ..block.transcription.mesh import BEND_PER_PIECE, LOADED_WAVES, loaded_counts
from ..constants import GRAVITY
from ..equilibrium.kinematics import forward_kinematics
from ..errors import InputError, SolveError
from ..physics.certificate import coupling_rate_function
from ..robots.assembly import ROUND_OFF
from ..robots.load import Load, masses
from ..robots.order import SAME_END
from ..robots.robot import Robot
from ..solvers.compiled.constants import piece_constants
from ..solvers.compiled.library import MOST_CUTS
from ..solvers.compiled.loaded import MOST_PIECES, loaded_text
from ..solvers.compiled.text import HERE, defined, numbers, with_included
from ..typing import Array
from .c_text import C_FOLDER, HUSHED, pieces_text, tubes_text

SEEN = re.compile(r"^(size_t (?:workspace|answer)_size|int solve_loaded|void solve_many_loaded)", re.MULTILINE)
"""What the kernel shows to Python."""

BEARABLE, SPARE = 10.0, 1.25
"""Forces up to this times the stiffness of the tip over the square of the length have room on meshes of tubes made of
pieces: they bend arms by more than half a circle; and by how much more room there is than some configurations need."""


def loads_source(robot: Robot, name: str, shifts: Sequence[Array]) -> str:
    """The C text of `tubeopt_load.c`; `shifts`: translations (n,) of some configurations."""
    home = robot.assembly(robot.home_translations)
    if home.eccentric:
        raise InputError("loads are requested; loads on eccentric robots are not supported")
    mass, n = masses(robot.tubes, Load(gravity=(0.0, 0.0, -GRAVITY))), robot.n_tubes
    pieces = _room(robot, shifts) if home.general else MOST_PIECES
    data = f"{pieces_text(robot)}static const Tubes ROBOT = {tubes_text(robot)};\n"
    return loads_text(name, n, f"{data}static const double MASS[] = {{{numbers(mass)}}};\n", pieces)


def loads_text(name: str, n: int, data: str, pieces: int = MOST_PIECES) -> str:
    """The same of n tubes with room for so many pieces of mesh; `data` has PIECES, ROBOT and MASS as C."""
    generator = ca.CodeGenerator("mechanics_of_loads.c")
    generator.add(coupling_rate_function(n))
    defines = {
        "ECCENTRIC": 0,
        "MOST_SECTIONS": pieces,
        "MOST_CUTS": MOST_CUTS,
        "ROUND_OFF_LENGTH": ROUND_OFF,
        "SAME_END": SAME_END,
        "WAVES_PER_ELEMENT": 1,  # of what is not loaded: not asked for
        "LOADED_WAVES": LOADED_WAVES,
        "BEND_PER_PIECE": BEND_PER_PIECE,
    }
    kernel = SEEN.sub(r"static \1", loaded_text(n, generator, pieces))
    parts = [
        f"/* {name} under load: made by tubeopt {__version__}; see the header. */\n",
        f'#include "tubeopt_robot.h"\n\n{HUSHED}',
        kernel,
        defined(defines),
        piece_constants(),
        with_included(HERE / "pieces.c"),
        with_included(HERE / "layout.c"),
        data,
        (C_FOLDER / "bear.c").read_text(),
    ]
    return "".join(parts)


def _room(robot: Robot, shifts: Sequence[Array]) -> int:
    """Pieces of the mesh of tubes made of pieces at most, at translations (n,) and others, under what they can bear."""
    most = MOST_PIECES
    for shift in shifts:
        assembly = robot.assembly(shift)
        length = assembly.total_length
        tip = np.array([length * (1 - ROUND_OFF)])
        bearable = BEARABLE * float(assembly.cross_sections(tip, tip).stiffness.sum()) / max(length, ROUND_OFF) ** 2
        most = max(most, ceil(SPARE * loaded_counts(assembly, bearable, 0.0).sum()))
    return most


def loaded_cases(robot: Robot, cases: Sequence[Array]) -> list[Array]:
    """(2n + 10,) joints, force, gravity, tip position and margin of configurations under load, from rows that begin
    with the joints: a force that shifts the tip by 2 % of the arm, and the weight."""
    n, found, random = robot.n_tubes, [], np.random.default_rng(0)
    down = np.array([0.0, 0.0, -GRAVITY])
    for case in cases:
        rotations, translations = case[:n], case[n : 2 * n]
        light = forward_kinematics(robot, rotations, translations, load=Load(gravity=tuple(down)))
        assert light.compliance is not None
        push = random.normal(size=3)
        push *= 0.02 * light.arc_length[-1] / np.linalg.norm(light.compliance[:3, :3] @ push)
        try:
            load = Load(force=tuple(push), gravity=tuple(down))
            pose = forward_kinematics(robot, rotations, translations, load=load)
        except SolveError:
            continue
        found.append(np.concatenate([rotations, translations, push, down, pose.tip_position, [pose.margin]]))
    return found

"""Loads in the C library of a robot: the compiled kernel of loaded arms, with the robot's numbers and its mesh."""

from __future__ import annotations

import re
from collections.abc import Sequence

import casadi as ca
import numpy as np

from .. import __version__
from ..block.transcription.collocated import ENDS
from ..block.transcription.mesh import BEND_PER_PIECE, LOADED_WAVES
from ..block.transcription.tableau import tableau
from ..equilibrium.kinematics import forward_kinematics
from ..errors import InputError, SolveError
from ..physics.certificate import coupling_rate_function
from ..robots.assembly import ROUND_OFF
from ..robots.load import Load, masses
from ..robots.robot import Robot
from ..solvers.compiled.loaded import CHECK_DEGREE, DEGREE, ROUGH_DEGREE, loaded_text
from ..solvers.compiled.text import HERE, numbers, static_table, with_included
from ..typing import Array
from .c_text import C_FOLDER, tubes_text

SEEN = re.compile(r"^(size_t (?:workspace|answer)_size|int solve_loaded|void solve_many_loaded)", re.MULTILINE)
"""What the kernel shows to Python."""

RULE = """
typedef struct {
    long long degree;
    const double *nodes, *weights, *matrix, *basis, *once, *twice;
} Rule;
"""
"""Points per piece, and what does not depend on the robot: of the answer, of the growing of the load, of the check."""


def loads_source(robot: Robot, name: str) -> str:
    """The C text of `tubeopt_load.c`.

    Raises:
        InputError: tubes made of pieces or off the centreline, or of unknown weight.
    """
    home = robot.assembly(robot.home_translations)
    if home.eccentric or home.general:
        raise InputError(
            "loads are asked for; in C they are for concentric tubes that are straight, then one arc each: "
            "forward_kinematics(..., load=) solves for tubes made of pieces, and no model has loads off the centreline"
        )
    mass, n = masses(robot.tubes, Load(gravity=(0.0, 0.0, -9.81))), robot.n_tubes
    generator = ca.CodeGenerator("mechanics_of_loads.c")
    generator.add(coupling_rate_function(n))
    defines = {
        "ECCENTRIC": 0,
        "GENERAL": 0,
        "MOST_SECTIONS": 2 * n,
        "MOST_CUTS": 2 * n + 1,
        "ROUND_OFF_LENGTH": ROUND_OFF,
        "WAVES_PER_ELEMENT": 1,  # of what is not loaded: not asked for
        "LOADED_WAVES": LOADED_WAVES,
        "BEND_PER_PIECE": BEND_PER_PIECE,
    }
    kernel = SEEN.sub(r"static \1", loaded_text(n, generator, "loaded.c"))
    parts = [
        f"/* {name} under load: made by tubeopt {__version__}; see the header. */\n",
        '#include "tubeopt_robot.h"\n\n#pragma GCC diagnostic ignored "-Wunused-function"\n',
        '#pragma GCC diagnostic ignored "-Wunused-parameter"\n#define CASADI_SYMBOL_EXPORT static\n',
        kernel,
        *(f"#define {key} {value!r}\n" for key, value in defines.items()),
        with_included(HERE / "layout.c"),
        f"static const Tubes ROBOT = {tubes_text(robot)};\nstatic const double MASS[] = {{{numbers(mass)}}};\n",
        _rules(),
        (C_FOLDER / "bear.c").read_text(),
    ]
    return "".join(parts)


def loaded_cases(robot: Robot, cases: Sequence[Array]) -> list[Array]:
    """(2n + 10,) joints, force, gravity, tip position and margin of configurations under load, from rows that begin
    with the joints: a force that shifts the tip by 2 % of the arm, and the weight."""
    n, found, random = robot.n_tubes, [], np.random.default_rng(0)
    down = np.array([0.0, 0.0, -9.81])
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


def _rules() -> str:
    """Points of the three rules, and what carries over between them."""
    degrees = DEGREE, ROUGH_DEGREE, CHECK_DEGREE
    lines, rows = [], []
    for k, degree in enumerate(degrees):
        rule = tableau("gauss", degree)
        basis, once, twice = (rule.lagrange(ENDS, integrals=i) for i in range(3))
        tables = {"nodes": rule.nodes, "weights": rule.weights, "matrix": rule.matrix}
        tables |= {"basis": basis, "once": once, "twice": twice}
        lines += [static_table(f"RULE{k}_{name}", table) for name, table in tables.items()]
        rows.append(f"{{{degree}, {', '.join(f'RULE{k}_{name}' for name in tables)}}}")
    for name, a, b in (
        ("TO_ROUGH", DEGREE, ROUGH_DEGREE),
        ("TO_CHECK", DEGREE, CHECK_DEGREE),
        ("FROM_ROUGH", ROUGH_DEGREE, DEGREE),
    ):
        lines.append(static_table(name, _between(a, b)))
    return "\n".join([*lines, RULE, f"static const Rule RULE[] = {{{', '.join(rows)}}};\n"])


def _between(degree: int, other: int) -> Array:
    return np.ascontiguousarray(tableau("gauss", degree).lagrange(tableau("gauss", other).nodes))

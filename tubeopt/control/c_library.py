"""A robot as a C library of its own: the compiled kernel and a loop at 1 kHz around it, with the numbers of the robot.

It is the kernel that Python calls, the same text; `control/c` adds the memory that a caller gives, the motion along a
branch, the quadratic program of a servo step, and its guard. With loads, it has the kernel of loaded arms too. Beside
it is the robot as URDF, for ROS.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import islice, pairwise
from math import ceil
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import __version__
from ..arguments import typed
from ..block.transcription.mesh import BEND_PER_ELEMENT, LOADED_WAVES, loaded_counts
from ..constants import GRAVITY
from ..display import Displayed
from ..equilibrium.kinematics import TOLERANCE, TORSION_FREE, SolveRequest, forward_kinematics, unloaded
from ..equilibrium.problem import DEFAULT_DISCRETISATION, reduced_problem
from ..errors import InputError, SolveError
from ..files.files import write_text
from ..inverse.breakpoint_order import breakpoints_at_zero
from ..inverse.joints import JointSpace, joint_space
from ..physics.certificate import coupling_rate_function
from ..robots.assembly import LENGTH_ROUND_OFF
from ..robots.eccentric import BundleRobot
from ..robots.lengthwise import lengthwise
from ..robots.limits import FAR, MOST_TURN
from ..robots.load import Load, masses
from ..robots.order import SAME_END, demands
from ..robots.robot import Robot, is_general
from ..solvers.compiled.binding import piece_sizes, piece_tables, tube_rows
from ..solvers.compiled.bundle import bundle_source
from ..solvers.compiled.constants import piece_constants
from ..solvers.compiled.library import CAPACITY, MOST_CUTS, MOST_TUBES, Capacity, kernel_text
from ..solvers.compiled.loaded import MOST_PIECES, loaded_text
from ..solvers.compiled.text import HERE, c_tables, defined, numbers, with_included
from ..solvers.settings import LARGEST_SHIFT, LARGEST_TURN
from ..typing import Array
from .closest import TRIALS
from .command import MOST_NUMBER, ServoOptions

C_FOLDER = Path(__file__).parent / "c"


# Warnings that what is generated, and the kernel's vectors, give rise to without need.
HUSHED = """/* CasADi writes for every function more than is used here; vectors are handed on within this file alone. */
#if defined(__GNUC__) || defined(__clang__)
#pragma GCC diagnostic ignored "-Wunused-function"
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
#if defined(__GNUC__) && !defined(__clang__)
#pragma GCC diagnostic ignored "-Wpsabi"
#endif
#define CASADI_SYMBOL_EXPORT static
"""


# Configurations whose answers the test of the library knows.
CASES = 24


@dataclass(frozen=True)
class CLibrary(Displayed):
    """Texts of a library."""

    robot: Robot
    """Robot of the library."""
    name: Annotated[str, "name of the robot"]
    prefix: Annotated[str, "prefix of all names of the library"]
    files: dict[str, str]
    """Name of a file -> its text."""
    loads: bool = False
    """True if the library includes loads."""


@typed
def c_library(
    robot: Robot,
    *,
    name: str = "robot",
    prefix: str = "tubeopt",
    loads: bool = False,
    options: ServoOptions | None = None,
) -> CLibrary:
    """The C library of a robot: of concentric tubes, of one arc each or made of pieces, of eccentric ones, or a bundle.

    Args:
        name: what the comments call it.
        prefix: prefix of all C names; use a different one for each robot of a program.
        loads: include tip force and weight.
        options: limits of the servo; its floors are constants of the header, and all are in the URDF.

    Raises:
        InputError: more than MOST_TUBES tubes, a rigid part of a sheath, a prefix that is no name in C; loads on tubes
            off the centreline, or of unknown weight.
        SolveError: no stable equilibrium is found for the answers that its test knows.
    """
    if robot.n_tubes > MOST_TUBES:
        raise InputError(f"robot has {robot.n_tubes} tubes; a C library is made of at most {MOST_TUBES}")
    if isinstance(robot, BundleRobot) and (robot.sheath_rigid_length or robot.sheath_rigid_from is not None):
        raise InputError(
            "the sheath of the robot has a rigid part, which no C library has; for a rigid part at the plate, move "
            "the plate to its end"
        )
    if not re.fullmatch(r"[a-z][a-z0-9_]*", prefix):
        raise InputError(f"prefix is {prefix!r}; it must be lower-case letters, digits and _, starting with a letter")
    space, centred = joint_space(robot), _is_centred(robot)
    extra = {"tubeopt_load.c": loads_source(robot, name, _shifts(space))} if loads else {}
    cases = _cases(space)
    texts = {
        "tubeopt_robot.h": header_text(name, robot.n_tubes, loads=loads, centred=centred, options=options),
        "tubeopt_robot.c": _source(robot, space, name),
        "CMakeLists.txt": _filled("CMakeLists.txt", name=name, load=" tubeopt_load.c" if loads else ""),
        "README.md": _filled("README.md", name=name, version=__version__, load=" tubeopt_load.c" if loads else ""),
        "example.c": _filled("example.c", name=name, START=_joints(cases[0])),
        "test.c": _filled("test.c", CASES=_rows(cases), LOADED=_rows(loaded_cases(robot, cases[:8]) if loads else ())),
    }
    files = {file.replace("tubeopt", prefix): _renamed(text, prefix) for file, text in (texts | extra).items()}
    files[f"{prefix}_robot.urdf"] = robot_description(robot, options)
    return CLibrary(robot, name, prefix, files, loads)


def _is_centred(robot: Robot) -> bool:
    """True if all tubes are concentric."""
    return robot.fixed_sections and not robot.assembly(robot.home_translations).eccentric


def header_text(name: str, n: int, *, loads: bool, centred: bool = True, options: ServoOptions | None = None) -> str:
    """Text of the C header of a library for n tubes; `centred` if all are on the centreline."""
    floors = options or ServoOptions()
    values = {
        "min_margin": f"{floors.min_margin:.9g}",
        "min_snap_distance": f"{floors.min_snap_distance or 0.0:.9g}",
        "loads": str(int(loads)),
        "compliance": str(int(centred)),
        "bodies": str(int(centred)),
        "most_turn": f"{MOST_TURN:g}.0",
        "most_back": f"{FAR:g}.0",
        "most_number": f"{MOST_NUMBER:g}",
        "how": "" if centred else ", by differences of equilibria side by side",
    }
    return _filled("robot.h", name=name, version=__version__, n=str(n), **values)


def save_c_library(library: CLibrary, folder: Path) -> list[Path]:
    """Write the files of a library into a folder; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    for file, text in library.files.items():
        write_text(folder / file, text)
    return [folder / file for file in library.files]


def _renamed(text: str, prefix: str) -> str:
    text = text.replace("tubeopt_", f"{prefix}_").replace("TUBEOPT_", f"{prefix.upper()}_")
    return text.replace("mechanics_", f"{prefix}_mechanics_")  # helpers of CasADi


def _filled(file: str, **values: str) -> str:
    """Text of a template with the given values in place of their names in braces."""
    text = (C_FOLDER / file).read_text()
    for name, value in values.items():
        text = text.replace(f"{{{name}}}", value)
    return text.replace("{{", "{").replace("}}", "}") if file == "CMakeLists.txt" else text


def _source(robot: Robot, space: JointSpace, name: str) -> str:
    if isinstance(robot, BundleRobot):
        kernel = _bundle_kernel_text(robot.n_tubes)
    else:
        kernel = kernel_text(robot.n_tubes, not _is_centred(robot), _room(space))
    return library_text(name, kernel, _data(robot, space))


def _bundle_kernel_text(n: int) -> str:
    """C text of the kernel of bundles, with that of translations and small steps."""
    constants = {
        "SLOPES": 0,
        "ROUND_OFF_LENGTH": LENGTH_ROUND_OFF,
        "TOLERANCE": TOLERANCE,
        "LARGEST_TURN": LARGEST_TURN,
        "LARGEST_SHIFT": LARGEST_SHIFT,
    }
    shared = [(HERE / name).read_text() for name in ("curve.c", "parts.c")]
    return "".join([bundle_source(n), defined(constants), *shared, (C_FOLDER / "sheath.c").read_text()])


def library_text(name: str, kernel: str, numbers: str) -> str:
    """C text of a library: the kernel of Python, the numbers of the robot, and the functions for a control loop."""
    parts = [
        f"/* {name}: made by tubeopt {__version__}; see the header. */\n",
        f'#include "tubeopt_robot.h"\n\n{HUSHED}',
        kernel,
        "\n/* --- the numbers of the robot --- */\n",
        numbers,
        with_included(HERE / "quadratic.c"),
        *(with_included(C_FOLDER / f"{part}.c") for part in ("robot", "servo")),
        f"\n#if TUBEOPT_LOADS\n{(C_FOLDER / 'estimate.c').read_text()}#endif\n",
    ]
    return "".join(parts)


def _room(space: JointSpace) -> Capacity:
    """Numbers of elements to reserve memory for, with a margin: pieces that vary quickly need fine meshes."""
    if not is_general(space.robot):
        return CAPACITY
    problems = [reduced_problem(space.robot, tuple(s.tolist()), DEFAULT_DISCRETISATION) for s in _shifts(space)]
    pieces, unknowns = max(len(p.mesh.length) for p in problems), max(p.size for p in problems)
    return Capacity(
        max(CAPACITY.pieces, ceil(SPARE * pieces)), max(CAPACITY.unknowns, 4 * ceil(SPARE * unknowns / 4) + 4)
    )


def _shifts(space: JointSpace) -> list[Array]:
    """Translations (n,) of some configurations."""
    return [np.array(space.split(q)[1]) for q in islice(_configurations(space), CASES)]


def _data(robot: Robot, space: JointSpace) -> str:
    """Tubes, joints and limits as C."""
    n, m = robot.n_tubes, len(space.lower)
    carriage = [next(c for c, group in enumerate(space.carriages) if i in group) for i in range(n)]
    first = [0] * n + [group[0] for group in space.carriages]
    breaks = breakpoints_at_zero(space)
    tables: dict[str, ArrayLike] = {
        "BREAK_AT": [s for _, s in breaks] or [0.0],
        "SPREAD": space.spread,
        "OFFSET": space.offset,
        "LOWER": space.lower,
        "UPPER": space.upper,
        "SCALE": space.scale,
        "ORDER": space.rows if space.rows.size else np.zeros(1),
        "LEAST": space.row_lower if space.row_lower.size else np.zeros(1),
    }
    starts = space.sample(TRIALS)
    tables["STARTS"] = starts
    rows = 2 * m + len(space.row_lower) + 1 + len(breaks)
    defines = {
        "JOINTS": m,
        "ORDERS": len(space.row_lower),
        "BREAKS": len(breaks),
        "MOST_ROWS": f"({rows}{' + TUBEOPT_MOST_CONTACTS' if _is_centred(robot) else ''})",
        "LONGEST_TUBE": space.length,
        "TRIALS": len(starts),
    }
    lines = [*(f"#define {key} {value}" for key, value in defines.items()), c_tables(tables)]
    lines += [f"static const long long CARRIAGES[] = {{{', '.join(map(str, carriage))}}};"]
    lines += [f"static const int BREAK_CARRIAGE[] = {{{', '.join(str(c) for c, _ in breaks) or 0}}};"]
    lines += [f"static const int FIRST[] = {{{', '.join(map(str, first))}}};"]
    if isinstance(robot, BundleRobot):
        lines += [f"static const Robot ROBOT = {_bundle_text(robot)};\n\n"]
    else:
        lines += [pieces_text(robot), f"static const Tubes ROBOT = {tubes_text(robot)};\n\n"]
    return "\n".join(lines)


def _rows(cases: Iterable[Array]) -> str:
    return "".join(f"    {{{numbers(case)}}},\n" for case in cases)


def _joints(case: Array) -> str:
    n = (len(case) - 4) // 2
    return f"{{{numbers(case[:n])}}}, {{{numbers(case[n : 2 * n])}}}"


def _cases(space: JointSpace) -> list[Array]:
    """(2n + 4,) joints, tip position and margin of test configurations, solved from tubes without torsion.

    The first configuration has room on all sides.
    """
    found = []
    for q in _configurations(space):
        rotations, shift = space.split(q)
        if (
            not space.robot.fixed_sections
            and unloaded(space.robot, np.array(rotations), np.array(shift), None, SolveRequest()) is None
        ):
            continue  # the order of the ends of a bundle is left to the general solver
        try:
            pose = forward_kinematics(space.robot, rotations, shift)
        except SolveError:
            continue
        if pose.margin > 0.3 and pose.statistics.start == TORSION_FREE:
            found.append(np.concatenate([rotations, shift, pose.tip_position, [pose.margin]]))
        if len(found) == CASES:
            break
    if not found:
        raise SolveError("no configuration was found for the self-test of the library")
    return found


def _configurations(space: JointSpace) -> Iterable[Array]:
    yield 0.5 * space.inside() + 0.5 * space.middle()
    yield from space.sample(4 * CASES)


def tubes_text(robot: Robot) -> str:
    """The C struct Tubes, which points to PIECES."""
    home = robot.assembly(robot.home_translations)
    rows = ", ".join(f"{{{numbers(row)}}}" for row in tube_rows(robot))
    return f"{{{rows}, {int(home.eccentric)}, &PIECES}}"


def _bundle_text(robot: BundleRobot) -> str:
    """The C struct Robot of a bundle."""
    names = ("bending_stiffness", "torsional_stiffness", "curvature")
    rows: list[ArrayLike] = [[float(getattr(tube, name)) for tube in robot.tubes] for name in names]
    lever = robot.axes[:, ::-1] * [1.0, -1.0]
    lengths = [[float(getattr(tube, f"{name}length")) for tube in robot.tubes] for name in ("straight_", "curved_", "")]
    texts = ", ".join(f"{{{numbers(row)}}}" for row in [*rows, robot.offset, robot.angle])
    levers = ", ".join(f"{{{numbers(row)}}}" for row in lever)
    return (
        f"{{{texts}, {{{levers}}}, {', '.join(f'{{{numbers(row)}}}' for row in lengths)}, {robot.sheath_stiffness!r}}}"
    )


def pieces_text(robot: Robot) -> str:
    """The C struct PIECES of the tubes of a robot, and its tables."""
    arrays = piece_tables(lengthwise(robot.tubes))
    tables = {f"PIECES_{name}": array for name, array in arrays.items()}
    entries = [*map(str, piece_sizes(arrays)), *tables, "0"]  # no refinement
    return f"{c_tables(tables)}static const Pieces PIECES = {{{', '.join(entries)}}};\n"


# What the kernel shows to Python.
SEEN = re.compile(r"^(size_t (?:workspace|answer)_size|int solve_loaded|void solve_many_loaded)", re.MULTILINE)


# Forces up to this times the stiffness of the tip over the square of the length have room on meshes of tubes made of
# pieces: they bend arms by more than half a circle; and by how much more room there is than some configurations need.
BEARABLE, SPARE = 10.0, 1.25


def loads_source(robot: Robot, name: str, shifts: Sequence[Array]) -> str:
    """The C text of `tubeopt_load.c`; `shifts`: translations (n,) of some configurations."""
    if not _is_centred(robot):
        raise InputError("loads are requested; loads on eccentric robots and bundles are not supported")
    home = robot.assembly(robot.home_translations)
    mass, n = masses(robot.tubes, Load(gravity=(0.0, 0.0, -GRAVITY))), robot.n_tubes
    pieces = _pieces_room(robot, shifts) if home.general else MOST_PIECES
    data = f"{pieces_text(robot)}static const Tubes ROBOT = {tubes_text(robot)};\n"
    return loads_text(name, n, f"{data}static const double MASS[] = {{{numbers(mass)}}};\n", pieces)


def loads_text(name: str, n: int, data: str, pieces: int = MOST_PIECES) -> str:
    """C text of loads on n tubes, with memory for `pieces` elements; `data` has PIECES, ROBOT and MASS as C."""
    generator = ca.CodeGenerator("mechanics_of_loads.c")
    generator.add(coupling_rate_function(n))
    defines = {
        "ECCENTRIC": 0,
        "MOST_SECTIONS": pieces,
        "MOST_CUTS": MOST_CUTS,
        "ROUND_OFF_LENGTH": LENGTH_ROUND_OFF,
        "SAME_END": SAME_END,
        "WAVES_PER_ELEMENT": 1,  # of what is not loaded: not asked for
        "LOADED_WAVES": LOADED_WAVES,
        "BEND_PER_ELEMENT": BEND_PER_ELEMENT,
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
        *((C_FOLDER / name).read_text() for name in ("loaded_turn.c", "bear.c")),
    ]
    return "".join(parts)


def _pieces_room(robot: Robot, shifts: Sequence[Array]) -> int:
    """Number of elements to reserve memory for, for tubes made of pieces at translations (n,) under
    admissible loads.
    """
    most = MOST_PIECES
    for shift in shifts:
        assembly = robot.assembly(shift)
        length = assembly.total_length
        tip = np.array([length * (1 - LENGTH_ROUND_OFF)])
        bearable = (
            BEARABLE * float(assembly.cross_sections(tip, tip).stiffness.sum()) / max(length, LENGTH_ROUND_OFF) ** 2
        )
        most = max(most, ceil(SPARE * loaded_counts(assembly, bearable, 0.0).sum()))
    return most


def loaded_cases(robot: Robot, cases: Sequence[Array]) -> list[Array]:
    """(2n + 10,) joints, force, gravity, tip position and margin of test configurations under load.

    The rows `cases` begin with the joints. The load is a force that shifts the tip by 2 % of the arm, and the weight.
    """
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


# --- the robot that moves, as URDF for ROS ------------------------------------------------------------------------


LINK = 8e-3
"""Length of a rigid link of a tube, m: the chord of an arc of 50 mm radius leaves it by 0.16 mm."""


class TubeLink(NamedTuple):
    """Rigid part of a tube: number of the tube, from 0, name, both ends, and radius, m.

    The ends are its own arc lengths from the fixed end of the tube, m.
    """

    tube: int
    name: str
    start: float
    end: float
    radius: float


def tube_links(robot: Robot) -> list[TubeLink]:
    """The tubes of a robot as rigid links; tubes off the centreline have the radius of the bundle."""
    home = robot.offset if isinstance(robot, BundleRobot) else robot.assembly(robot.home_translations).offset
    offset, links = np.asarray(home), list[TubeLink]()
    for i, tube in enumerate(robot.tubes):
        cuts = np.linspace(0.0, tube.length, 1 + max(1, round(tube.length / LINK))).tolist()
        radius = tube.outer_diameter / 2 + float(offset[i])
        links += [TubeLink(i, f"tube_{i + 1}_{k}", *ends, radius) for k, ends in enumerate(pairwise(cuts), start=1)]
    return links


def along_tubes(robot: Robot, arm: Any, tubes: NDArray[np.intp], lengths: Array) -> Array:
    """(m, 3) points of tubes (m,), from 0, at their own arc lengths (m,), m, on the centreline of an equilibrium."""
    fixed = np.array([tube.straight_length for tube in robot.tubes])
    s = lengths - fixed[tubes] + np.asarray(arm.translations)[tubes]
    points = np.column_stack([np.interp(s, arm.arc_length, arm.position[:, k]) for k in range(3)])
    points[s < 0] = np.column_stack([0 * s, 0 * s, s])[s < 0]  # straight behind the plate
    return points


@typed
def robot_description(robot: Robot, options: ServoOptions | None = None) -> str:
    """URDF text of a robot that moves, for ROS, with limits of its servo.

    The joints translation_1, ... and rotation_1, ... move the carriages. The links of the tubes and the tip are on
    floating joints: whoever solves the equilibrium broadcasts their frames. The tag `ros2_control` loads the hardware
    interface tubeopt_hardware/TubeRobot.
    """
    root, n, rates = (
        Element("robot", name=(robot.name or "robot").replace(" ", "_")),
        robot.n_tubes,
        options or ServoOptions(),
    )
    low, high = joint_space(robot).ranges
    SubElement(root, "link", name="plate")
    for i, tube in enumerate(robot.tubes):
        base = "plate"
        for kind, k, rate in (("translation", n + i, rates.shift_rate), ("rotation", i, rates.turn_rate)):
            SubElement(root, "link", name=f"{kind}_{i + 1}_link")
            joint = _joint(root, f"{kind}_{i + 1}", "revolute" if kind == "rotation" else "prismatic", base)
            SubElement(joint, "origin", xyz=_spaced([0, 0, -tube.straight_length if k >= n else 0]), rpy="0 0 0")
            SubElement(joint, "axis", xyz="0 0 1")
            ends = {"lower": _spaced([low[k]]), "upper": _spaced([high[k]])}
            SubElement(joint, "limit", ends, velocity=_spaced([rate]), effort="0")
            base = f"{kind}_{i + 1}_link"
    for link in tube_links(robot):
        part = SubElement(root, "link", name=link.name)
        for purpose in ("visual", "collision"):
            shape = SubElement(SubElement(part, purpose), "geometry")
            SubElement(shape, "cylinder", radius=_spaced([link.radius]), length=_spaced([link.end - link.start]))
        grey = 0.85 - 0.6 * link.tube / n
        material = SubElement(part[0], "material", name=f"tube_{link.tube + 1}")
        SubElement(material, "color", rgba=_spaced([grey, grey, grey, 1.0]))
        _joint(root, f"{link.name}_pose", "floating", "plate")
    SubElement(root, "link", name="tip")
    _joint(root, "tip_pose", "floating", "plate")
    _add_ros2_control(root, robot, rates)
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode")


HARDWARE = ("turn_rate", "shift_rate", "turn_acceleration", "shift_acceleration", "min_margin", "min_snap_distance")
"""Limits of the servo that the hardware interface keeps; an acceleration of 0 has no limit."""


def _joint(root: Element, name: str, kind: str, parent: str) -> Element:
    """A joint from a parent to the link that was added last."""
    child = root.findall("link")[-1].get("name", "")
    joint = SubElement(root, "joint", name=name, type=kind)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    return joint


def _add_ros2_control(root: Element, robot: Robot, o: ServoOptions) -> None:
    """Add the joints and the sensor of the ROS 2 hardware interface, which starts at home."""
    system = SubElement(root, "ros2_control", name=root.get("name", ""), type="system")
    hardware, space, n = SubElement(system, "hardware"), joint_space(robot), robot.n_tubes
    SubElement(hardware, "plugin").text = "tubeopt_hardware/TubeRobot"
    order = [(demand.ahead, demand.behind, demand.distance) for demand in demands(robot)]
    for first, *others in space.carriages:
        for tube in others:
            apart = float(space.offset[n + tube] - space.offset[n + first])
            order += [(tube, first, apart), (first, tube, -apart)]
    given = {name: _spaced([getattr(o, name) or 0.0]) for name in HARDWARE}
    given["order"] = " ".join(f"{ahead + 1} {behind + 1} {least:.9g}" for ahead, behind, least in order)
    for name, text in given.items():
        SubElement(hardware, "param", name=name).text = text
    starts = np.concatenate([robot.home_rotations, robot.home_translations])
    for k, (start, low, high) in enumerate(zip(starts, *space.ranges, strict=True)):
        joint = SubElement(system, "joint", name=f"{'rotation' if k < n else 'translation'}_{k % n + 1}")
        for kind, name, values in (
            ("command_interface", "position", {"min": low, "max": high}),
            ("state_interface", "position", {"initial_value": start}),
            ("state_interface", "velocity", {}),
        ):
            interface = SubElement(joint, kind, name=name)
            for key, value in values.items():
                SubElement(interface, "param", name=key).text = _spaced([value])
    sensor = SubElement(system, "sensor", name="arm")
    for name in ("margin", "why", "tip.x", "tip.y", "tip.z"):
        SubElement(sensor, "state_interface", name=name)


def _spaced(values: Iterable[float]) -> str:
    # Adding 0.0 turns -0 into 0. Nine digits keep 1 nm at an arm of 1 m.
    return " ".join(f"{value + 0.0:.9g}" for value in values)

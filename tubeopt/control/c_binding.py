"""A C library of a robot, compiled here and called from Python: the functions of its header on NumPy arrays."""

from __future__ import annotations

import ctypes
import hashlib
import logging
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..bodies.obstacles import Obstacle
from ..errors import InputError, SolveError, vector
from ..inverse.joints import Configuration, configuration, joint_space
from ..robots.limits import FAR, MOST_TURN
from ..robots.robot import Robot
from ..solvers.compiled.library import cache_directory, compile_to
from ..typing import Array
from .c_library import CLibrary, c_library
from .command import MOST_NUMBER, Command, ServoOptions, ServoStep, Why, at_most, check_places, time_step
from .estimator import BaseReading, EstimatorOptions, TipReading
from .servo import Servo

LOGGER = logging.getLogger("tubeopt")

REFUSED = {
    1: "no stable equilibrium was found from tubes without torsion",
    3: "there is no equilibrium to continue from, or to return to",
    4: "the branch does not reach these joint values: the robot would snap",
    5: "the motion is longer than one call may be",
}
# Return values of the functions without a result; 2 is bad input.
TOO_LARGE = (
    f"a number is too large. Limits: rotations {MOST_TURN:g} rad, other numbers {MOST_NUMBER:g} in SI units. A tube "
    f"may be withdrawn by {FAR:g} of its lengths. Positions may be {FAR:g} lengths of the longest tube away"
)


# Change of a joint (rad, m) in a step below which it rests.
RESTS = 1e-12

# Steps of the search of a closer pose in one call: with the step of the robot they take 0.3 ms.
SEEKING_STEPS = 8

# Points of the centreline of a pose.
POINTS = 40


@dataclass(frozen=True, eq=False)
class CPose:
    """Equilibrium of a C library as plain numbers."""

    rotations: Array
    """Rotations (n,), rad."""
    translations: Array
    """Translations (n,), m."""
    tip_position: Array
    """Position (3,) of the tip, m."""
    tip_rotation: Array
    """Rotation matrix (3, 3) of the tip frame."""
    tip_rotations: Array
    """Rotations (n,) of the tubes at their own ends, rad."""
    margin: float
    energy: float
    """Elastic energy, J."""
    tip_error: float
    """Estimated error of the tip, m."""
    residual: float
    """Largest violation of the torsion equations, rad."""
    arc_length: Array
    """(POINTS,) arc lengths of the shape points, m."""
    position: Array
    """(POINTS, 3) positions of the shape points, m."""


@dataclass(frozen=True, eq=False)
class CSlopes:
    """Derivatives of an equilibrium by rotations and translations."""

    position: Array
    """(3, 2n) derivatives of the tip position."""
    rotation: Array
    """(3, 2n) turn vector of the tip."""
    tip_rotations: Array
    """Derivatives (n, 2n) of the tip rotations."""
    margin: Array
    """Derivatives (2n,) of the margin."""
    compliance: Array | None
    """(6, 6) compliance of the tip; None if the library does not compute it."""


class CRobot:
    """A robot of a C library with memory of its own.

    Raises:
        OSError, subprocess.SubprocessError: there is no C compiler, or it fails.
    """

    def __init__(self, library: CLibrary) -> None:
        self.n, self._prefix = library.robot.n_tubes, library.prefix
        self._library = ctypes.CDLL(str(_compiled(library)))
        size = self.function("memory_size")
        size.restype = ctypes.c_size_t
        self._room = np.zeros(size() // 8 + 1)
        start = self.function("start")
        start.argtypes, start.restype = [ctypes.c_void_p], ctypes.c_void_p
        self.memory = ctypes.c_void_p(start(self._room.ctypes.data))
        # What goes in and comes out stays where it is: to ask NumPy for an address takes as long as a step's algebra.
        self._in, self._pose, self._report = np.zeros(max(19, 2 * self.n)), np.zeros(3 * self.n + 16), np.zeros(3)
        self._to = np.zeros(2 * self.n)
        self._slopes = np.full(6 * 2 * self.n + 2 * self.n**2 + 2 * self.n + 36, np.nan)
        self._length, self._points = np.zeros(POINTS), np.zeros((POINTS, 3))
        self._shape = self.function("shape")
        self._distance = self.function("snap_distance")
        self._distance.argtypes, self._distance.restype = [ctypes.c_void_p, ctypes.c_double], ctypes.c_double
        self._time = self.function("snap_time")
        self._time.argtypes, self._time.restype = [ctypes.c_void_p, *[ctypes.c_double] * 3], ctypes.c_double
        self._shape_at = self.memory, POINTS, *map(_at, (self._length, self._points))
        self._calls = {
            name: (self.function(name), self.memory, *map(_at, arguments))
            for name, arguments in (
                ("solve", (self._in, self._pose)),
                ("follow", (self._in, self._pose)),
                ("undo", (self._pose,)),
                ("slopes_at", (self._slopes,)),
                ("servo", (self._in, self._pose, self._report)),
                ("servo_joints", (self._in, self._to, self._pose, self._report)),
                *([("bear", (self._in, self._pose))] if library.loads else []),
            )
        }

    def function(self, name: str) -> Any:
        """A function of the library by its name without prefix."""
        return getattr(self._library, f"{self._prefix}_{name}")

    def _call(self, name: str) -> None:
        function, *arguments = self._calls[name]
        self._check(name, function(*arguments))

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the library; raises the errors of the methods below for its return code."""
        self._check(name, self.function(name)(*arguments))

    def _check(self, name: str, status: int) -> None:
        if status == 2:
            raise InputError(
                f"{name} was called with a number that is not finite, a translation that is not possible, or more than "
                "it can take"
            )
        if status == 6:
            raise InputError(f"{name} is rejected: {TOO_LARGE}")
        if status:
            raise SolveError(REFUSED[status])

    def _call_among(self, contacts: Array, clearance: float) -> None:
        try:
            function = self.function("servo_among")
        except AttributeError:
            raise InputError(
                "the C library of this robot does not support obstacles: it has no derivatives along the arm"
            ) from None
        where = _at(self._in), ctypes.c_int(len(contacts)), _at(contacts), ctypes.c_double(clearance)
        self._calls["servo_among"] = function, self.memory, *where, _at(self._pose), _at(self._report)
        self._call("servo_among")

    def _go(self, name: str, rotations: ArrayLike, translations: ArrayLike) -> CPose:
        n = self.n
        self._in[:n], self._in[n : 2 * n] = vector("rotations", rotations, n), vector("translations", translations, n)
        self._call(name)
        return self._posed()

    def _posed(self) -> CPose:
        n, p = self.n, self._pose.copy()
        self._shape(*self._shape_at)
        frame, (margin, energy, error, residual) = p[2 * n + 3 : 2 * n + 12].reshape(3, 3), p[3 * n + 12 :].tolist()
        tip, turned, arm = p[2 * n : 2 * n + 3], p[2 * n + 12 : 3 * n + 12], (self._length.copy(), self._points.copy())
        return CPose(p[:n], p[n : 2 * n], tip, frame, turned, margin, energy, error, residual, *arm)

    def solve(self, rotations: ArrayLike, translations: ArrayLike) -> CPose:
        """Stable equilibrium, solved from tubes without torsion; raises SolveError if none is found."""
        return self._go("solve", rotations, translations)

    def follow(self, rotations: ArrayLike, translations: ArrayLike) -> CPose:
        """Equilibrium after a straight joint motion from the last one; raises SolveError at a snap."""
        return self._go("follow", rotations, translations)

    def undo(self) -> CPose:
        """Equilibrium before the last `follow` or `servo`, for a motion that was not sent.

        Raises SolveError after another call in between.
        """
        self._call("undo")
        return self._posed()

    def bear(self, force: ArrayLike = (0, 0, 0), gravity: ArrayLike = (0, 0, 0)) -> CPose:
        """Last equilibrium after the tip force (3,), N, and gravity (3,), m/s^2, have slowly increased to these values.

        All later results are of the loaded arm. Raises SolveError if the branch ends before the full load, and
        InputError if the library has no loads.
        """
        if "bear" not in self._calls:
            raise InputError("the C library was made without loads")
        self._in[:3], self._in[3:6] = vector("force", force, 3), vector("gravity", gravity, 3)
        self._call("bear")
        return self._posed()

    def snap_distance(self, most: float) -> float | None:
        """Turn of all tubes, rad, that is proved to cause no snap at the last equilibrium.

        It is at most `most`, inf if no turn can snap, and None if it is unknown.
        """
        found: float = self._distance(self.memory, most)
        return None if found < 0 else found

    def snap_time(self, turn_rate: float, shift_rate: float, most: float) -> float | None:
        """Time, s, at most `most`, within which nothing snaps if joints move at up to these rates, rad/s and m/s.

        It is proved; None if it is unknown.
        """
        found: float = self._time(self.memory, turn_rate, shift_rate, most)
        return None if found < 0 else found

    def slopes(self) -> CSlopes:
        """Derivatives of the last equilibrium by the joint values."""
        self._call("slopes_at")
        n = self.n
        tip, turn, ends, margin, compliance = np.split(self._slopes.copy(), np.cumsum([6 * n, 6 * n, 2 * n * n, 2 * n]))
        known = None if np.isnan(compliance[0]) else compliance.reshape(6, 6)
        return CSlopes(tip.reshape(3, -1), turn.reshape(3, -1), ends.reshape(n, -1), margin, known)

    def servo(
        self, command: Array, contacts: Array | None = None, clearance: float = 0.0
    ) -> tuple[CPose, float, float, Why]:
        """Pose after one step of a command (12,) to (19,), distance (m) and angle (rad) to the target, and reason.

        A command has the step (s), position and direction (3,) each, speed, rates of rotations and of translations,
        least margin, push, accelerations of rotations and of translations (0: no limit), least snap distance (rad, 0:
        the margin counts), a velocity (3,) in place of the position (0: the position counts), and the number of steps
        of the search of a closer pose (0: no search).

        `contacts` (c, 5): arc lengths, unit vectors away from bodies, and distances (m) where the arm comes close to
        them; the step keeps `clearance` (m). Raises InputError for too many, under load, and if the library has none.
        """
        self._in[12:19] = 0.0
        self._in[: len(command)] = command
        if contacts is None:
            self._call("servo")
        else:
            self._call_among(np.ascontiguousarray(contacts, dtype=float), clearance)
        why, _ = self._report[2:].view(np.int32)
        return self._posed(), float(self._report[0]), float(self._report[1]), Why(int(why))

    def servo_joints(self, command: Array, rotations: ArrayLike, translations: ArrayLike) -> tuple[CPose, Why]:
        """Pose after one step on the straight path to joint values (n,), and the reason if the step is shortened."""
        n = self.n
        self._in[: len(command)] = command
        self._to[:n], self._to[n:] = vector("rotations", rotations, n), vector("translations", translations, n)
        self._call("servo_joints")
        return self._posed(), Why(int(self._report[2:].view(np.int32)[0]))


def servo_of(
    robot: Robot,
    start: Configuration,
    *,
    obstacles: Sequence[Obstacle] = (),
    options: ServoOptions | None = None,
    building: Callable[[], object] | None = None,
) -> Servo | CServo:
    """Fastest servo for a robot: that of its C library (0.1 ms per step), or `Servo` if it cannot be built.

    `Servo` is used among obstacles, with options that the library lacks, and where the library cannot be built.

    Args:
        building: called once the arguments are checked, before the library is compiled.

    Raises:
        InputError, SolveError: as of `Servo`.
    """
    servo = Servo(robot, start, obstacles=obstacles, options=options)
    if obstacles:
        return servo
    if building is not None:
        building()
    current = servo.equilibrium
    try:
        return CServo(c_library(robot), (current.rotations, current.translations), servo.options)
    except (InputError, SolveError, OSError, subprocess.SubprocessError) as error:
        LOGGER.info("the servo runs in Python: %s", error)
        return servo


class CEstimator:
    """The state estimator of a C library with loads: tip force, offsets of rotations and of translations.

    Args:
        start: joint values of the robot.   options: deviations and times; those of stiffness and tip must be 0.

    Raises:
        InputError: options that only the estimator in Python has; a library without loads.
        SolveError: no stable equilibrium is found at the start.
    """

    def __init__(
        self, library: CLibrary, start: tuple[ArrayLike, ArrayLike], options: EstimatorOptions | None = None
    ) -> None:
        o = options or EstimatorOptions()
        if o.stiffness or o.tip_offset or o.known is not None:
            raise InputError("options estimate stiffness or tip offset, or have a known load; a C library does not")
        if not library.loads:
            raise InputError("the C library was made without loads")
        self._robot = CRobot(library)
        self.start = self._robot.solve(*start)
        n = library.robot.n_tubes
        size = self._robot.function("estimator_size")
        size.restype = ctypes.c_size_t
        self._room = np.zeros(size() // 8 + 1)
        self._in, self._out = np.zeros(2 * n + 17), np.zeros((3 + 2 * n) * (4 + 2 * n) + 3)
        prior = np.array([o.force, o.rotation, o.translation, o.force_time, o.drift_time])
        self._robot.call("estimator_start", _at(self._room), self._robot.memory, _at(prior))

    def measured(self, time: float, joints: tuple[ArrayLike, ArrayLike], *readings: TipReading | BaseReading) -> float:
        """Squared innovations, divided by their covariance, of readings at a time, s, with the joint values at that
        time.

        The readings update the estimate.

        Raises:
            InputError: a reading with a rotation, or one that is too late.
            SolveError: the branch of the model ends.
        """
        n, into = self._robot.n, self._in
        into[:] = 0.0
        into[0], into[1 : 2 * n + 1] = time, np.concatenate([vector("joints", each, n) for each in joints])
        for reading in readings:
            if isinstance(reading, TipReading):
                if reading.rotation is not None:
                    raise InputError("a C library takes in positions and directions of the tip, no rotations")
                into[2 * n + 1 : 2 * n + 5] = *vector("position", reading.position, 3), reading.noise
                if reading.direction is not None:
                    into[2 * n + 5 : 2 * n + 9] = *vector("direction", reading.direction, 3), reading.angle_noise
            else:
                wrench = vector("wrench", reading.wrench, 6)
                into[2 * n + 9 :] = *wrench[:3], reading.force_noise, *wrench[3:], reading.moment_noise
        self._robot.call("measure", _at(self._room), self._robot.memory, _at(into), _at(self._out))
        return float(self._out[-2])

    def estimate(self) -> tuple[Array, Array]:
        """State (K,) after the last reading, and its covariance (K, K)."""
        k = 3 + 2 * self._robot.n
        return self._out[1 : k + 1].copy(), self._out[k + 1 : k + 1 + k * k].reshape(k, k).copy()


class CServo:
    """Servo of a C library with the interface of `Servo`, for tip position and direction or a path to joint values.

    Raises:
        InputError: options that only the servo in Python has: bodies' clearance, priorities, an objective other than
            the margin. A start outside the limits or the order of the tubes. Different translations of carriages
            that the tube lengths force to move together.
        SolveError: the library finds no stable equilibrium at the start from tubes without torsion.
    """

    def __init__(
        self, library: CLibrary, start: tuple[ArrayLike, ArrayLike], options: ServoOptions | None = None
    ) -> None:
        self.options = options or ServoOptions()
        o = self.options
        if o.clearance or o.objective not in (None, "margin") or o.priorities != ServoOptions().priorities:
            raise InputError(
                "the servo of a C library supports neither obstacles nor priorities, and only the objective margin"
            )
        self.space = joint_space(library.robot)
        self._robot = CRobot(library)
        if violation := self.space.outside(configuration(self.space, "start", start)):
            raise InputError(f"start is out of range: {violation}")
        self.equilibrium = self._before = self._robot.solve(*start)

    @property
    def slopes(self) -> CSlopes:
        """Derivatives of the equilibrium by the joint values."""
        return self._robot.slopes()

    def snap_distance(self, most: float) -> float | None:
        """Rotation of all tubes that is proved to cause no snap, rad, at most `most`."""
        return self._robot.snap_distance(most)

    def step(self, command: Command, dt: float) -> ServoStep[CPose]:
        """Result of one step of `dt` seconds, as `Servo.step`; raises InputError for unsupported commands."""
        dt = time_step(dt)
        check_places(command, self.space.robot)
        if command.pivot is not None:
            raise InputError("the servo of a C library does not support a pivot")
        current, o = self.equilibrium, self.options
        self._before = current
        goal_position = current.tip_position if command.position is None else command.position
        velocity = np.zeros(3) if command.velocity is None else command.velocity
        pointing = np.zeros(3) if command.direction is None else command.direction
        # Without a target the robot brakes.
        commanded = velocity.any() or command.position is not None or command.direction is not None
        push = o.push if o.objective and (commanded or not self.limited) else 0.0
        speed = o.speed if commanded or not self.limited else 0.0
        accelerations = o.turn_acceleration or 0.0, o.shift_acceleration or 0.0
        limits = [speed, o.turn_rate, o.shift_rate, o.min_margin, push, *accelerations]
        seeks = SEEKING_STEPS if command.closest else 0
        snap = o.min_snap_distance or 0.0
        arguments = np.concatenate([[dt], goal_position, pointing, limits, [snap], velocity, [seeks]])
        if command.joints is not None:
            rotations, shift = self.space.split(at_most(configuration(self.space, "joints", command.joints), "joints"))
            if not self.space.admissible(self.space.join(rotations, np.array(shift), "joints")):
                return ServoStep(current, Why.HELD | Why.RANGE, np.nan, np.nan)
            self.equilibrium, why = self._robot.servo_joints(arguments, rotations, shift)
            return ServoStep(self.equilibrium, why, np.nan, np.nan)
        self.equilibrium, distance, angle, why = self._robot.servo(arguments)
        return ServoStep(self.equilibrium, why, distance, angle)

    @property
    def limited(self) -> bool:
        """True if the servo limits accelerations."""
        return self.options.turn_acceleration is not None or self.options.shift_acceleration is not None

    @property
    def moving(self) -> bool:
        """True if the robot must brake before it rests."""
        current, before = self.equilibrium, self._before
        moved = max(
            np.abs(current.rotations - before.rotations).max(), np.abs(current.translations - before.translations).max()
        )
        return self.limited and bool(moved > RESTS)

    def bear(self, force: ArrayLike = (0, 0, 0), gravity: ArrayLike = (0, 0, 0)) -> CPose:
        """Equilibrium under a measured force (3,) at the tip, N, and an acceleration (3,) of gravity, m/s^2.

        Later steps are made under it. Call it before each step with the newest force.

        Raises:
            InputError: the library was made without loads.
            SolveError: the branch ends at a smaller load; the last one stays.
        """
        self.equilibrium = self._robot.bear(force, gravity)
        return self.equilibrium

    def undo(self) -> None:
        """Undo the last step, which was not sent; without effect if there was none or it was already undone."""
        if self.equilibrium is not self._before:
            self._robot.undo()
            self.equilibrium = self._before

    def resume(self, joints: Configuration) -> None:
        """Continue at rest from joint values reached by another motion, on the branch of the straight path to them."""
        q, least = configuration(self.space, "joints", joints), self.options.min_margin
        if violation := self.space.outside(q):
            raise InputError(f"joints are out of range: {violation}")
        rotations, shift = self.space.split(q)
        reached = self._robot.follow(rotations, np.array(shift))
        if reached.margin < least:
            self._robot.undo()
            raise InputError(f"joints have margin {reached.margin:.3g}; it must be min_margin, {least:g}, or more")
        self.equilibrium = self._before = reached


def _at(array: Array) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def _compiled(library: CLibrary) -> Path:
    """The shared library of the sources, in the cache."""
    header = library.files[f"{library.prefix}_robot.h"]
    texts = [
        text.replace(f'#include "{library.prefix}_robot.h"\n', header)
        for name, text in library.files.items()
        if name.removeprefix(library.prefix) in ("_robot.c", "_load.c")
    ]
    name = hashlib.sha256("\0".join(texts).encode()).hexdigest()[:32]
    path = cache_directory() / "libraries" / f"{name}.so"
    if not path.exists():
        with tempfile.TemporaryDirectory() as work:
            more = [Path(work) / f"{k}.c" for k in range(len(texts) - 1)]
            for other, text in zip(more, texts[1:], strict=True):
                other.write_text(text)
            compile_to(texts[0], path, ["-std=c99", "-march=native", *map(str, more)])
    return path

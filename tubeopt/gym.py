"""Gymnasium environments of tube robots: reach a point, or follow a path, without a snap.

Observations and actions follow the layout of CTR-Reach (gym-ctr-reach), without a comparison with its code. Of n
tubes, inner to outer, a proximal end beta <= 0 (m behind the plate) and a rotation alpha (rad) are known. An
observation has (cos alpha, sin alpha, beta) of each tube, the vector from tip to goal, and the tolerance. An action has
n changes of beta, then n of alpha. The reward is -1 until the tip is within the tolerance, and 0 there. Each robot
follows its branch of equilibria; where that ends, it snaps, and the episode with it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from .arguments import typed
from .display import Displayed
from .errors import InputError, finite_array, vector, whole, without_unit_warnings
from .files.field_metadata import POSITIVE, Checked, OneOf, Range, unit
from .inverse.joints import JointSpace, joint_space
from .robots.concentric import ConcentricRobot
from .robots.file import load_robot
from .robots.limits import check_target
from .robots.robot import Robot
from .solvers.compiled.binding import Branches
from .typing import Array, Mask

try:
    import gymnasium
    from gymnasium.spaces import Box
    from gymnasium.spaces import Dict as DictSpace
    from gymnasium.vector import AutoresetMode, VectorEnv
    from gymnasium.vector.utils import batch_space
except ImportError as error:
    raise InputError("gymnasium is missing; pip install 'tubeopt[gym]' brings it") from error

TASKS = ("reach", "path")
REPRESENTATIONS = ("egocentric", "proprioceptive")

# Joint values that are known to be in order, of which episodes begin and end at random ones.
KNOWN = 4096

# Draws of a start or a goal before a robot counts as one without equilibria, and sweeps that bring tubes into order.
DRAWS, SWEEPS = 100, 3


@dataclass(frozen=True)
class GymOptions(Checked, Displayed):
    """Task of an environment; the defaults are those of CTR-Reach with the final tolerance."""

    task: Annotated[str, OneOf(TASKS)] = "reach"
    """"reach": an episode ends within the tolerance of a point. "path": the goal moves for the whole episode."""
    turn: Annotated[float, unit("deg"), POSITIVE, "largest change of a rotation by an action"] = math.radians(5)
    shift: Annotated[float, unit("mm"), POSITIVE, "largest change of a translation by an action"] = 1e-3
    repeats: Annotated[int, Range(minimum=1), "times that a step repeats its action"] = 10
    tolerance: Annotated[float, unit("mm"), POSITIVE, "distance of the tip from its goal that counts as none"] = 1e-3
    largest_tolerance: Annotated[float, unit("mm"), POSITIVE, "largest tolerance of a curriculum"] = 0.02
    steps: Annotated[int, Range(minimum=1), "steps of an episode at most"] = 150
    representation: Annotated[str, OneOf(REPRESENTATIONS)] = "egocentric"
    """"egocentric": joint values of a tube relative to the next inner one. "proprioceptive": each its own."""
    randomisation: Annotated[
        float, Range(minimum=0.0, below=1.0), "largest relative change of stiffnesses and curvatures"
    ] = 0.0


@typed
class CtrVectorEnv(VectorEnv[Any, Any, Any]):
    """Environments of one robot, solved by one call of the compiled kernel per step.

    An ended episode begins anew with the next step (`AutoresetMode.NEXT_STEP`).

    Args:
        robot: a robot, or the path or name of its file.   num_envs: number of environments.
        options: see `GymOptions`; or its fields by name.

    Raises:
        InputError: there is no compiled kernel (more than 6 tubes, no C compiler), or `randomisation` for a robot that
            is not concentric.
    """

    def __init__(
        self, robot: Robot | str = "thesis_ctr", num_envs: int = 1, options: GymOptions | None = None, **fields: Any
    ) -> None:
        self.robot = load_robot(robot) if isinstance(robot, str) else robot
        self.options = replace(options or GymOptions(), **fields)
        whole("num_envs", num_envs, 1)
        if self.options.randomisation and not isinstance(self.robot, ConcentricRobot):
            raise InputError(f"randomisation is {self.options.randomisation:g}; it supports concentric robots only")
        self.num_envs, self.tolerance = num_envs, self.options.tolerance
        self.render_mode = None
        self.metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP, "render_modes": []}
        self._space: JointSpace = joint_space(self.robot)
        self._known = self._space.sample(KNOWN)
        self._straight = np.array([tube.straight_length for tube in self.robot.tubes])
        try:
            self._arms, self._goals = Branches(self.robot, num_envs), Branches(self.robot, num_envs)
        except LookupError:
            reason = f"robot has {self.robot.n_tubes} tubes and no compiled kernel"
            raise InputError(f"{reason}; at most 6 tubes are supported, with a C compiler") from None
        self._q: Array = np.tile(self._known[0], (num_envs, 1))
        self._from, self._to = self._q.copy(), self._q.copy()
        self._time = np.zeros(num_envs, dtype=int)
        self._over: Mask = np.zeros(num_envs, dtype=bool)
        self._most = np.repeat([self.options.shift, self.options.turn], self.robot.n_tubes)
        self.single_observation_space, self.single_action_space = self._spaces()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)

    def _spaces(self) -> tuple[Any, Any]:
        n, o = self.robot.n_tubes, self.options
        longest = np.float32(max(self._space.longest, max(tube.length for tube in self.robot.tubes)) * (1 + 1e-6))
        joint = np.tile(np.array([1, 1, longest], dtype=np.float32), n)
        largest = max(o.largest_tolerance, o.tolerance)
        low = np.concatenate([-joint, np.full(3, -2 * longest), [0.0]]).astype(np.float32)
        high = np.concatenate([joint, np.full(3, 2 * longest), [largest]]).astype(np.float32)
        position = Box(-longest, longest, (3,), np.float32)
        action = self._most.astype(np.float32)
        observed: dict[str, Any] = {
            "observation": Box(low, high, dtype=np.float32),
            "achieved_goal": position,
            "desired_goal": position,
        }
        return DictSpace(observed), Box(-action, action, dtype=np.float32)

    def reset(
        self, *, seed: Any = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Array], dict[str, Any]]:
        """Begin all episodes anew; `options` may have "goal" (3,), m, for all of them.

        Raises:
            InputError: another option, or a goal more than ten tube lengths away.
        """
        known = dict(options or {})
        fixed = known.pop("goal", None)
        if known:
            raise InputError(f"options have {', '.join(map(repr, known))}; only 'goal' is possible")
        if fixed is not None:
            fixed = vector("goal", fixed, 3, "x, y, z")
            check_target(self.robot.tubes, "goal", fixed)
        super().reset(seed=seed if seed is None or isinstance(seed, int) else seed[0])
        self._begin(np.ones(self.num_envs, dtype=bool))
        self._over[:] = False
        self._fixed = fixed
        return self._observed(), self._info()

    def step(self, actions: Array) -> tuple[dict[str, Array], Array, Mask, Mask, dict[str, Any]]:
        """Move all robots by changes (N, 2n) of beta, m, and alpha, rad; an ended episode begins anew.

        Raises:
            InputError: actions of another shape, or with NaN.
        """
        asked = finite_array("actions", actions, 2)
        if asked.shape != (self.num_envs, len(self._most)):
            raise InputError(f"actions have shape {asked.shape}; it must be {(self.num_envs, len(self._most))}")
        begins, goes, o = self._over.copy(), ~self._over, self.options
        if begins.any():
            self._begin(begins)
        action = np.clip(asked, -self._most, self._most) * goes[:, None]
        snaps: Mask = self._move(action) & goes
        self._time += goes
        if o.task == "path":
            part = np.minimum(self._time / o.steps, 1.0)[:, None]
            self._goals.go(*self._joints(self._from + part * (self._to - self._from)), np.zeros_like(goes))
        observed, info = self._observed(), self._info()
        distance = np.linalg.norm(observed["desired_goal"] - observed["achieved_goal"], axis=1)
        reward = -(distance > self.tolerance).astype(float)
        reward[snaps] -= o.steps - self._time[snaps]  # a snap must not end an episode early
        reward[begins] = 0.0
        terminated = snaps | ((distance <= self.tolerance) & goes if o.task == "reach" else False)
        truncated = (self._time >= o.steps) & ~terminated & goes
        self._over = terminated | truncated
        return observed, reward, terminated, truncated, info | {"snap": snaps}

    def compute_reward(self, achieved: Array, desired: Array, info: Any) -> Array:
        """(...,) rewards of tips (..., 3) at goals, without that of a snap, as hindsight replay asks."""
        far = np.linalg.norm(np.asarray(achieved) - np.asarray(desired), axis=-1) > self.tolerance
        return np.asarray(-far.astype(float))

    @property
    def margins(self) -> Array:
        """(N,) stability margins."""
        return self._arms.margins

    _fixed: Array | None = None

    def _joints(self, q: Array) -> tuple[Array, Array]:
        """(N, n) rotations and translations at independent joint values (N, m)."""
        joints, n = q @ self._space.spread.T + self._space.offset, self.robot.n_tubes
        return joints[:, :n], np.minimum(joints[:, n:], self._straight)

    def _begin(self, rows: Mask) -> None:
        """Draw robots, starts and goals of rows (N,)."""
        for row in np.flatnonzero(rows) if self.options.randomisation else ():
            robot = self._drawn()
            self._arms.use(int(row), robot)
            self._goals.use(int(row), robot)
        for arms, joints in ((self._arms, self._q), (self._goals, self._to)):
            left = rows.copy()
            for _ in range(DRAWS):
                drawn = self._known[self.np_random.integers(KNOWN, size=self.num_envs)]
                turns = slice(self.robot.n_tubes)
                largest = np.minimum(math.pi, self._space.upper[turns])
                drawn[:, turns] = self.np_random.uniform(
                    np.maximum(-math.pi, self._space.lower[turns]), largest, (self.num_envs, largest.size)
                )
                joints[left] = drawn[left]
                solved = ~arms.go(*self._joints(np.where(left[:, None], joints, self._held(arms))), left)
                left &= ~solved
                if not left.any():
                    break
            else:
                raise InputError("no stable equilibrium was found at random joint values; the robot has none")
        self._from[rows] = self._q[rows]
        self._time[rows] = 0
        if self.options.task == "path":  # the goal begins where the tip is
            self._goals.go(*self._joints(np.where(rows[:, None], self._from, self._held(self._goals))), rows)

    def _held(self, arms: Branches) -> Array:
        """(N, m) joint values of arms."""
        first = [self.robot.n_tubes + tubes[0] for tubes in self._space.carriages]
        shift = np.hstack([arms.rotations, arms.translations])[:, first] - self._space.offset[first]
        return np.hstack([arms.rotations, shift])

    def _move(self, action: Array) -> Mask:
        """Move the joints by an action (N, 2n), in order and within ranges; returns which robots snap."""
        space, n = self._space, self.robot.n_tubes
        carriages = [list(tubes) for tubes in space.carriages]
        change = np.hstack([action[:, n:], *[action[:, tubes].mean(1, keepdims=True) for tubes in carriages]])
        before, q = self._q.copy(), self._q
        for _ in range(self.options.repeats):
            q = np.clip(q + change, space.lower, space.upper)
            for _ in range(SWEEPS):
                for row, minimum in zip(space.rows, space.row_lower, strict=True):
                    joint = int(np.flatnonzero(row)[0])  # the innermost tube is moved, as in CTR-Reach
                    q[:, joint] += np.maximum(minimum - q @ row, 0.0) / row[joint]
        inside = (q >= space.lower - 1e-12) & (q <= space.upper + 1e-12)
        fits = np.hstack([q @ space.rows.T >= space.row_lower - 1e-9, inside]).all(1, keepdims=True)
        self._q = np.where(fits, q, before)
        snaps = self._arms.go(*self._joints(self._q), np.zeros(self.num_envs, dtype=bool))
        self._q[snaps] = before[snaps]
        return snaps

    @without_unit_warnings()
    def _drawn(self) -> ConcentricRobot:
        """The robot with random stiffnesses and curvatures."""
        assert isinstance(self.robot, ConcentricRobot)
        largest, tubes = self.options.randomisation, []
        for tube in self.robot.tubes:
            bending, torsional, bent = (1 + self.np_random.uniform(-largest, largest, 3)).tolist()
            stiffness = {"bending_stiffness": tube.bending_stiffness * bending}
            stiffness["torsional_stiffness"] = tube.torsional_stiffness * torsional
            shape: dict[str, Any] = {"curvature": tube.curvature * bent}
            if tube.pieces:
                shape = {"pieces": tuple(piece.stiffened(bending) for piece in tube.pieces)}
                stiffness["torsional_stiffness"] = tube.torsional_stiffness * bending
            tubes.append(replace(tube, **stiffness, **shape))
        return replace(self.robot, tubes=tuple(tubes))

    def _observed(self) -> dict[str, Array]:
        rotations, shift = self._arms.rotations, self._arms.translations
        joints = np.stack([rotations, shift - self._straight])
        if self.options.representation == "egocentric":
            joints = np.diff(joints, axis=2, prepend=0.0)
        tips = self._arms.tips
        goals = self._goals.tips if self._fixed is None else np.broadcast_to(self._fixed, tips.shape)
        each = np.stack([np.cos(joints[0]), np.sin(joints[0]), joints[1]], axis=2).reshape(self.num_envs, -1)
        observation = np.hstack([each, goals - tips, np.full((self.num_envs, 1), self.tolerance)])
        parts = {"achieved_goal": tips, "desired_goal": goals, "observation": observation}
        return {name: part.astype(np.float32) for name, part in parts.items()}

    def _info(self) -> dict[str, Any]:
        tips = self._arms.tips
        goals = self._goals.tips if self._fixed is None else self._fixed
        distance = np.linalg.norm(tips - goals, axis=1)
        return {"error": distance, "is_success": distance <= self.tolerance, "margin": self.margins.copy()}


@typed
class CtrEnv(gymnasium.Env[Any, Any]):
    """One environment; arguments and errors as of `CtrVectorEnv`.

    Examples:
        >>> from tubeopt.gym import CtrEnv
        >>> env = CtrEnv("thesis_ctr")
        >>> observation, info = env.reset(seed=0)
        >>> observation["observation"].shape, env.action_space.shape
        ((13,), (6,))
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012  as gymnasium declares it

    def __init__(self, robot: Robot | str = "thesis_ctr", options: GymOptions | None = None, **fields: Any) -> None:
        self.many = CtrVectorEnv(robot, 1, options, **fields)
        self.observation_space = self.many.single_observation_space
        self.action_space = self.many.single_action_space
        self.render_mode = None

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin an episode; `options` may have "goal" (3,), m."""
        super().reset(seed=seed)
        observed, info = self.many.reset(seed=seed, options=options)
        return _first(observed), _first(info)

    def step(self, action: Array) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move the robot by changes (2n,) of beta, m, and alpha, rad."""
        observed, reward, terminated, truncated, info = self.many.step(np.asarray(action)[None])
        return _first(observed), float(reward[0]), bool(terminated[0]), bool(truncated[0]), _first(info)

    def compute_reward(self, achieved: Array, desired: Array, info: Any) -> Array:
        """Rewards (...,) of tips (..., 3) at goals, without that of a snap."""
        return self.many.compute_reward(achieved, desired, info)


def _first(table: Mapping[str, Array]) -> dict[str, Any]:
    return {name: values[0] for name, values in table.items()}


for _task in TASKS:
    gymnasium.register(
        id=f"tubeopt/{_task.capitalize()}-v0",
        entry_point="tubeopt.gym:CtrEnv",
        vector_entry_point="tubeopt.gym:CtrVectorEnv",
        kwargs={"task": _task},
    )

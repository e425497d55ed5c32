"""Starts for the search: a table of stable configurations per robot, built once and kept on disk.

The whole robot can be turned about the axis of its plate, and every tube by whole turns, without another change of its
shape: so configurations are compared with a target by height and distance from the axis, and turned to its azimuth.
"""

from __future__ import annotations

import hashlib
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from ..display import in_full
from ..equilibrium.batch import solved_batch
from ..errors import InputError
from ..files.files import atomic_write
from ..solvers.compiled.library import cache_directory
from ..typing import Array
from .clock import Clock
from .joints import JointSpace

VERSION = 4
"""Of what the table holds: a change of it makes old files unread."""

SIZE, SIZE_OF_MANY = 2048, 512
"""Configurations per table; the second for more than `MANY` joints, among which a start leads to most targets."""

MANY = 8

WIDEST = np.pi / 2
"""Largest separation of the tubes of an eccentric segment in the table; 120 deg is straight."""

POOL = 400
"""Configurations, the most promising, among which starts are spread."""

DIRECTION_WEIGHT, NEARNESS_WEIGHT = 0.35, 0.02
"""Weights, in the ranking of starts, of the direction error and of the distance from a reference (in units of the
joints' scales), relative to the position error over the robot's length."""

LEAST_MARGIN = 0.01
"""Margin from which on a configuration is worth keeping."""


@dataclass(frozen=True, eq=False)
class StartTable:
    """Stable configurations."""

    q: Array
    """(N, m) joint values."""
    tip: Array
    """(N, 3) m."""
    direction: Array
    """(N, 3) along which the tip points."""
    margin: Array
    """(N,)."""
    tried: int
    """Configurations of which these are the stable ones."""
    whole: bool
    """Whether time did not run out before all were tried."""

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array]:
        """What it says of every configuration."""
        return self.q, self.tip, self.direction, self.margin


def build_table(
    space: JointSpace, size: int, clock: Clock | None = None, begun: StartTable | None = None
) -> StartTable:
    """Solve `size` configurations spread over what the limits allow, or as many as there is time for, after those of a
    table that was begun; keep those with a stable equilibrium."""
    clock = clock or Clock(math.inf)
    q = _by_mirror(space, space.sample(size))
    n, m = space.robot.n_tubes, len(space.lower)
    if begun is None:
        begun = StartTable(np.empty((0, m)), np.empty((0, 3)), np.empty((0, 3)), np.empty(0), 0, whole=False)
    parts, tried = [begun.arrays], begun.tried
    count = 8  # configurations between two looks at the clock, more where these are quick
    while tried < size and not clock.over:
        began, some = clock.seconds, q[tried : tried + count]
        joint = space.joint(some)
        found = solved_batch(space.robot, joint[:, :n], joint[:, n:])
        kept = found.converged & (np.nan_to_num(found.margin) >= LEAST_MARGIN)
        parts.append((some[kept], found.tip_position[kept], found.tip_rotation[kept, :, 2], found.margin[kept]))
        tried += count
        if clock.seconds - began < 0.02:
            count = min(2 * count, 128)
    solved, tip, direction, margin = (np.concatenate(each) for each in zip(*parts, strict=True))
    table = StartTable(solved, tip, direction, margin, tried, whole=tried >= size)
    if table.whole and not len(table.q):
        raise InputError("no stable equilibrium was found within the limits")
    return table


def _by_mirror(space: JointSpace, q: Array) -> Array:
    """Samples (N, m) with the three tubes of every eccentric segment turned as a hand would: the first to a direction,
    the others to either side of it. Three independent rotations mostly wind a long transmission up until it snaps."""
    if not space.assembly.eccentric:
        return q
    out = q.copy()
    for tubes in space.robot.moving_together:
        middle, apart = q[:, tubes[0]], WIDEST * (q[:, tubes[1]] - space.lower[tubes[1]])
        span = space.upper[tubes[1]] - space.lower[tubes[1]]
        apart = apart / span if span > 0 else np.zeros(len(q))
        out[:, list(tubes)] = np.column_stack([middle, middle + apart, middle - apart])
    n = space.robot.n_tubes
    out[:, :n] = np.clip(space.wrap(out, space.middle())[:, :n], space.lower[:n], space.upper[:n])
    return out


def start_table(space: JointSpace, size: int | None = None, clock: Clock | None = None) -> StartTable:
    """The table of a joint space: from the cache on disk as far as it is there, else built, and put there."""
    size = size or (SIZE if len(space.lower) <= MANY else SIZE_OF_MANY)
    path = cache_directory() / f"inverse-{_key(space, size)}.npz"
    stored = _read(path, len(space.lower), size)
    if stored is not None and stored.whole:
        return stored
    table = build_table(space, size, clock, stored)
    if table.tried == (stored.tried if stored is not None else 0):
        return table
    try:
        with atomic_write(path) as temporary, open(temporary, "wb") as file:
            np.savez(file, q=table.q, tip=table.tip, direction=table.direction, margin=table.margin, tried=table.tried)
    except InputError:
        pass  # Without a place to keep it, the table is built anew in the next process: slower, not wrong.
    return table


def _key(space: JointSpace, size: int) -> str:
    """Hash of all that the table depends on."""
    tubes = in_full((VERSION, size, type(space.robot).__name__, space.robot.tubes, space.carriages))
    assembly = space.assembly
    digest = hashlib.sha256(tubes.encode())
    for array in (
        space.lower,
        space.upper,
        space.rows,
        space.least,
        space.joint(space.lower),
        assembly.offset,
        assembly.offset_angle,
    ):
        digest.update(np.ascontiguousarray(array, dtype=float).tobytes())
    return digest.hexdigest()[:32]


def _read(path: Path, joints: int, size: int) -> StartTable | None:
    """The table in a file, as far as it was built; None where there is none, or the file is damaged."""
    try:
        # The content, not the path: of a damaged file numpy would leave the handle open.
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            tried = int(file["tried"])
            table = StartTable(file["q"], file["tip"], file["direction"], file["margin"], tried, whole=tried >= size)
    except (OSError, ValueError, KeyError, EOFError, BadZipFile):
        return None
    count = len(table.margin)
    shapes = [(count, joints), (count, 3), (count, 3), (count,)]
    fitting = [each.shape for each in table.arrays] == shapes
    return table if fitting and (count or not table.whole) else None


def nearest_starts(
    space: JointSpace,
    table: StartTable,
    target: tuple[Array, Array | None],
    *,
    min_margin: float,
    reference: Array | None,
) -> Array:
    """(k, m) configurations of a table, turned towards a target (position, direction or None), most promising first.

    Those with less than `min_margin` are left out, and those that cannot be turned there come with the turn that the
    limits allow.
    """
    position, direction = target
    mirrored = direction is not None and not space.assembly.eccentric
    known = _mirrored(space, table) if mirrored else table
    chosen = known.margin >= min_margin
    q, tip, pointing = known.q[chosen], known.tip[chosen], known.direction[chosen]
    if not len(q):
        return q
    near = space.middle() if reference is None else reference
    turn = np.arctan2(position[1], position[0]) - np.arctan2(tip[:, 1], tip[:, 0])
    n = space.robot.n_tubes
    turned = q.copy()
    turned[:, :n] += turn[:, None]
    turned = space.wrap(turned, near)
    outside = ~((turned >= space.lower) & (turned <= space.upper)).all(1)
    # Where whole turns do not help, turn as far as the narrowest range allows.
    least, most = (space.lower[:n] - q[:, :n]).max(1), (space.upper[:n] - q[:, :n]).min(1)
    part = np.clip((turn + np.pi) % (2 * np.pi) - np.pi, least, np.maximum(most, least))
    turned[outside] = q[outside]
    turned[outside, :n] += part[outside, None]
    turn = np.where(outside, part, turn)
    cost = np.linalg.norm(_turned(tip, turn) - position, axis=1) / space.length
    if direction is not None:
        cost = cost + DIRECTION_WEIGHT * np.linalg.norm(_turned(pointing, turn) - direction, axis=1)
    if reference is not None:
        cost = cost + NEARNESS_WEIGHT * np.linalg.norm((turned - reference) / space.scale, axis=1)
    # Rounded, so that round-off does not choose among mirror images.
    return space.clip(turned[np.argsort(np.round(cost, 9), kind="stable")])


def spread_starts(space: JointSpace, q: Array, count: int, *, first: int) -> Iterator[Array]:
    """At most `count` of joint values (k, m) sorted by promise: the `first` of them, then such as differ most from all
    chosen before, among the `POOL` most promising; each is looked for when it is asked for."""
    if len(q) <= first:
        yield from q
        return
    q = q[: max(POOL, first + 1)]
    yield from q[: max(first, 1)]
    n = space.robot.n_tubes
    relative = q[:, :n] - q[:, n - 1 : n]
    # Rotations against the outermost tube, as points of circles; the turn of the whole robot follows from the target.
    features = np.hstack([np.cos(relative), np.sin(relative), q[:, n:] / space.scale[n:]])
    gap = np.min([np.linalg.norm(features - own, axis=1) for own in features[: max(first, 1)]], axis=0)
    for _ in range(min(count, len(q)) - max(first, 1)):
        farthest = int(np.argmax(np.round(gap, 9)))
        if gap[farthest] <= 0:
            return
        yield q[farthest]
        gap = np.minimum(gap, np.linalg.norm(features - features[farthest], axis=1))


def _mirrored(space: JointSpace, table: StartTable) -> StartTable:
    """The table with the mirror image of every configuration: all rotations negative, seen in the plane x = 0."""
    flipped, mirror = table.q.copy(), np.array([-1.0, 1.0, 1.0])
    flipped[:, : space.robot.n_tubes] *= -1
    flipped = space.wrap(flipped, space.middle())
    inside = ((flipped >= space.lower) & (flipped <= space.upper)).all(1)
    images = flipped, table.tip * mirror, table.direction * mirror, table.margin
    both = (np.concatenate([own, image[inside]]) for own, image in zip(table.arrays, images, strict=True))
    q, tip, direction, margin = both
    return StartTable(q, tip, direction, margin, table.tried, table.whole)


def _turned(vectors: Array, angle: Array) -> Array:
    """Vectors (N, 3) turned about z by angles (N,)."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y, z = vectors.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y, z])

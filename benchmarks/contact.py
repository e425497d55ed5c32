"""Arms that touch walls against stiff springs in the limit.

    python -m benchmarks.contact [--arms 1000] [--seed 0]

Robots of configs/robots stand at random joint values among one to five random bodies that reach into the free arm. The
reference knows nothing of the solver: springs along the walls grow stiffer by the factor 8, from none to hard ones, and
the equations of loaded arms, written once more, are solved by shooting from the plate. Its limit is extrapolated.
Counted are:

    wrong       tips that differ by more than 1e-6 m, or forces by more than 1 mN
    elsewhere   springs that lead the arm to another equilibrium; then they start from the pose itself
    open        gap times force above 1e-9 J
    changed     poses that a wall out of reach changes in any bit
    no minimum  poses without a positive margin, with a wall deeper in the arm than 0.2 um, or with a wall that pulls

Every pose with contacts is also integrated by DOP853 under its contact forces.

A second table times one contact: from no start, and from the solution 0.02 rad of a tube before, as motions are solved.
A third one deploys thesis_ctr through five vessels with forces up to 0.5 N. All poses on the way are integrated by
DOP853. The arm at the last joint values without the vessel shows by how much the vessel guides it.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import tubeopt
from benchmarks.timing import ROOT, show, summarise, table
from tubeopt import ConcentricRobot, Equilibrium, SolveError
from tubeopt.bodies import Capsule, Corridor, HalfSpace, Sphere
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.equilibrium.wall_contact import Walls, start_of
from tubeopt.inverse.joints import joint_space

Array = NDArray[np.float64]

MOST_BODIES, STEPS, PIECES, IN_ZONE = 5, 600, 24, 60
"""Most bodies, steps of the integration, pieces that are shot separately, and steps per zone of contact."""

SOFTEST, SOFT, STIFFER = 1e2, 3e7, 8.0
"""Stiffness (N/m^2) of the first springs and of the last but one, and the largest factor between two of them."""

ZONE = 2e-4
"""Half length (m) of a zone of contact with the first springs, from a pose that is known."""

LEAST, LIMITS = 1.05, 4
"""Least factor between two stiffnesses, and number of limits that are tried."""

SAME_BRANCH = 1e-3
"""Distance (m) of two tips that are not on one branch."""

DEEP = 2e-7
"""Largest depth (m) of a wall in the arm, whose centreline is interpolated to a few 1e-8 m."""

TIP, FORCE, COMPLEMENTARITY = 1e-6, 1e-3, 1e-9
"""Largest differences of tip, m, and force, N, and largest gap times force, J."""


@dataclass(frozen=True, eq=False)
class Case:
    """A robot at joint values among bodies, and its arm without them."""

    free: Equilibrium
    bodies: tuple[Any, ...]


@lru_cache
def samples(robot: ConcentricRobot) -> Array:
    """Admissible joint values (N, 2 n)."""
    return joint_space(robot).sample(1024)


def random_case(robot: ConcentricRobot, random: np.random.Generator, count: int) -> Case | None:
    """Bodies (count,) that reach up to 3 mm into a free arm; None if the arm is short, unstable or meets itself."""
    space = joint_space(robot)
    many = samples(robot)
    _, translations = space.split(many[random.integers(len(many))])
    try:
        free = tubeopt.forward_kinematics(robot, random.uniform(-3, 3, robot.n_tubes), translations)
    except SolveError:
        return None
    length = free.arc_length[-1]
    if length < 0.03 or free.margin < 0.05:
        return None
    surface, bodies = ArmSurface(free), []
    for _ in range(50):
        i = int(np.searchsorted(free.arc_length, length * random.uniform(0.3, 1.0)))
        i = min(i, len(free.position) - 1)
        radius, depth = random.uniform(2e-3, 20e-3), random.uniform(0.5e-3, 3e-3)
        turn = random.uniform(0, 2 * np.pi)
        normal = free.frame[i] @ [np.cos(turn), np.sin(turn), 0.0]
        thick = float(surface.radius(free.arc_length[i : i + 1])[0])
        centre = free.position[i] - normal * (radius + thick - depth)
        axis = np.cross(normal, random.normal(size=3))
        axis *= 0.02 / np.linalg.norm(axis)
        body = (
            Sphere(tuple(centre), radius),
            Capsule(tuple(centre - axis), tuple(centre + axis), radius),
            HalfSpace(tuple(centre + normal * radius), tuple(normal)),
        )[random.integers(3)]
        if body.signed_distance(np.zeros(3)) > 4e-3:
            bodies.append(body)
        if len(bodies) == count:
            return Case(free, tuple(bodies))
    return None


# --- Springs along the walls ------------------------------------------------------------------------------------------


@lru_cache
def _functions(n: int) -> tuple[Any, Any, Any]:
    """Steps of RK4 along the arm for n tubes: all states, the slopes of all steps, and gaps of all states."""
    y, k, radius = casadi.SX.sym("y", 2 * n + 12), casadi.SX.sym("k"), casadi.SX.sym("radius")
    h, kb, moment, soft = (casadi.SX.sym(name, size) for name, size in (("h", 1), ("kb", n), ("moment", n), ("c", n)))
    body = casadi.SX.sym("body", 8, MOST_BODIES)

    def distance(point: Any, row: Any) -> Any:
        plane, a, b = row[0], row[1:4], row[4:7]
        along = casadi.dot(point - a, b - a) / (casadi.dot(b - a, b - a) + 1e-30)
        axis = a + casadi.fmin(casadi.fmax(along, 0), 1) * (b - a)
        round_body = casadi.sqrt(casadi.dot(point - axis, point - axis)) - row[7]
        return casadi.if_else(plane, casadi.dot(point - a, b), round_body)

    def gaps(point: Any, thick: Any) -> Any:
        return casadi.vertcat(*(distance(point, body[:, b]) - thick for b in range(MOST_BODIES)))

    def slope(y: Any) -> Any:
        theta, t, m, force = y[:n], y[n : 2 * n], y[2 * n : 2 * n + 2], y[2 * n + 2 : 2 * n + 5]
        point, q = y[2 * n + 5 : 2 * n + 8], y[2 * n + 8 :]
        ax, ay = moment * casadi.cos(theta), moment * casadi.sin(theta)
        u = casadi.vertcat(m[0] + casadi.sum1(ax), m[1] + casadi.sum1(ay)) / casadi.sum1(kb)
        w, v = q[0], q[1:]
        # Columns of the rotation matrix.
        rotation = (w**2 - casadi.dot(v, v)) * casadi.SX.eye(3) + 2 * v @ v.T + 2 * w * casadi.skew(v)
        local, total = rotation.T @ force, casadi.sum1(t)
        pressing = casadi.SX.zeros(3)
        at = casadi.SX.sym("at", 3)
        for b in range(MOST_BODIES):
            normal = casadi.gradient(distance(at, body[:, b]), at)
            part = casadi.fmax(0, -(distance(at, body[:, b]) - radius)) * normal
            pressing += k * casadi.substitute(part, at, point)
        turn = casadi.vertcat(u[0], u[1], 0)
        return casadi.vertcat(
            soft * t,
            u[0] * ay - u[1] * ax,
            -u[1] * total + local[1],
            u[0] * total - local[0],
            -pressing,
            rotation[:, 2],
            -casadi.dot(v, turn) / 2,
            (w * turn + casadi.cross(v, turn)) / 2,
        )

    one = slope(y)
    two = slope(y + h / 2 * one)
    three = slope(y + h / 2 * two)
    after = y + h / 6 * (one + 2 * two + 2 * three + slope(y + h * three))
    given = [casadi.vertcat(h, kb, moment, soft, radius), k, body]
    options = {"cse": True}
    step = casadi.Function("step", [y, *given], [after], options)
    slopes = casadi.Function("slopes", [y, *given], [casadi.jacobian(after, y)], options)
    gap = casadi.Function("gap", [y[2 * n + 5 : 2 * n + 8], radius, body], [gaps(y[2 * n + 5 : 2 * n + 8], radius)])
    with tempfile.TemporaryDirectory() as folder:
        code = casadi.CodeGenerator("springs.c")
        for each in (step, slopes, gap):
            code.add(each)
        code.generate(folder + "/")
        library = f"{folder}/springs.so"
        subprocess.run(["cc", "-O1", "-shared", "-fPIC", f"{folder}/springs.c", "-o", library, "-lm"], check=True)
        step, slopes, gap = (casadi.external(name, library) for name in ("step", "slopes", "gap"))
    return step.mapaccum(STEPS // PIECES).map(PIECES), slopes.map(STEPS), gap.map(STEPS + 1)


class Springs:
    """Arm of a case on springs along the walls, by shooting."""

    def __init__(self, case: Case, start: Equilibrium | None = None) -> None:
        free, robot = case.free if start is None else start, case.free.robot
        tubes, self.n = robot.tubes, robot.n_tubes
        self.kb, self.kt, kappa, straight, curved, outer = (
            np.array([getattr(tube, name) for tube in tubes])
            for name in (
                "bending_stiffness",
                "torsional_stiffness",
                "curvature",
                "straight_length",
                "curved_length",
                "outer_diameter",
            )
        )
        self.kappa, self.radius = kappa, outer / 2
        held = free.translations - straight
        self.bend, self.end = held + straight, held + straight + curved
        self.rotations, self.lever = free.rotations, -held
        self.length = float(self.end.max())
        self.walls, self.bodies = case.bodies, np.zeros((8, MOST_BODIES))
        self.bodies[1:7] = 10.0
        for k, body in enumerate(case.bodies):
            if isinstance(body, Sphere):
                self.bodies[:, k] = 0, *body.centre, *body.centre, body.radius
            elif isinstance(body, Capsule):
                self.bodies[:, k] = 0, *body.start, *body.end, body.radius
            else:
                self.bodies[:, k] = 1, *body.point, *body.normal, 0
        cuts = np.concatenate([self.bend, self.end, [0.0]])
        self.cuts = np.unique(cuts[(cuts >= 0) & (cuts <= self.length)])
        self.functions = _functions(self.n)
        self.zones: list[tuple[float, float]] = []
        self.press = self.thicker = 0.0
        self.scale = np.ones(2 * self.n + 12)
        self.scale[self.n : 2 * self.n] = self.kt / self.length
        self.scale[2 * self.n : 2 * self.n + 8] = np.repeat(
            self.kb.max() / self.length ** np.array([1, 2, -1]), (2, 3, 3)
        )
        self.scale[-7:-4] = self.length
        # From the arm without walls, and no force; or from a pose with its contact forces.
        self.s, torque, self.first = free.arc_length, free.torsion * self.kt[:, None], np.array([SOFTEST])
        still = np.zeros((5, len(self.s)))
        if start is not None and start.walls is not None:
            self.first = SOFT * STIFFER ** np.arange(4)
            # A thicker arm presses springs about as deep as these forces do, with a bend of 100 1/m of the gap; in
            # the limit it is as thick as it is.
            press = max(contact.size for contact in start.walls.contacts)
            self.press = 0.75 * press * np.sqrt(100 / 2)
            for contact in start.walls.contacts:
                still[2:] += np.where(self.s < contact.arc_length, np.array(contact.force)[:, None], 0.0)
                self.zones.append((contact.arc_length - ZONE, contact.arc_length + ZONE))
            present = self.end[:, None] > self.s - 1e-12
            moment = (present & (self.bend[:, None] < self.s)) * (self.kb * kappa)[:, None]
            turned_to = moment[None] * [np.cos(free.rotation), np.sin(free.rotation)]
            still[:2] = free.curvature.T * (self.kb @ present) - turned_to.sum(1)
        turned = Rotation.from_matrix(free.frame).as_quat(scalar_first=True)
        turned *= np.sign(np.cumprod(np.sign((turned * np.roll(turned, 1, axis=0)).sum(1)))[:, None])
        turned *= np.sign(turned[0, 0])
        self.states = np.vstack([free.rotation, torque, still, free.position.T, turned.T])

    def grid(self) -> Array:
        """Ends of the steps (STEPS + 1,): fine in zones of contact, the last steps without length."""
        parts = [self.cuts, *(np.linspace(*zone, IN_ZONE) for zone in self.zones)]
        inside = np.unique(np.clip(np.concatenate(parts), 0, self.length))
        left = STEPS - len(inside)
        parts += [np.linspace(0, self.length, max(left, 100))]
        out = np.unique(np.clip(np.concatenate(parts), 0, self.length))[: STEPS + 1]
        if out[-1] < self.length:
            raise SolveError("too many zones of contact")
        return np.concatenate([out, np.full(STEPS + 1 - len(out), self.length)])

    def run(self, nodes: Array, k: float, s: Array) -> tuple[Array, Array, Any]:
        """States (N, STEPS + 1) from nodes (N, PIECES), scaled equations of nodes and ends, and their derivative."""
        n, size, middle, per = self.n, 2 * self.n + 12, (s[1:] + s[:-1]) / 2, STEPS // PIECES
        present = self.end[:, None] > middle
        curved = present & (self.bend[:, None] < middle)
        thick = np.where(present, self.radius[:, None] + self.thicker, 0).max(0)
        kb = np.where(present, self.kb[:, None], 0.0)
        kb[:, ~present.any(0)] = 1.0
        moment = curved * (self.kb * self.kappa)[:, None]
        given = np.vstack([np.diff(s), kb, moment, present / self.kt[:, None], thick])
        hard, bodies, scale = np.full(STEPS, k), np.tile(self.bodies, STEPS), self.scale
        step, slopes, _ = self.functions
        after = np.array(step(nodes, given, hard, bodies))
        states = np.column_stack([nodes[:, 0], after])
        before = states[:, :-1].copy()
        before[:, ::per] = nodes
        each = np.array(slopes(before, given, hard, bodies)).reshape(size, STEPS, size).swapaxes(0, 1)
        each = each.reshape(PIECES, per, size, size)
        transfer = each[:, 0]
        # A trial step may overflow; it is then refused.
        with np.errstate(all="ignore"):
            for j in range(1, per):
                transfer = each[:, j] @ transfer
            transfer = transfer * scale / scale[:, None]
        last = after[:, per - 1 :: per]
        equations, total = [], PIECES * size
        slope = np.zeros((total, total))
        first = nodes[:, 0]
        plate = np.concatenate(
            [first[:n] - self.rotations - self.lever * first[n : 2 * n] / self.kt, first[-7:] - [0, 0, 0, 1, 0, 0, 0]]
        )
        equations.append(plate / np.concatenate([scale[:n], scale[-7:]]))
        slope[:n, :n], slope[:n, n : 2 * n] = np.eye(n), -np.diag(self.lever / self.kt * scale[n : 2 * n])
        slope[n : n + 7, size - 7 : size] = np.eye(7)
        row = n + 7
        for j in range(PIECES - 1):
            equations.append((last[:, j] - nodes[:, j + 1]) / scale)
            slope[row : row + size, j * size : (j + 1) * size] = transfer[j]
            slope[row : row + size, (j + 1) * size : (j + 2) * size] = -np.eye(size)
            row += size
        tip = slice(n, 2 * n + 5)
        equations.append(last[tip, -1] / scale[tip])
        slope[row:, -size:] = transfer[-1][tip]
        return states, np.concatenate(equations), slope

    def solve(self, k: float, s: Array) -> bool:
        """True if the arm is in equilibrium with springs of stiffness k, N/m^2, on a grid."""
        at = s[:: STEPS // PIECES][:PIECES]
        nodes = np.array([np.interp(at, self.s, row) for row in self.states])
        states, off, slope = self.run(nodes, k, s)
        for _ in range(20):
            if np.abs(off).max() < 1e-10:
                self.states, self.s = states, s
                return True
            change = -np.linalg.solve(slope, off).reshape(PIECES, -1).T * self.scale[:, None]
            size, before = 1.0, np.linalg.norm(off)
            while size > 0.02:
                trial = self.run(nodes + size * change, k, s)
                if np.linalg.norm(trial[1]) < (1 - size / 10) * before:
                    break
                size /= 2
            else:
                return False
            nodes, (states, off, slope) = nodes + size * change, trial
        return False

    def gaps(self, states: Array, s: Array) -> Array:
        """Gaps (bodies, STEPS + 1) along the arm, m."""
        thick = np.where(self.end[:, None] >= s - 1e-12, self.radius[:, None] + self.thicker, 0).max(0)
        bodies = np.tile(self.bodies, STEPS + 1)
        return np.array(self.functions[2](states[2 * self.n + 5 : 2 * self.n + 8], thick, bodies))

    def refine(self, states: Array, s: Array) -> None:
        """Zones around places where the arm is in a wall."""
        zones = []
        for gap in self.gaps(states, s):
            inside = np.flatnonzero(np.diff(np.concatenate([[False], gap < 0, [False]]).astype(int)))
            for first, last in inside.reshape(-1, 2):
                a, b = s[max(first - 1, 0)], s[min(last, len(s) - 1)]
                zones.append((a - 0.3 * (b - a), b + 0.3 * (b - a)))
        self.zones = zones

    def limits(self) -> Iterator[tuple[Array, Array]]:
        """Tip (3,), m, and forces (bodies, 3), N, of rigid walls: limits of springs ever stiffer, ever more accurate.

        It ends where Newton's method fails.
        """
        known = self.states, self.s, self.zones
        for first in self.first:
            (self.states, self.s, self.zones), softest = known, max(first, SOFT)
            try:
                soft = self._settle(first, 3)
            except SolveError:
                if first == self.first[-1]:
                    raise
            else:
                break
        if first < softest:
            soft = self._harden(first, softest)
        for k in softest * STIFFER ** np.arange(LIMITS):
            hard = self._harden(k, STIFFER * k)
            # Springs give way by k^(-2/3), as the length that they press grows with their depth.
            yield tuple((4 * b - a) / 3 for a, b in zip(soft, hard, strict=True))
            soft = hard

    def _harden(self, k: float, to: float) -> tuple[Array, Array]:
        """Tip (3,), m, and forces (bodies, 3), N, of springs of stiffness `to`, N/m^2, from springs of stiffness k.

        Raises:
            SolveError: Newton's method fails.
        """
        stiffer = STIFFER
        while k < to:
            known, following = (self.states, self.s, self.zones), min(k * stiffer, to)
            try:
                out = self._settle(following, 1 if following < to else 3)
            except SolveError:
                (self.states, self.s, self.zones), stiffer = known, stiffer**0.5
                if stiffer < LEAST:
                    raise
            else:
                k, stiffer = following, min(STIFFER, stiffer**1.5)
        return out

    def _settle(self, k: float, passes: int = 1) -> tuple[Array, Array]:
        """Tip (3,), m, and forces (bodies, 3), N, of springs of stiffness k, N/m^2."""
        self.thicker = (self.press / k) ** (2 / 3)
        for _ in range(passes):
            s = self.grid()
            if not self.solve(k, s):
                raise SolveError(f"springs of {k:.1e} N/m^2: shooting does not converge")
            states = self.states
            self.refine(states, s)
        pressed, n = np.minimum(self.gaps(states, s), 0.0), self.n
        points = states[2 * n + 5 : 2 * n + 8].T
        # Where several bodies press, each has its part of the change of the force on the cross-section.
        normals = np.array([body.gradient(points) for body in self.walls])
        per_length = -k * pressed[: len(normals), :, None] * normals
        parts = (per_length[:, 1:] + per_length[:, :-1]) / 2 * np.diff(s)[:, None]
        change = -np.diff(states[2 * n + 2 : 2 * n + 5]).T
        alone = parts.any(2).sum(0) == 1
        forces = np.where(alone[:, None], parts.any(2)[..., None] * change, parts)
        return points[-1], forces.sum(1)


def compared(case: Case, pose: Equilibrium, springs: Springs) -> tuple[float, float]:
    """Differences of the tip, m, and of the force of a body, N, from springs in the limit.

    Raises:
        SolveError: the springs have no limit.
    """
    forces = np.zeros((len(case.bodies), 3))
    for contact in pose.walls.contacts:
        forces[contact.body - 1] += contact.force
    last = None
    for limit in springs.limits():
        off = _difference(limit, (pose.tip_position, forces))
        if off[0] > SAME_BRANCH or (off[0] < TIP / 10 and off[1] < FORCE / 10):
            return off
        # Otherwise the limit must be known as accurately.
        if last is not None and (np.array(_difference(limit, last)) < (TIP / 10, FORCE / 10)).all():
            return off
        last = limit
    raise SolveError("the limit of the springs is not accurate enough")


def _difference(a: tuple[Array, Array], b: tuple[Array, Array]) -> tuple[float, float]:
    return float(np.linalg.norm(a[0] - b[0])), float(np.abs(a[1] - b[1]).max())


def contacts(arms: int, seed: int) -> tuple[dict[str, Any], list[str]]:
    """Counts of random arms among walls, and a line for each one that fails."""
    every = [tubeopt.load_robot(path) for path in sorted((ROOT / "configs" / "robots").glob("*.yaml"))]
    robots = [r for r in every if isinstance(r, ConcentricRobot) and not any(tube.pieces for tube in r.tubes)]
    names = "arms", "without contact", "refused", "refused, springs settle", "compared", "not compared", "wrong"
    out, seconds, notes = dict.fromkeys((*names, "elsewhere", "open", "changed", "no minimum"), 0), [], []
    places, tips, forces, work, checked = np.zeros(MOST_BODIES + 2, int), [], [], [], []
    number = 0
    while out["arms"] < arms:
        number += 1
        random = np.random.default_rng([seed, number])
        robot = robots[number % len(robots)]
        case = random_case(robot, random, int(random.integers(1, MOST_BODIES + 1)))
        if case is None:
            continue
        out["arms"] += 1
        free, label = case.free, f"arm {number}, {robot.name}"
        far = tubeopt.forward_kinematics(robot, free.rotations, free.translations, walls=[Sphere((0, 0, -9.0), 1.0)])
        same = np.array_equal(far.position, free.position) and far.margin == free.margin
        out["changed"] += not same
        begun, pose = time.process_time(), None
        try:
            pose = tubeopt.forward_kinematics(robot, free.rotations, free.translations, walls=case.bodies)
        except SolveError as error:
            out["refused"] += 1
            try:
                next(Springs(case).limits())
            except SolveError:
                continue
            out["refused, springs settle"] += 1
            notes.append(f"{label}: {error}; springs settle")
            continue
        touched = pose.walls.contacts
        if not touched:
            out["without contact"] += 1
            continue
        seconds.append(time.process_time() - begun)
        places[min(len(touched), MOST_BODIES + 1)] += 1
        integrated = pose.verified().verification
        checked.append(integrated.tip_position)
        minimum = pose.margin > 0 and pose.walls.clearance > -DEEP and all(contact.size > 0 for contact in touched)
        out["no minimum"] += not minimum
        for contact in touched:
            point, thick = ArmSurface(pose).at(np.array([contact.arc_length]))
            gap = float(case.bodies[contact.body - 1].signed_distance(point[0]) - thick[0])
            work.append(abs(gap) * contact.size)
        off, found = None, "springs settle"
        # From the free arm, springs may settle elsewhere or snap; from the pose, they show that it is their limit.
        for start in (None, pose):
            try:
                off = compared(case, pose, Springs(case, start))
            except SolveError as error:
                found = str(error)
            if off is not None and off[0] < SAME_BRANCH:
                out["compared"] += 1
                break
            out["elsewhere"] += off is not None
            off = None
        if off is None:
            out["not compared"] += 1
            notes.append(f"{label}, {len(touched)} contacts: {found}")
            continue
        tips.append(off[0])
        forces.append(off[1])
        if off[0] > TIP or off[1] > FORCE:
            out["wrong"] += 1
            notes.append(
                f"{label}: tip {1e6 * off[0]:.3g} um, force {1e3 * off[1]:.3g} mN off, {len(touched)} contacts"
            )
    out["open"] = int((np.array(work) > COMPLEMENTARITY).sum())
    out["places"] = " ".join(map(str, places[1:]))
    out["largest tip difference, um"] = f"{1e6 * max(tips, default=0.0):.2g}"
    out["largest force difference, mN"] = f"{1e3 * max(forces, default=0.0):.2g}"
    out["largest gap times force, J"] = f"{max(work, default=0.0):.1e}"
    out["largest tip difference from DOP853, um"] = f"{1e6 * max(checked, default=0.0):.2g}"
    out["ms, median"] = f"{1e3 * summarise(seconds).median:.3g}" if seconds else ""
    return out, notes


# --- One contact, and vessels -----------------------------------------------------------------------------------------


def one_contact(calls: int = 50) -> list[tuple[str, str]]:
    """Median times of solves with one contact, ms of the processor."""
    robot, rotations, ball = tubeopt.load_robot("thesis_ctr"), np.array([0.0, 1.0, 2.0]), Sphere((0.01, 0, 0.1), 0.01)
    pose = tubeopt.forward_kinematics(robot, rotations, walls=[ball])
    solved = start_of(pose, Walls(robot, (ball,), None)).complete(0.0)
    turned, shift = rotations + np.array([0.0, 0.02, 0.0]), np.array(solved.touching.member.translations)
    out = []
    for name, call in (
        ("from no start, verified", lambda: tubeopt.forward_kinematics(robot, rotations, walls=[ball])),
        ("in a motion, with stability", lambda: solved.at_joints(turned, shift).stable),
    ):
        seconds = []
        for _ in range(calls):
            begun = time.process_time()
            call()
            seconds.append(time.process_time() - begun)
        out.append((name, f"{1e3 * summarise(seconds).median:.3g}"))
    return out


@dataclass(frozen=True)
class Bend:
    """Bend of a vessel."""

    radius: float
    """Radius of the centreline, m."""
    angle: float
    """Angle, rad."""
    plane: float
    """Angle of the plane of the bend about z, rad."""


VESSELS = {
    "0.82 rad, radius 40 mm": (1.5e-3, [Bend(0.04, 0.82, 0.0)]),
    "0.9 rad, radius 50 mm": (1.5e-3, [Bend(0.05, 0.9, 1.0)]),
    "1.2 rad, radius 60 mm": (1.5e-3, [Bend(0.06, 1.2, 0.5)]),
    "0.6 rad twice, radius 50 mm, in two planes": (2e-3, [Bend(0.05, 0.6, 0.0), Bend(0.05, 0.6, np.pi / 2)]),
    "0.4 rad twice, radius 50 mm, as an S": (2e-3, [Bend(0.05, 0.4, 0.0), Bend(0.05, 0.4, np.pi)]),
}
"""Radius, m, and bends of vessels behind a straight part of 8 mm."""

PIECE = 4e-3
"""Largest length (m) of a piece of a centreline."""


def vessel(radius: float, bends: list[Bend]) -> tuple[Corridor, Array]:
    """Vessel, and the points (N, 3) of its centreline up to the last bend, m."""
    point, tangent = np.array([0, 0, 8e-3]), np.array([0.0, 0, 1])
    points = [point]
    for bend in bends:
        side = np.array([np.cos(bend.plane), np.sin(bend.plane), 0.0])
        side -= (side @ tangent) * tangent
        side /= np.linalg.norm(side)
        pieces = int(np.ceil(bend.angle * bend.radius / PIECE))
        for turn in np.linspace(0, bend.angle, pieces + 1)[1:]:
            points.append(point + bend.radius * ((1 - np.cos(turn)) * side + np.sin(turn) * tangent))
        point, tangent = points[-1], np.cos(bend.angle) * tangent + np.sin(bend.angle) * side
    centreline = np.array(points)
    return Corridor([[0, 0, -0.02], *centreline, point + 0.02 * tangent], radius), centreline


def deployments() -> list[tuple[str, ...]]:
    """Rows of the table of vessels."""
    robot, rows = tubeopt.load_robot("thesis_ctr"), []
    for name, (radius, bends) in VESSELS.items():
        body, path = vessel(radius, bends)
        begun = time.process_time()
        motion = tubeopt.deploy(robot, path[1:], walls=[body], tolerance=radius, largest_force=0.5)
        seconds, end = time.process_time() - begun, motion.equilibria[-1]
        free = tubeopt.forward_kinematics(robot, end.rotations, end.translations)
        touching = [pose for pose in motion.equilibria if pose.walls.contacts]
        off = max(pose.verified().verification.tip_position for pose in touching)
        deep = -min(pose.walls.clearance for pose in motion.equilibria)
        outside = -float(body.signed_distance(free.position).min())
        rows.append(
            (
                name,
                "yes" if motion.status is tubeopt.DeploymentStatus.REACHED else motion.reason,
                f"{1e3 * motion.largest_force:.0f}",
                str(max(len(pose.walls.contacts) for pose in touching)),
                f"{seconds:.1f}",
                f"{1e6 * off:.1e}",
                f"{1e6 * max(deep, 0.0):.1e}",
                f"{1e3 * outside:.2g}",
            )
        )
    return rows


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    counted, notes = contacts(arguments.arms, arguments.seed)
    rows = [(name, str(value)) for name, value in counted.items()]
    show(
        [
            table("Random arms among walls", ("", "all robots"), rows),
            table("One contact", ("", "ms"), one_contact()),
            table(
                "Vessels",
                (
                    *("bends", "reached", "largest force, mN", "most contacts", "s"),
                    *("tip from DOP853, um", "deepest wall, um", "free arm outside, mm"),
                ),
                deployments(),
            ),
        ],
        notes,
    )


if __name__ == "__main__":
    main()

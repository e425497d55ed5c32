"""Makes the questions: every number follows from the seed, and from the model that judges.

A place for the tip is that of an arm which keeps twice what is asked, so every inverse question has an answer. Of plans
no way is known: some may have none. A design for targets is known to be possible: they are tips of a robot with other
curvatures.

Usage: python -m benchmarks.suite.make [--seed 2026] [--out benchmarks/suite/data]
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import tubeopt
from tubeopt.bodies.phantoms import PHANTOMS

from .model import Array, Robot, integrate, margins
from .questions import CLEARANCE, DATA, MARGIN, MM, Scene, robot_of, scene_of

ROOT = Path(__file__).resolve().parents[2]

PUBLISHED = ("crl_ctr", "pedrosa_ctr")
"""Of configs/robots."""

FOURTH = {"outer_diameter_mm": 2.1, "inner_diameter_mm": 1.8, "straight_length_mm": 5.0, "curved_length_mm": 60.0}
"""Around the robot of the CRL, of its material and with this curvature (1/m), for a robot of four tubes; its inner
two are the robot of two."""

FOURTH_CURVATURE = 2.0

AT_ONCE, MOST = 400, 60
"""Arms that are drawn at once, and times that it is tried."""

IN_ANATOMY = {
    "bronchial tree": ("crl_ctr", "four_tubes", "pedrosa_ctr"),
    "ventricle": ("crl_ctr", "pedrosa_ctr"),
    "kidney": ("crl_ctr", "pedrosa_ctr"),
}
"""Robots that fit."""

COUNTS = {"inverse": (100, 30, 0), "plan": (15, 8, 0)}
"""Questions per robot in free space, and per corridor; the anatomies share what is left of WANTED."""

WANTED = {"inverse": 1000, "plan": 200}

DEEP = 0.045
"""Height (m) above the plate from which on places in anatomies lie."""


def written_robots() -> dict[str, dict[str, list[float]]]:
    """The tubes of all robots as the file has them."""
    out = {}
    for name in PUBLISHED:
        tubes = tubeopt.load_robot(ROOT / "configs" / "robots" / f"{name}.yaml").tubes
        keys = ("outer_diameter", "inner_diameter", "straight_length", "curved_length")
        row = {f"{key}_mm": [round(getattr(tube, key) / MM, 6) for tube in tubes] for key in keys}
        row["curvature_per_m"] = [tube.curvature for tube in tubes]
        for key in ("bending_stiffness", "torsional_stiffness"):
            row[f"{key}_N_mm2"] = [float(f"{getattr(tube, key) / MM**2:.9g}") for tube in tubes]
        out[name] = row
    three = out["crl_ctr"]
    outer = {**FOURTH, "curvature_per_m": FOURTH_CURVATURE}
    second = (outer["outer_diameter_mm"] ** 4 - outer["inner_diameter_mm"] ** 4) / (
        three["outer_diameter_mm"][2] ** 4 - three["inner_diameter_mm"][2] ** 4
    )
    for key in ("bending_stiffness_N_mm2", "torsional_stiffness_N_mm2"):
        outer[key] = float(f"{three[key][2] * second:.9g}")
    out["two_tubes"] = {key: row[:2] for key, row in three.items()}
    out["four_tubes"] = {key: [*row, outer[key]] for key, row in three.items()}
    return out


def held(robot: Robot, random: np.random.Generator, count: int) -> Array:
    """(count, n) places at which tubes may be held, outer ones first, m."""
    beta, length = np.zeros((count, robot.n)), robot.length
    for i in reversed(range(robot.n)):
        last = i == robot.n - 1
        low = -length[i] if last else beta[:, i + 1] + length[i + 1] - length[i]
        high = 0.0 if last else beta[:, i + 1]
        beta[:, i] = random.uniform(low, high)
    return beta


def arms(
    robot: Robot,
    scene: Scene,
    random: np.random.Generator,
    count: int,
    around: tuple[Array, Array] | None = None,
    most: int = MOST,
) -> tuple[Array, Array]:
    """(count, n) tip angles and held places of arms that keep twice what is asked; of a corridor, around that which it
    was made of; in an anatomy, deep."""
    z, beta = np.zeros((0, robot.n)), np.zeros((0, robot.n))
    for _ in range(most):
        if around is None:
            tried = random.uniform(-np.pi, np.pi, (AT_ONCE, robot.n)), held(robot, random, AT_ONCE)
        else:
            away = random.normal(size=(2, AT_ONCE, robot.n)) * np.array([0.5, 6 * MM])[:, None, None]
            tried = around[0] + away[0], around[1] + away[1]
        tried = tuple(np.round(each, 6) for each in tried)
        result = integrate(robot, *tried)
        room = (scene.depth(result.points) - result.radius).min(axis=1)
        good = (robot.order(tried[1]) > 1 * MM) & result.stable & (room > 2 * CLEARANCE)
        if not scene.free and around is None:
            good &= result.tip[:, 2] > DEEP
        good &= np.ptp(result.points, axis=1).max(axis=1) > 20 * MM
        rows = np.flatnonzero(good)
        rows = rows[margins(robot, tried[0][rows], tried[1][rows]) > 2 * MARGIN] if len(rows) else rows
        z, beta = np.concatenate([z, tried[0][rows]]), np.concatenate([beta, tried[1][rows]])
        if len(z) >= count:
            return z[:count], beta[:count]
    raise LookupError(f"{robot.name} in {scene.name}: {len(z)} arms of {count} found")


def corridor(robot: Robot, name: str, random: np.random.Generator) -> tuple[list[list[float]], tuple[Array, Array]]:
    """A vessel around an arm that reaches far, and that arm."""
    free = scene_of("free", [])
    z, beta = arms(robot, free, random, 100)
    result = integrate(robot, z, beta)
    k = int(np.argsort(result.tip[:, 2])[-20 + random.integers(15)])
    points = result.points[k][::-1]
    far = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    line = np.column_stack([np.interp(np.linspace(0, far[-1], 8), far, column) for column in points.T])
    line = np.vstack([[0, 0, -15 * MM], line, points[-1] + 8 * MM * result.direction[k]]) / MM
    radius = float(random.choice([7.0, 9.0, 11.0]))
    rows = [[*np.round(a, 3).tolist(), *np.round(b, 3).tolist(), radius, radius] for a, b in zip(line, line[1:])]  # noqa: B905, RUF007
    return rows, (z[k], beta[k])


def anatomy(kind: str, random: np.random.Generator) -> list[list[float]]:
    """One of the anatomies made of formulas, turned about the axis of the plate and scaled."""
    angle, size = random.uniform(-np.pi, np.pi), random.uniform(0.9, 1.15)
    c, s = np.cos(angle), np.sin(angle)
    turn = size * np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return [
        [*np.round(turn @ a, 3).tolist(), *np.round(turn @ b, 3).tolist(), round(size * r, 3), round(size * q, 3)]
        for a, b, r, q in PHANTOMS[kind]().stretches
    ]


Places = dict[tuple[str, str], tuple[Array, Array] | None]
"""Robot and scene, and the arm around which arms are drawn."""


def written_scenes(robots: dict[str, Robot], random: np.random.Generator) -> tuple[dict[str, Any], Places]:
    """All scenes as the file has them, and which robots are asked in them."""
    rows: dict[str, Any] = {"free": []}
    pairs: Places = {(name, "free"): None for name in robots}
    for name, robot in robots.items():
        for k in (1, 2):
            rows[f"corridor {name} {k}"], pairs[name, f"corridor {name} {k}"] = corridor(robot, name, random)
    for kind, names in IN_ANATOMY.items():
        for k in (1, 2):
            rows[f"{kind} {k}"] = anatomy(kind, random)
            pairs.update({(name, f"{kind} {k}"): None for name in names})
    return rows, pairs


def shares(kind: str, pairs: Places) -> Iterator[tuple[tuple[str, str], int]]:
    """How many questions of a kind every robot gets in every scene."""
    free, narrow, _ = COUNTS[kind]
    inputs = {pair: free if pair[1] == "free" else narrow if pair[1].startswith("corridor") else 0 for pair in pairs}
    rest = [pair for pair, count in inputs.items() if not count]
    for k in range(WANTED[kind] - sum(inputs.values())):
        inputs[rest[k % len(rest)]] += 1
    yield from inputs.items()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--out", type=Path, default=DATA)
    args = parser.parse_args()
    random = np.random.default_rng(args.seed)
    written = written_robots()
    robots = {name: robot_of(name, row) for name, row in written.items()}
    scenes, pairs = written_scenes(robots, random)
    files: dict[str, Any] = {"robots": written, "scenes": scenes, "inverse": [], "plan": []}
    for kind in ("inverse", "plan"):
        for (name, scene), count in shares(kind, pairs):
            z, beta = arms(robots[name], scene_of(scene, scenes[scene]), random, count, pairs[name, scene])
            result = integrate(robots[name], z, beta)
            for k in range(count):
                one: dict[str, Any] = {"id": f"{kind} {len(files[kind]) + 1}", "robot": name, "scene": scene}
                if kind == "plan" and scene == "free":
                    shift = beta[k] + robots[name].straight_length
                    one["rotations_deg"] = np.degrees(result.rotations[k]).round(6).tolist()
                    one["translations_mm"] = (shift / MM).round(4).tolist()
                else:
                    one["tip_mm"] = (result.tip[k] / MM).round(4).tolist()
                if kind == "inverse" and scene == "free" and k % 2:
                    one["direction"] = result.direction[k].round(7).tolist()
                files[kind].append(one)
    files["design"] = [*reaching(robots, scenes, pairs, random), *snap_free(robots)]
    args.out.mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        rows = content.items() if isinstance(content, dict) else content
        lines = (": ".join(map(json.dumps, row)) if isinstance(row, tuple) else json.dumps(row) for row in rows)
        opening, closing = "{}" if isinstance(content, dict) else "[]"
        text = f"{opening}\n" + ",\n".join(lines) + f"\n{closing}\n"
        (args.out / f"{name}.json").write_text(text, encoding="utf-8")
        print(f"{name}: {len(content)}")


TARGETS, FACTORS = 3, (0.6, 1.6)
"""Places for the tip per design, and by what its curvatures may be multiplied."""

SPREADS = (0.35, 0.25, 0.15, 0.1, 0.05, 0.0)
"""Logarithms of the factors of the curvatures that the robot has whose tips are to be reached, one after the other."""


def reaching(
    robots: dict[str, Robot], scenes: dict[str, Any], pairs: Places, random: np.random.Generator
) -> Iterator[dict[str, Any]]:
    """Twelve designs: the least change of curvatures with which the tip reaches places."""
    requested = [(name, scene) for name, scene in pairs if scene == "free" or scene.startswith("corridor")]
    for number, (name, scene) in enumerate(requested[:12]):
        tips = hidden(robots[name], scene_of(scene, scenes[scene]), random, pairs[name, scene])
        yield {
            "id": f"design {number + 1}", "kind": "reach", "robot": name, "scene": scene,
            "curvature_factors": list(FACTORS), "tips_mm": (tips / MM).round(4).tolist(), "tolerance_mm": 0.1,
            "margin": 0.1,
        }  # fmt: skip


def hidden(robot: Robot, scene: Scene, random: np.random.Generator, around: tuple[Array, Array] | None) -> Array:
    """Tips of a robot with other curvatures: the more different the better, as far as the way lets it."""
    for spread in SPREADS:
        other = replace(robot, curvature=robot.curvature * np.exp(random.uniform(-spread, spread, robot.n)))
        with suppress(LookupError):
            return integrate(other, *arms(other, scene, random, TARGETS, around, most=6)).tip
    raise LookupError(f"{robot.name} in {scene.name}: no robot with other curvatures fits")


def snap_free(robots: dict[str, Robot]) -> Iterator[dict[str, Any]]:
    """Eight designs: the tightest turn of tubes that cannot snap at any rotation, at given translations."""
    for number, (name, margin) in enumerate((name, margin) for name in robots for margin in (0.05, 0.3)):
        robot = robots[name]
        shift = (
            -robot.length
            + (0.6 + 0.05 * np.arange(robot.n)[::-1]) * float(robot.curved_length.min())
            + robot.straight_length
        )
        yield {
            "id": f"design {12 + number + 1}", "kind": "snap_free", "robot": name, "scene": "free",
            "curvature_factors": [0.2, 3.0], "translations_mm": (shift / MM).round(4).tolist(),
            "strain_percent": 1.5, "margin": margin,
        }  # fmt: skip


if __name__ == "__main__":
    main()

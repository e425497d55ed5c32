"""How far the surface of an arm is from bodies: as code that looks everywhere says, however many there are."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
import pytest
import trimesh

from benchmarks.bodies import cloud
from tests.examples import CONFIGS, CRL, THESIS
from tests.inverse_targets import reachable
from tubeopt import IkSession, InverseOptions, forward_kinematics, inverse_kinematics, load_robot
from tubeopt.bodies.corridors import Corridor, MeshObstacle
from tubeopt.bodies.obstacles import Box, Capsule, ClearanceMonitor, HalfSpace, Obstacle, Scene, Sphere
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.equilibrium.jacobian import compiled_slopes
from tubeopt.equilibrium.result import Equilibrium
from tubeopt.inverse import closest, multistart
from tubeopt.inverse.joints import joint_space
from tubeopt.inverse.posture import posture_of
from tubeopt.robots.robot import Robot
from tubeopt.solvers.compiled.binding import kernel_of
from tubeopt.typing import Array

TIP = (0.055, 0.02, 0.15)
"""Where the tip goes, m."""


def arms() -> Iterator[Equilibrium]:
    """Some of three robots."""
    for robot in (THESIS, CRL, load_robot(CONFIGS / "thesis_etr.yaml")):
        space = joint_space(robot)
        for q in space.sample(4):
            yield forward_kinematics(robot, *space.split(q))


def bodies_near(e: Equilibrium, random: np.random.Generator) -> tuple[Obstacle, ...]:
    """Bodies of all kinds, from well inside of the arm to far away, many of them small."""
    results: list[Obstacle] = []
    for _ in range(20):
        position = e.position[random.integers(len(e.position))]
        at, size = position + random.normal(size=3) * 10 ** random.uniform(-3, -1), 10 ** random.uniform(-4.5, -2.5)
        one = tuple(at.tolist())
        other = tuple((at + abs(random.normal(size=3)) * 0.01).tolist())
        results += [Sphere(one, size), Capsule(one, other, size), Box(one, other)][random.integers(3) :][:1]
    if random.random() < 0.3:
        results.append(HalfSpace(tuple((e.position[0] - [0.0, 0.0, 0.01]).tolist()), (0.0, 0.1, 1.0)))
    return tuple(results)


def everywhere(e: Equilibrium, body: Obstacle, count: int = 4001) -> Array:
    """Distances of the surface from a body at many places."""
    s = np.linspace(0, e.arc_length[-1], count)
    outline = ArmSurface(e)
    return np.asarray(body.signed_distance(outline.at(s)[0]) - outline.radius(s))


def test_the_clearance_is_that_of_a_dense_sampling() -> None:
    random = np.random.default_rng(0)
    for e in arms():
        bodies = bodies_near(e, random)
        scene = Scene(bodies)
        exact = min(float(everywhere(e, body).min()) for body in bodies)
        report = ArmSurface(e).clearance(scene)
        assert report == pytest.approx(exact, abs=1e-5 if exact > 0 else 5e-5)
        # What is enough is a bound that is enough, or the clearance itself.
        for enough in (exact - 1e-3, exact + 1e-3, 1e-5):
            bound = ArmSurface(e).clearance(scene, enough)
            assert bound == report or enough <= bound <= report + 1e-12


def test_contacts_are_the_closest_places_of_every_body() -> None:
    random = np.random.default_rng(1)
    for e in arms():
        bodies = bodies_near(e, random)
        scene = Scene(bodies)
        contacts = ArmSurface(e).contacts(scene, 0.02)
        smallest = [float(everywhere(e, body).min()) for body in bodies]
        assert {k for k, each in enumerate(smallest) if each < 0.02 - 1e-5} <= set(contacts.body.tolist())
        for k in np.unique(contacts.body):
            mine = contacts.chosen(contacts.body == k)
            assert mine.distance[0] == pytest.approx(smallest[k], abs=1e-5 if smallest[k] > 0 else 5e-5)
            assert (np.diff(mine.distance) >= 0).all()
            report = bodies[k].signed_distance(mine.point) - ArmSurface(e).radius(mine.arc_length)
            np.testing.assert_allclose(report, mine.distance, atol=1e-12)
        own = [bodies[k].gradient(point) for k, point in zip(contacts.body, contacts.point, strict=True)]
        np.testing.assert_allclose(scene.gradients(contacts.body.tolist(), contacts.point), np.reshape(own, (-1, 3)))


def test_the_nearest_bodies_are_told_without_the_others() -> None:
    """However many are asked for, no closer one is left out, and one that is asked for by name is not."""
    random = np.random.default_rng(2)
    for e in arms():
        scene = Scene(bodies_near(e, random))
        every = ArmSurface(e).contacts(scene, 0.05)
        bodies, first = np.unique(every.body, return_index=True)
        smallest = every.distance[first]
        farthest = int(bodies[smallest.argmax()])
        report = ArmSurface(e).contacts(scene, 0.05, 3, frozenset([farthest]))
        near = bodies[np.argsort(smallest)[:3]]
        assert {*near.tolist(), farthest} <= set(report.body.tolist())
        known, reach = dict(zip(bodies.tolist(), smallest, strict=True)), np.sort(smallest)[2]
        for k in report.body:
            mine = report.distance[report.body == k].min()
            assert mine == pytest.approx(known[int(k)], abs=1e-5), (k, reach)


def test_a_vessel_is_a_body_like_others() -> None:
    """Its distance is a bound only, and grows and falls by kinks: nothing may be left out on that account."""
    for e in arms():
        line = e.position[:: max(1, len(e.position) // 6)] + np.array([0.002, 0.0, 0.0])
        vessel = Corridor(tuple(map(tuple, line.tolist())), 0.02)
        assert ArmSurface(e).clearance(Scene((vessel,))) == pytest.approx(everywhere(e, vessel).min(), abs=1e-5)


def test_the_mesh_of_a_ball_is_as_far_as_the_ball() -> None:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.02)
    mesh.apply_translation([0.06, -0.05, 0.12])
    body = MeshObstacle(tuple(map(tuple, mesh.vertices.tolist())), tuple(map(tuple, mesh.faces.tolist())))
    for e in list(arms())[:4]:
        ball = Sphere((0.06, -0.05, 0.12), 0.02)
        assert ArmSurface(e).clearance(Scene((body,))) == pytest.approx(
            ArmSurface(e).clearance(Scene((ball,))), abs=2e-4
        )


def crowd(count: int) -> list[Sphere]:
    """Spheres around the places that the robot of the thesis goes to below."""
    random, results = np.random.default_rng(0), []
    while len(results) < count:
        at = random.uniform([-0.15, -0.15, 0.0], [0.15, 0.15, 0.25])
        if np.linalg.norm(at - np.clip(at, [-0.04, -0.04, 0.0], [0.1, 0.08, 0.2])) > 0.01:
            results.append(Sphere(tuple(at.tolist()), 2e-3))
    return results


def test_far_bodies_change_no_answer_of_a_session_and_cost_little() -> None:
    turn = np.arange(60)[:, None] * 0.5e-3 / 0.03
    targets = np.array([0.055, 0.02, 0.15]) + 0.03 * np.hstack([np.cos(turn), np.sin(turn), 0.1 * np.sin(3 * turn)])
    seed = IkSession(THESIS, min_margin=0.1).solve(targets[0])
    times, answers = [], []
    for bodies in ([], crowd(1000)):
        session = IkSession(THESIS, min_margin=0.1, obstacles=bodies, start=seed)
        session.solve(targets[0])
        took = []
        for target in targets[1:]:
            start_time = time.process_time()
            answers.append(session.solve(target))
            took.append(time.process_time() - start_time)
        times.append(float(np.median(took)))
    for free, among in zip(answers[: len(answers) // 2], answers[len(answers) // 2 :], strict=True):
        np.testing.assert_array_equal(free.rotations, among.rotations)
        np.testing.assert_array_equal(free.translations, among.translations)
        assert among.clearance > 0.0
    assert times[1] < 3 * times[0]


def test_bodies_beyond_the_nearest_are_kept_away_from_too() -> None:
    """More small balls about the plate than a step knows of are the nearest wherever it goes; in its way is a wall."""
    free = inverse_kinematics(THESIS, TIP).equilibrium
    outline, turn = ArmSurface(free), np.linspace(0.0, 2 * np.pi, 40, endpoint=False)
    about = [Sphere((3.5e-3 * np.cos(a), 3.5e-3 * np.sin(a), 2e-3), 0.3e-3) for a in turn]
    middle, radius = outline.at(np.array([0.6 * free.arc_length[-1]]))
    wall = [Sphere(tuple(middle[0] + [(radius[0] + 0.5e-3), 1e-3 * k, 0.0]), 1e-3) for k in range(-8, 9)]
    solution = inverse_kinematics(THESIS, TIP, obstacles=about + wall)
    assert solution.position_error < 1e-8
    assert min(everywhere(solution.equilibrium, body).min() for body in about + wall) > 0.0


def test_a_target_inside_a_body_of_a_crowd_is_approached_as_close_as_it_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Starts end against many bodies at once, at some where breakpoints coincide; the tip ends at the sphere in the
    way."""
    bodies = cloud(600, list(reachable(THESIS, 4, seed=6))[3:])
    target = np.array(bodies[0].centre)
    monkeypatch.setattr(closest, "MAX_SOLVES", 1)
    monkeypatch.setattr(multistart, "CLEAR_STARTS", 0)
    few = InverseOptions(starts=12)
    solution = inverse_kinematics(THESIS, target, obstacles=bodies, on_failure="closest", options=few)
    assert solution.clearance >= -1e-9
    assert solution.position_error >= bodies[0].radius + THESIS.tubes[0].outer_diameter / 2


def test_distances_change_with_the_joints_as_their_slopes_say() -> None:
    """Beside the arm, ahead of its tip, and beside the edge where a tube ends, which moves along with that tube."""
    space = joint_space(THESIS)
    for q in space.sample(6)[1:3] * 0.98 + 0.02 * space.inside():
        at = posture_of(space, forward_kinematics(THESIS, *space.split(q)))
        arm = at.equilibrium
        edge = int(np.argmin(np.abs(arm.arc_length - arm.tube_end[1])))
        for k, ahead in ((len(arm.position) // 3, 0.0), (edge, 0.3e-3), (len(arm.position) - 1, 3e-3)):
            x, _, z = arm.frame[k].T
            scene = Scene((Sphere(tuple((arm.position[k] + 4e-3 * x + ahead * z).tolist()), 2e-3),))
            contacts = at.surface.contacts(scene, 0.01)
            closest = contacts.chosen(np.array([int(contacts.distance.argmin())]))
            assert k != edge or closest.arc_length[0] == arm.tube_end[1]
            report, by = at.contact_slopes(scene, closest)[0], 1e-5
            for j, unit in enumerate(np.eye(len(q)) * by):
                beside = [forward_kinematics(THESIS, *space.split(q + s * unit), start=arm) for s in (1, -1)]
                one, two = (least_near(e, scene.bodies[0], closest.arc_length[0]) for e in beside)
                assert (one - two) / (2 * by) == pytest.approx(report[j], abs=2e-3), (k, j)


def least_near(e: Equilibrium, body: Obstacle, place: float) -> float:
    """Least distance of the surface from a body at places within a millimetre along the arm."""
    s = np.append(np.linspace(place - 1e-3, place + 1e-3, 4001), e.tube_end)
    s = s[(np.abs(s - place) <= 1e-3) & (s <= e.arc_length[-1])]
    outline = ArmSurface(e)
    return float((body.signed_distance(outline.at(s)[0]) - outline.radius(s)).min())


@pytest.mark.parametrize("robot", [THESIS, CRL])
def test_points_of_the_arm_move_with_the_joints_as_the_kernel_says(robot: Robot) -> None:
    if kernel_of(robot) is None:
        return  # nothing is compiled here
    space = joint_space(robot)
    for q in space.sample(3):
        at = posture_of(space, forward_kinematics(robot, *space.split(q)))
        report, n = compiled_slopes(at.equilibrium), robot.n_tubes
        assert report is not None
        assert report.along is not None
        np.testing.assert_allclose(report.along, at.derivatives.position, rtol=0, atol=2e-8)
        np.testing.assert_array_equal(report.along[-1], report.position)
        for i in range(n):  # arc lengths stay
            turn = 1e-5 * np.eye(n)[i]
            arm = at.equilibrium
            one, two = (
                forward_kinematics(robot, arm.rotations + s * turn, arm.translations, start=arm).position
                for s in (1, -1)
            )
            np.testing.assert_allclose((one - two) / 2e-5, report.along[..., i], atol=1e-7)


def test_who_is_looked_around_for_misses_no_contact() -> None:
    """Arms that move a little at a time past bodies: what is known from before does not deceive."""
    random, observed = np.random.default_rng(2), set()
    for robot in (THESIS, CRL):
        space = joint_space(robot)
        start, end = (forward_kinematics(robot, *space.split(q)) for q in space.sample(4)[:2])
        scene = Scene(bodies_near(end, random)[:4])
        lookout, e = ClearanceMonitor(scene), start
        for t in np.linspace(0.0, 1.0, 15):
            joints = (
                a + t * (b - a) for a, b in ((start.rotations, end.rotations), (start.translations, end.translations))
            )
            e = forward_kinematics(robot, *joints)
            within = 10 ** random.uniform(-4, -2)
            outline = ArmSurface(e)
            outline.look_around(lookout, within)
            report, known = outline.contacts(scene, within), ArmSurface(e).contacts(scene, within)
            np.testing.assert_array_equal(report.body, known.body)
            np.testing.assert_array_equal(report.distance, known.distance)
            assert outline.clearance(scene, within) == pytest.approx(
                min(ArmSurface(e).clearance(scene), within), abs=1e-5
            )
            observed.add(bool(len(report.body)))
    assert observed == {True, False}


def test_clearance_of_a_withdrawn_arm_is_that_of_its_point_at_the_plate() -> None:
    arm = forward_kinematics(THESIS, [0, 1, 2], [-tube.curved_length for tube in THESIS.tubes])
    assert arm.arc_length[-1] == 0
    radius, ball = max(tube.outer_diameter for tube in THESIS.tubes) / 2, Sphere((0.0, 0.03, 0.04), 0.02)
    scene, surface = Scene((ball,)), ArmSurface(arm)
    surface.look_around(ClearanceMonitor(scene), 0.01)
    assert 0.03 - radius - 1e-9 <= surface.clearance(scene, 0.1) <= 0.03
    near = Scene((Sphere((0.0, 0.03, 0.04), 0.049),))
    surface.look_around(ClearanceMonitor(near), 0.01)
    assert 1e-3 - radius - 1e-9 <= surface.clearance(near, 0.1) <= 1e-3

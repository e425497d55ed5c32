"""Arms that touch walls: against a penalty method, an independent integration, and energies."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tubeopt
from tubeopt.block.transcription.orientation import position_slopes, tangents
from tubeopt.bodies import Capsule, Corridor, HalfSpace, Sphere
from tubeopt.bodies.obstacles import scene_of
from tubeopt.equilibrium.arm_surface import ArmSurface
from tubeopt.equilibrium.jacobian import derivatives_of, shifted
from tubeopt.equilibrium.member import Loaded
from tubeopt.equilibrium.problem import Discretisation
from tubeopt.equilibrium.wall_contact import side_of
from tubeopt.errors import InputError
from tubeopt.robots.load import Load

ROBOTS = ("thesis_ctr", "two_tube")


def random_walls(seed):
    """Robot, rotations and bodies that reach up to 3 mm into its free arm."""
    rng = np.random.default_rng(seed)
    robot = tubeopt.load_robot(ROBOTS[seed % len(ROBOTS)])
    rotations = rng.uniform(-3, 3, robot.n_tubes)
    free = tubeopt.forward_kinematics(robot, rotations)
    bodies = []
    while not bodies:
        for _ in range(rng.integers(1, 4)):
            i = min(int(len(free.position) * rng.uniform(0.3, 1.0)), len(free.position) - 1)
            turn, radius, depth = rng.uniform(0, 6.28), rng.uniform(2e-3, 20e-3), rng.uniform(1e-3, 3e-3)
            normal = free.frame[i] @ [np.cos(turn), np.sin(turn), 0.0]
            centre = free.position[i] - normal * (radius + 0.7e-3 - depth)
            axis = np.cross(normal, rng.normal(size=3))
            axis *= 0.02 / np.linalg.norm(axis)
            kinds = (
                Sphere(tuple(centre), radius),
                Capsule(tuple(centre - axis), tuple(centre + axis), radius),
                HalfSpace(tuple(centre + normal * radius), tuple(normal)),
            )
            body = kinds[rng.integers(3)]
            # The plate must be free.
            bodies += [body] if body.signed_distance(np.zeros(3)) > 3e-3 else []
    return robot, rotations, bodies, free


def by_penalty(robot, rotations, bodies, start, stiffness):
    """Tip (3,), m, and force of each body on an arm with springs of `stiffness`, N/m^2, along its surface.

    Minimum of E + 1/2 k int max(0, -g)^2 ds by Newton's method with a line search.
    """
    # Forces act inside of elements: these must be short.
    fine = Discretisation(degree=7, refinement=2)
    member = Loaded.of(robot, rotations, tuple(start.translations.tolist()), Load(), fine)
    mesh, weight = member.problem.mesh, member.torsion.weight
    # Fine where the arm touches, since the normal turns along the arm.
    end = start.arc_length[-1]
    grid = [np.arange(5e-4, end + 1e-9, 5e-4)]
    grid += [np.arange(c.arc_length - 3e-4, min(c.arc_length + 3e-4, end), 2e-6) for c in start.walls.contacts]
    grid = np.unique(np.concatenate([*grid, [end]]))
    spacing, lines = np.gradient(grid), ArmSurface(start)
    element, x = mesh.locate(grid)
    degree = mesh.tableau.degree
    rows = np.where(np.arange(len(weight)) < element[:, None] * degree, weight, 0.0)
    inside = mesh.tableau.lagrange(x, integrals=1) * mesh.length[element][:, None]
    for k, e in enumerate(element):
        rows[k, e * degree : (e + 1) * degree] = inside[k]
    radius = lines.radius(grid)

    def energy(state):
        points = rows @ tangents(state.orientation.stage)
        gaps = np.array([body.signed_distance(points) - radius for body in bodies])
        return state.energy + stiffness / 2 * (spacing * np.minimum(gaps, 0.0) ** 2).sum(), points, gaps

    s = member.torsion.arc_length
    curvature = np.stack([np.interp(s, start.arc_length, start.curvature[:, k]) for k in range(2)], axis=1)
    theta = np.stack([np.interp(s, start.arc_length, row) for row in start.rotation], axis=1)
    state = member.at(member.unknowns(theta, curvature))
    for _ in range(300):
        value, points, gaps = energy(state)
        gradient, hessian = state.gradient.copy(), state.hessian.copy()
        forces = np.zeros((len(bodies), 3))
        for b, body in enumerate(bodies):
            pressed = np.flatnonzero(gaps[b] < 0)
            if not len(pressed):
                continue
            places = position_slopes(state.orientation, rows[pressed]) @ state.curvature_slope
            for k, place in zip(pressed, places, strict=True):
                normal, press = body.gradient(points[k]), stiffness * spacing[k] * -gaps[b, k]
                gradient -= press * normal @ place
                along = normal @ place
                hessian += stiffness * spacing[k] * np.outer(along, along)
                hessian -= press * place.T @ side_of(body, points[k]).curvature @ place
                forces[b] += press * normal
        if np.abs(gradient).max() < 1e-9:
            break
        shift = 0.0
        while True:
            try:
                np.linalg.cholesky(hessian + shift * np.eye(len(hessian)))
                break
            except np.linalg.LinAlgError:
                shift = 4 * shift if shift else 0.1
        step = -np.linalg.solve(hessian + shift * np.eye(len(hessian)), gradient)
        step *= min(1.0, 0.3 / member.largest_rotation(state, step))
        for _ in range(40):
            trial = member.at(state.x + step)
            if energy(trial)[0] <= value:
                break
            step /= 2
        state = trial
    return weight @ tangents(state.orientation.stage), forces


@pytest.mark.parametrize("seed", range(200, 204))
def test_contact_is_the_limit_of_stiff_springs(seed):
    """The tip is that of springs along the walls to their stiffness, and so are the forces."""
    robot, rotations, bodies, _ = random_walls(seed)
    pose = tubeopt.forward_kinematics(robot, rotations, walls=bodies)
    # Springs give way by k^(-2/3), as the length that they press grows with their depth.
    stiffness = 2e10 * max(1.0, 20 * sum(contact.size for contact in pose.walls.contacts))
    soft, hard = (by_penalty(robot, rotations, bodies, pose, k * stiffness) for k in (1, 8))
    tip, forces = ((4 * b - a) / 3 for a, b in zip(soft, hard, strict=True))
    assert np.linalg.norm(tip - pose.tip_position) < 1e-6
    ours = np.zeros((len(bodies), 3))
    for contact in pose.walls.contacts:
        ours[contact.body - 1] += contact.force
    assert np.abs(ours - forces).max() < 1e-3


@pytest.fixture(scope="module")
def pressed():
    """Robot, rotations and a ball that it presses upon with its middle."""
    robot, rotations = tubeopt.load_robot("thesis_ctr"), np.array([0.0, 1.0, 2.0])
    free = tubeopt.forward_kinematics(robot, rotations)
    i = len(free.position) // 2
    normal = free.frame[i] @ [np.cos(0.4), np.sin(0.4), 0.0]
    return robot, rotations, free.position[i] - 6e-3 * normal


def ball(centre):
    return [Sphere(tuple(centre), 8e-3)]


def test_walls_that_are_not_touched_change_nothing(pressed):
    robot, rotations, centre = pressed
    free = tubeopt.forward_kinematics(robot, rotations)
    pose = tubeopt.forward_kinematics(robot, rotations, walls=ball(centre + np.array([0, 0.1, 0])))
    assert np.array_equal(pose.position, free.position)
    assert (pose.margin, pose.load, pose.walls.contacts) == (free.margin, None, ())
    assert pose.walls.clearance == pytest.approx(ArmSurface(free).clearance(scene_of(pose.walls.bodies)))


@pytest.mark.parametrize("seed", range(300, 310))
def test_forces_balance_the_arm_and_close_the_gaps(seed):
    """All conditions of a minimum hold, and an adaptive integration under the contact forces ends at the same tip."""
    robot, rotations, bodies, _ = random_walls(seed)
    pose = tubeopt.forward_kinematics(robot, rotations, walls=bodies, verify=True)
    arm = ArmSurface(pose)
    for contact in pose.walls.contacts:
        body, s = bodies[contact.body - 1], np.array([contact.arc_length])
        point, radius = arm.at(s)
        assert abs(body.signed_distance(point[0]) - radius[0]) < 1e-7
        normal = body.gradient(point[0])
        assert np.allclose(contact.force, contact.size * normal, atol=1e-6 * contact.size)
    assert pose.walls.clearance > -2e-7
    assert pose.margin > 0
    if pose.walls.contacts:
        assert pose.verification.tip_position < 1e-9
    # A wall pushes only.
    assert all(contact.size > 0 for contact in pose.walls.contacts)


@pytest.mark.parametrize("direction", np.eye(3).tolist())
def test_a_moved_wall_does_the_work_of_its_force(pressed, direction):
    """The energy grows by force times displacement of the ball: dE = F.dc."""
    robot, rotations, centre = pressed
    step = 2e-5 * np.array(direction)
    pose = tubeopt.forward_kinematics(robot, rotations, walls=ball(centre))
    high, low = (tubeopt.forward_kinematics(robot, rotations, walls=ball(centre + k * step)).energy for k in (1, -1))
    (contact,) = pose.walls.contacts
    assert (high - low) / 4e-5 == pytest.approx(np.dot(contact.force, direction), rel=1e-4, abs=1e-7)


def bent_vessel(free, i, turn, bend, moved=(0, 0, 0)):
    """Vessel of two straight pieces, the inner edge of which is 1 mm deep in the free arm at shape point i."""
    radius, thick = 0.05, float(ArmSurface(free).radius(free.arc_length[i : i + 1])[0])
    normal, along = free.frame[i] @ [np.cos(turn), np.sin(turn), 0.0], free.frame[i, :, 2]
    corner = free.position[i] + normal * (1e-3 + (radius - thick) / np.cos(bend)) + moved
    coming, going = along * np.cos(bend) + normal * np.sin(bend), along * np.cos(bend) - normal * np.sin(bend)
    return Corridor([corner - 0.3 * coming, corner, corner + 0.3 * going], radius)


@pytest.mark.parametrize(("turn", "bend"), [(0.4, 0.2), (1.0, 0.4)])
def test_an_arm_stays_on_the_edge_of_a_bend(turn, bend):
    """Both pieces press, normal to the arm; the force does the work of a motion, and derivatives are differences."""
    robot, rotations = tubeopt.load_robot("thesis_ctr"), np.array([0.0, 1.0, 2.0])
    free = tubeopt.forward_kinematics(robot, rotations)
    i = len(free.position) // 2
    body = bent_vessel(free, i, turn, bend)
    pose = tubeopt.forward_kinematics(robot, rotations, walls=[body])
    (contact,) = pose.walls.contacts
    point, thick = ArmSurface(pose).at(np.array([contact.arc_length]))
    assert np.allclose(body.depths(point), thick, rtol=0, atol=1e-7)
    normals = np.array([piece.gradient(point[0]) for piece in body.pieces])
    shares, *_ = np.linalg.lstsq(normals.T, contact.force, rcond=None)
    assert (shares > 0.1 * contact.size).all()
    assert np.allclose(shares @ normals, contact.force, rtol=0, atol=1e-6 * contact.size)
    ahead = np.gradient(ArmSurface(pose).centreline(contact.arc_length + np.array([-1e-5, 0, 1e-5])), 1e-5, axis=0)[1]
    assert abs(ahead @ contact.force) < 1e-5 * contact.size
    for direction in np.eye(3):
        far = [bent_vessel(free, i, turn, bend, k * 2e-5 * direction) for k in (1, -1)]
        high, low = (tubeopt.forward_kinematics(robot, rotations, walls=[each]).energy for each in far)
        assert (high - low) / 4e-5 == pytest.approx(np.dot(contact.force, direction), rel=1e-4, abs=1e-7)
    slope = pose.jacobian(wrt=["rotations"]), derivatives_of(pose, ["rotations"])
    far = [posed(pose, "rotations", 0, k * 1e-4) for k in (1, -1)]
    assert np.allclose((far[0].tip_position - far[1].tip_position) / 2e-4, slope[0].position[:, 0], atol=1e-8)
    pressing = (far[0].walls.contacts[0].size - far[1].walls.contacts[0].size) / 2e-4
    assert slope[1].contact_forces[0, 0] == pytest.approx(pressing, rel=1e-6)


def test_the_compliance_keeps_the_contact_closed(pressed):
    """Against differences of poses under small tip forces; along the wall it gives way, and it is symmetric."""
    robot, rotations, centre = pressed
    pose = tubeopt.forward_kinematics(robot, rotations, walls=ball(centre))
    assert np.allclose(pose.compliance, pose.compliance.T, rtol=0, atol=1e-9 * np.abs(pose.compliance).max())
    force = 1e-5
    for axis in range(3):
        push = force * np.eye(3)[axis]
        high, low = (
            tubeopt.forward_kinematics(robot, rotations, walls=ball(centre), load=Load(tuple(sign * push)))
            for sign in (1, -1)
        )
        slope = (high.tip_position - low.tip_position) / (2 * force)
        assert np.allclose(slope, pose.compliance[:3, axis], rtol=1e-5, atol=1e-5)


def test_the_margin_is_that_of_motions_along_the_wall():
    """A wall makes an arm stable that would fall without it; small motions along the wall gain no energy."""
    robot, home = tubeopt.load_robot("thesis_ctr"), [0.0, 0.0, 0.0]
    snap = tubeopt.find_snap(robot, (home, home), (np.radians([360, 0, 0]), home))
    fall = snap.after.tip_position - snap.before.tip_position
    fall /= np.linalg.norm(fall)
    wall = [Sphere(tuple(snap.before.tip_position + 16e-3 * fall), 15e-3)]
    path = tubeopt.follow(robot, np.radians([[0, 0, 0], [208, 0, 0], [216, 0, 0], [220, 0, 0]]), walls=wall)
    held, after = path.equilibria[2:]
    # Beyond the snap of the free robot the wall holds it, and then lets it pass.
    assert np.degrees(snap.rotations[0]) == pytest.approx(214.222, abs=1e-3)
    assert held.walls.contacts
    assert held.margin > 0
    (event,) = path.snaps
    assert 216 < np.degrees(event.rotations[0]) < 219
    assert event.before.margin < 0.05
    assert event.energy_released > 0
    assert event.tip_jump > 0.05
    # It lands where the free robot is.
    free = tubeopt.follow(robot, np.radians([[0, 0, 0], [220, 0, 0]])).equilibria[-1]
    assert not after.walls.contacts
    assert np.allclose(after.tip_position, free.tip_position, atol=1e-9)


def test_a_start_among_walls_keeps_its_branch(pressed):
    """From a neighbouring pose, and from none, to the same contact."""
    robot, rotations, centre = pressed
    start = tubeopt.forward_kinematics(robot, rotations + np.array([0.05, 0, 0]), walls=ball(centre))
    moved = tubeopt.forward_kinematics(robot, rotations, walls=ball(centre), start=start)
    direct = tubeopt.forward_kinematics(robot, rotations, walls=ball(centre))
    assert np.allclose(moved.tip_position, direct.tip_position, atol=1e-9)
    assert moved.walls.contacts[0].size == pytest.approx(direct.walls.contacts[0].size, rel=1e-6)


def test_a_pose_among_walls_is_saved(pressed, tmp_path):
    robot, rotations, centre = pressed
    pose = tubeopt.forward_kinematics(robot, rotations, walls=ball(centre))
    pose.save(tmp_path)
    back = tubeopt.load_equilibrium(tmp_path)
    assert back.walls.contacts == pose.walls.contacts
    assert np.array_equal(back.position, pose.position)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"walls": [Sphere((0, 0, 5e-3), 6e-3)]}, "a wall is 1.7 mm deep in the arm at the base plate"),
        ({"load": Load(moment=(1e-4, 0, 0))}, "load has a moment or turns with the tip"),
        ({"method": "energy"}, "walls are given; then method must be 'newton'"),
        ({"tolerance": 1e-12}, "tolerance at least 1e-08 rad"),
    ],
)
def test_what_walls_cannot_do_is_refused(pressed, changes, message):
    robot, rotations, centre = pressed
    with pytest.raises(InputError, match=message):
        tubeopt.forward_kinematics(robot, rotations, **({"walls": ball(centre)} | changes))


@pytest.mark.parametrize("fraction", [0.6, 1.0])
def test_derivatives_keep_contacts_closed(fraction):
    """Along the arm, where the contact slides, and at the tip, where it moves with the end of the tube."""
    robot, rotations, shift = tubeopt.load_robot("thesis_ctr"), np.array([0.0, 1.0, 2.0]), [-0.02, -0.01, -0.005]
    free = tubeopt.forward_kinematics(robot, rotations, shift)
    i = int(fraction * (len(free.position) - 1))
    walls = [Sphere(tuple(free.position[i] + free.frame[i] @ [7.5e-3, 0, 2e-3]), 8e-3)]
    pose = tubeopt.forward_kinematics(robot, rotations, shift, walls=walls)
    (contact,) = pose.walls.contacts
    assert (contact.arc_length == pytest.approx(free.arc_length[-1])) == (fraction == 1)
    jacobian, derivatives = pose.jacobian(wrt=["rotations", "translations", "curvature"]), derivatives_of(pose)
    k = int(np.argmin(np.abs(derivatives.shape.arc_length - 0.05)))
    s = derivatives.shape.arc_length[k]
    for name, column, step in [("rotations", 0, 1e-4), ("translations", 3, 2e-5), ("translations", 5, 2e-5)]:
        far = [posed(pose, name, column % 3, way * step) for way in (1, -1)]

        def slope(quantity, far=far, step=step):
            return (quantity(far[0]) - quantity(far[1])) / (2 * step)

        assert np.allclose(slope(lambda e: e.tip_position), jacobian.position[:, column], atol=1e-6)
        turn = Rotation.from_matrix(far[0].frame[-1] @ far[1].frame[-1].T).as_rotvec() / (2 * step)
        assert np.allclose(turn, jacobian.rotation[:, column], atol=1e-5)
        assert slope(lambda e: e.energy) == pytest.approx(jacobian.energy[column], abs=1e-7)
        pressing = slope(lambda e: e.walls.contacts[0].size)
        assert derivatives.contact_forces[0, column] == pytest.approx(pressing, rel=1e-3, abs=1e-6)
        assert np.allclose(slope(lambda e: e.rotation[:, -1]), jacobian.tip_rotations[:, column], atol=1e-5)
        along = slope(lambda e: ArmSurface(e).centreline(np.array([s]))[0])
        assert np.allclose(along, derivatives.position[k, :, column], atol=1e-6)
        assert slope(lambda e: derivatives_of(e).total_bend) == pytest.approx(derivatives.bend[column], rel=1e-3)
    far = [posed(pose, "curvature", 1, way * 1e-3) for way in (1, -1)]
    assert np.allclose((far[0].tip_position - far[1].tip_position) / 2e-3, jacobian.position[:, 7], atol=1e-7)
    margins = [posed(pose, "rotations", 0, way * 3e-3).margin for way in (1, -1)]
    assert (margins[0] - margins[1]) / 6e-3 == pytest.approx(pose.jacobian(wrt=["rotations"]).margin[0], rel=1e-2)


def posed(pose, name, tube, step):
    """Pose among the same walls with a joint value or a dimension of a tube a step further."""
    at = shifted(pose, name, tube, step)
    return tubeopt.forward_kinematics(at.robot, at.rotations, at.translations, walls=pose.walls.bodies)


def test_eccentric_robots_are_refused(pressed):
    _, rotations, centre = pressed
    with pytest.raises(InputError, match="concentric robots only"):
        tubeopt.forward_kinematics(tubeopt.load_robot("thesis_etr"), rotations, walls=ball(centre))

"""A valid call of every public function and constructor that takes input, for tests that change one argument."""

from __future__ import annotations

import inspect
import tempfile
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

import tubeopt
from tests.examples import CONFIGS, CRL, MM, THESIS
from tubeopt import bodies, design, planning, stability, validation, workspaces
from tubeopt.block.equilibrium_block import EquilibriumBlock
from tubeopt.bodies.frames import Frame
from tubeopt.control.c_library import c_library
from tubeopt.control.command import Command, ServoOptions
from tubeopt.control.crtk import CrtkRobot
from tubeopt.control.estimator import EstimatorOptions, StateEstimator
from tubeopt.control.server import RobotServer, ServerOptions
from tubeopt.control.servo import Servo
from tubeopt.equilibrium.jacobian import jacobian
from tubeopt.inverse import mirror

PAIR = tubeopt.ConcentricRobot(
    (tubeopt.Tube(1.0 * MM, 0.8 * MM, 0.06, 0.05, 8.0), tubeopt.Tube(1.4 * MM, 1.1 * MM, 0.02, 0.04, 6.0))
)
ONE = tubeopt.Tube(1.0 * MM, 0.8 * MM, 0.05, 0.05, 8.0)
NEXT = tubeopt.Tube(1.4 * MM, 1.1 * MM, 0.02, 0.04, 6.0)
BALL = bodies.Sphere((0.5, 0.5, 0.5), 0.01)

ARMS = [tubeopt.PlacedRobot(PAIR), tubeopt.PlacedRobot(PAIR, Frame(origin=np.array([0.1, 0.0, 0.0])))]

Given = Mapping[str, Any]
Call = tuple[Callable[..., Any], Callable[[], dict[str, Any]]]


@cache
def home() -> tubeopt.Equilibrium:
    return tubeopt.forward_kinematics(PAIR, [0.0, 0.3])


@cache
def crl_snap() -> tubeopt.Snap:
    rest = ([0.0, 0.0, 0.0], None)
    snap = tubeopt.find_snap(CRL, rest, ([2 * np.pi, 0.0, 0.0], None))
    assert snap is not None
    return snap


@cache
def task() -> tubeopt.DesignTask:
    free = (design.Free("curvature", (0, 1), 0.5, 6.0),)
    return tubeopt.DesignTask(tubeopt.ConcentricRobot((ONE, NEXT)), free, (design.SnapFree(0.05),))


@cache
def measured() -> validation.Measurements:
    rotations, shifts = np.zeros((4, 2)), np.zeros((4, 2))
    rotations[:, 1] = np.linspace(0, 1, 4)
    tips = [tubeopt.forward_kinematics(PAIR, row).tip_position for row in rotations]
    return validation.Measurements(rotations, shifts, np.array(tips)[:, None])


@cache
def reached() -> tubeopt.Workspace:
    return tubeopt.workspace(PAIR, 200)


def wanted(robot: Any, own: Any) -> tuple[float, float]:
    return 0.0, 1.0


def wanted_of_pair(one: Any, other: Any, own: Any) -> tuple[float, float]:
    return 0.0, 1.0


for each in (wanted, wanted_of_pair):
    each.description, each.ranges = "what is wanted", np.zeros((0, 2))  # type: ignore[attr-defined]


def _joints(**more: Any) -> Callable[[], dict[str, Any]]:
    return lambda: {"robot": PAIR, "rotations": [0.0, 0.3], **more}


DIRECTORY = Path(tempfile.gettempdir()) / "tubeopt-nothing-here"
"""Where nothing is."""

QUICK = planning.PlanOptions(time_limit=1.0, search_seconds=0.2)
"""Effort of plans that are asked for with one wrong argument."""

TIP = (0.0, -0.02, 0.1)

CALLS: dict[str, Call] = {
    "forward_kinematics": (tubeopt.forward_kinematics, _joints()),
    "forward_kinematics_batch": (tubeopt.forward_kinematics_batch, _joints(rotations=[[0.0, 0.3]])),
    "find_equilibria": (tubeopt.find_equilibria, _joints()),
    "find_load_limit": (
        tubeopt.find_load_limit,
        _joints(translations=None, load=tubeopt.Load((0, 0, -0.01)), up_to=2.0),
    ),
    "find_stroke_force": (tubeopt.find_stroke_force, _joints(up_to=0.1)),
    "find_snap": (tubeopt.find_snap, lambda: {"robot": PAIR, "start": ([0, 0], None), "end": ([0, 0.1], None)}),
    "snap_in_time": (tubeopt.snap_in_time, lambda: {"snap": crl_snap()}),
    "drive_loads": (tubeopt.drive_loads, lambda: {"equilibrium": home()}),
    "drives_along": (tubeopt.drives_along, _joints(rotations=[[0.0, 0.0], [0.0, 0.3]])),
    "drives_at": (tubeopt.drives_at, _joints(rotations=[[0.0, 0.3]])),
    "fatigue": (tubeopt.fatigue, _joints(rotations=[[0.0, 0.0], [0.0, 0.3]])),
    "follow": (tubeopt.follow, _joints(rotations=[[0.0, 0.0], [0.0, 0.3]])),
    "trace_branch": (tubeopt.trace_branch, lambda: {"robot": PAIR, "start": [0, 0], "end": [0, 0.1]}),
    "energy_map": (tubeopt.energy_map, _joints(samples=5)),
    "stability_map": (tubeopt.stability_map, lambda: {"robot": THESIS, "samples": 2, "directions": 2}),
    "certify": (tubeopt.certify, lambda: {"robot": PAIR}),
    "snap_distance": (tubeopt.snap_distance, lambda: {"equilibrium": home()}),
    "snap_free_certificate": (tubeopt.snap_free_certificate, lambda: {"robot": PAIR}),
    "deflection_bound": (tubeopt.deflection_bound, lambda: {"robot": PAIR, "max_force": 1e-3}),
    "assess_snapping": (tubeopt.assess_snapping, lambda: {"robot": PAIR}),
    "worst_margin": (tubeopt.worst_margin, lambda: {"robot": PAIR}),
    "worst_certificate": (
        tubeopt.worst_certificate,
        lambda: {
            "robot": PAIR,
            "lower": [-0.01, -0.01],
            "upper": [0.0, 0.0],
            "effort": stability.SnapSearch(evaluations=10),
        },
    ),
    "friction_band": (
        tubeopt.friction_band,
        lambda: {"equilibrium": home(), "friction": tubeopt.Friction(torque=1e-5)},
    ),
    "clearance_correction": (tubeopt.clearance_correction, lambda: {"equilibrium": home(), "clearance": 1e-4}),
    "jacobian": (jacobian, lambda: {"equilibrium": home()}),
    "inverse_kinematics": (
        tubeopt.inverse_kinematics,
        lambda: {
            "robot": PAIR,
            "position": home().tip_position,
            "start": ([0.0, 0.2], None),
            "options": tubeopt.InverseOptions(time_limit=1.0),
        },
    ),
    "IkSession": (tubeopt.IkSession, lambda: {"robot": PAIR}),
    "estimate_force": (tubeopt.estimate_force, _joints(tip_position=home().tip_position)),
    "estimate_forces": (tubeopt.estimate_forces, lambda: {"robot": PAIR, "measurements": measured()}),
    "plan_trajectory": (
        tubeopt.plan_trajectory,
        lambda: {"robot": PAIR, "start": ([0, 0], None), "goal": ([0, 0.1], None), "options": QUICK},
    ),
    "follow_the_leader": (
        tubeopt.follow_the_leader,
        lambda: {"robot": PAIR, "goal": ([0, 0.1], None), "options": QUICK},
    ),
    "follow_tip_path": (
        tubeopt.follow_tip_path,
        lambda: {"robot": PAIR, "path": [home().tip_position, home().tip_position + 1e-4], "options": QUICK},
    ),
    "deploy": (
        tubeopt.deploy,
        lambda: {
            "robot": PAIR,
            "path": [[0.0, 0.0, 0.02]],
            "walls": [bodies.Corridor([[0, 0, -0.05], [0, 0, 0.05]], 0.03)],
        },
    ),
    "build_roadmap": (tubeopt.build_roadmap, lambda: {"robot": PAIR, "count": 4, "options": QUICK}),
    "evaluate_reach": (
        tubeopt.evaluate_reach,
        lambda: {
            "robot": PAIR,
            "start": ([0, 0], None),
            "targets": [home().tip_position],
            "count": 4,
            "options": QUICK,
        },
    ),
    "plan_from_region": (
        tubeopt.plan_from_region,
        lambda: {
            "robot": PAIR,
            "start": ([0, 0], None),
            "goal": ([0, 0.1], None),
            "region": tubeopt.EntryRegion(0.001),
            "count": 2,
            "options": QUICK,
        },
    ),
    "plan_arms": (
        tubeopt.plan_arms,
        lambda: {
            "arms": ARMS,
            "starts": [([0, 0], None)] * 2,
            "goals": [([0, 0.1], None)] * 2,
            "options": QUICK,
        },
    ),
    "verify_trajectory": (
        tubeopt.verify_trajectory,
        lambda: {"robot": PAIR, "time": [0, 1], "rotations": [[0, 0], [0, 0.05]]},
    ),
    "verify_arms": (
        tubeopt.verify_arms,
        lambda: {
            "arms": ARMS,
            "motions": [SimpleNamespace(time=np.arange(2.0), rotations=np.zeros((2, 2)), translations=np.zeros((2, 2)))]
            * 2,
        },
    ),
    "workspace": (tubeopt.workspace, lambda: {"robot": PAIR, "samples": 20}),
    "snapping_loss": (tubeopt.snapping_loss, lambda: {"robot": PAIR, "samples": 50}),
    "alpha_volume": (workspaces.alpha_volume, lambda: {"workspace": reached()}),
    "meridian_volume": (workspaces.meridian_volume, lambda: {"workspace": reached()}),
    "voxel_volume": (workspaces.voxel_volume, lambda: {"workspace": reached()}),
    "voxels": (workspaces.voxels, lambda: {"workspace": reached()}),
    "examine": (workspaces.examine, lambda: {"workspace": reached()}),
    "shared_workspace": (
        workspaces.shared_workspace,
        lambda: {"workspaces": [reached(), reached()], "bases": [Frame(), Frame()]},
    ),
    "place_pair": (
        workspaces.place_pair,
        lambda: {"workspaces": [reached(), reached()], "min_distance": 0.01, "max_distance": 0.02, "size": 0.05},
    ),
    "optimize_design": (tubeopt.optimize_design, lambda: {"task": task(), "turns": 0}),
    "search_design": (
        tubeopt.search_design,
        lambda: {"task": task(), "objective": wanted, "time_limit": 0.1, "turns": 0},
    ),
    "search_pair": (
        tubeopt.search_pair,
        lambda: {"tasks": (task(), task()), "objective": wanted_of_pair, "time_limit": 0.1, "turns": 0},
    ),
    "pareto_front": (design.pareto_front, lambda: {"task": task(), "margins": [0.05]}),
    "tolerance_analysis": (
        design.tolerance_analysis,
        lambda: {"robot": task().robot, "tolerances": design.Tolerances(0.01), "samples": 4},
    ),
    "count_snaps": (design.count_snaps, lambda: {"robot": task().robot, "turns": 1}),
    "choose_from_stock": (
        design.choose_from_stock,
        lambda: {
            "task": task(),
            "stock": [design.StockTube("a", 1.0 * MM, 0.8 * MM), design.StockTube("b", 1.4 * MM, 1.1 * MM)],
        },
    ),
    "Corridor": (design.Corridor, lambda: {"centreline": ((0, 0, 0), (0, 0, 0.1)), "radius": 0.01}),
    "validate": (validation.validate, lambda: {"robot": PAIR, "measurements": measured()}),
    "fit": (
        validation.fit,
        lambda: {"robot": PAIR, "measurements": measured(), "parameters": ["curvature"]},
    ),
    "compare_effects": (
        validation.compare_effects,
        lambda: {"robot": PAIR, "measurements": measured(), "effects": ["rotation"]},
    ),
    "choose_parameters": (
        validation.choose_parameters,
        lambda: {"robot": PAIR, "measurements": measured(), "names": ["curvature"]},
    ),
    "register": (validation.register, lambda: {"measured": np.eye(3), "predicted": np.eye(3)}),
    "where_to_measure": (
        validation.where_to_measure,
        lambda: {"robot": PAIR, "parameters": ["curvature"], "count": 4},
    ),
    "group_errors": (validation.group_errors, lambda: {"values": np.arange(4.0), "errors": np.arange(4.0)}),
    "nearest_distance": (bodies.nearest_distance, lambda: {"obstacles": [BALL], "points": [[0, 0, 0]]}),
    "mirror_inverse": (
        mirror.mirror_inverse,
        lambda: {"robot": tubeopt.load_robot(CONFIGS / "thesis_etr.yaml"), "bending_direction": 0.3, "curvature": 3.0},
    ),
    "save_table": (tubeopt.save_table, lambda: {"answer": home(), "path": DIRECTORY / "table.csv"}),
    "save_solid": (tubeopt.save_solid, lambda: {"equilibrium": home(), "path": DIRECTORY / "solid.stl"}),
    "save_robot": (tubeopt.save_robot, lambda: {"robot": PAIR, "path": DIRECTORY / "robot.yaml"}),
    "load_measurements": (
        tubeopt.load_measurements,
        lambda: {"path": CONFIGS.parent / "experiments" / "thesis_table_4_1.csv", "robot": THESIS},
    ),
    "load_study": (tubeopt.load_study, lambda: {"path": CONFIGS.parent / "studies" / "thesis_snap.yaml"}),
    "plot_shape": (tubeopt.plot_shape, lambda: {"equilibrium": home()}),
    "plot_shapes": (tubeopt.plot_shapes, lambda: {"equilibria": [home()]}),
    "load_robot": (tubeopt.load_robot, lambda: {"path": CONFIGS / "two_tube.yaml"}),
    "load_equilibrium": (tubeopt.load_equilibrium, lambda: {"directory": DIRECTORY}),
    "load_problem_solution": (tubeopt.load_problem_solution, lambda: {"directory": DIRECTORY}),
    "load_rig": (tubeopt.load_rig, lambda: {"path": DIRECTORY}),
    "load_oven": (tubeopt.load_oven, lambda: {"path": DIRECTORY}),
    "load_roadmap": (tubeopt.load_roadmap, lambda: {"path": DIRECTORY}),
    "load_workspace": (tubeopt.load_workspace, lambda: {"robot": PAIR, "directory": DIRECTORY}),
    "plan_mold": (tubeopt.plan_mold, lambda: {"tubes": ONE}),
    "plan_oven": (tubeopt.plan_oven, lambda: {"tube": ONE, "oven": tubeopt.load_oven("steel_slab")}),
    "c_library": (c_library, lambda: {"robot": PAIR}),
    "Servo": (Servo, lambda: {"robot": PAIR, "start": ([0.0, 0.2], None)}),
    "StateEstimator": (StateEstimator, lambda: {"start": home()}),
    "CrtkRobot": (CrtkRobot, lambda: {"servo": Servo(PAIR, ([0.0, 0.2], None))}),
    "RobotServer": (RobotServer, lambda: {"robot": CrtkRobot(Servo(PAIR, ([0.0, 0.2], None)))}),
    "EquilibriumBlock": (EquilibriumBlock, lambda: {"opti": tubeopt.Problem(), "initial": home()}),
}

REQUIRED: dict[str, dict[str, Any]] = {
    "Tube": {
        "outer_diameter": 1 * MM,
        "inner_diameter": 0.8 * MM,
        "straight_length": 0.05,
        "curved_length": 0.05,
        "curvature": 8.0,
    },
    "Material": {"name": "alloy", "youngs_modulus": 58e9, "shear_modulus": 21.5e9},
    "Piece": {"length": 0.02, "precurvature": 5.0},
    "ConcentricRobot": {"tubes": (ONE, NEXT)},
    "EccentricRobot": {"tube": ONE},
    "EntryRegion": {"radius": 0.001},
    "Deployment": {"limit": 0.001},
    "JointLimits": {"rotations": ((-1, 1), (-1, 1)), "translations": ((-0.01, 0), (-0.01, 0))},
    "PlacedRobot": {"robot": PAIR},
    "TipGoal": {"position": TIP},
    "DesignTask": {"robot": task().robot, "free": task().free},
    "RegionReach": {"start": ([0, 0], None), "targets": [TIP]},
    "PairReach": {"starts": (([0, 0], None), ([0, 0], None)), "bases": (Frame(), Frame()), "targets": [TIP, TIP]},
    "Avoid": {"obstacles": (BALL,)},
    "Coverage": {"lower": (0, 0, 0.1), "upper": (0.01, 0.01, 0.11)},
    "Free": {"field": "curvature", "tubes": (0,), "lower": 1.0, "upper": 2.0},
    "Length": {"field": "length", "tube": 0, "limit": 0.1},
    "Objective": {"kind": "change"},
    "Poses": {"rotations": [[0, 0]], "translations": [[0, 0]]},
    "Reach": {"targets": (design.Target(TIP),)},
    "StockTube": {"name": "a", "outer_diameter": 1 * MM, "inner_diameter": 0.8 * MM},
    "Stroke": {"limit": 0.01},
    "StrokeForce": {"limit": 0.01},
    "Target": {"position": TIP},
    "Wall": {"thickness": 1e-4},
    "Box": {"low": (0, 0, 0), "high": (1, 1, 1)},
    "Capsule": {"start": (0, 0, 0), "end": (0, 0, 1), "radius": 0.1},
    "HalfSpace": {"point": (0, 0, 0), "normal": (0, 0, 1)},
    "MeshObstacle": {
        "vertices": ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)),
        "faces": ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2)),
    },
    "Sphere": {"centre": (0, 0, 0), "radius": 0.1},
    "Measurements": {"rotations": [[0, 0]], "translations": [[0, 0]], "sensors": [[[0, 0, 0.1]]]},
    "Workspace": {},
}
"""Arguments of constructors that have no default."""

CONSTRUCTORS: dict[Any, str] = {
    tubeopt: """Tube Material Piece ConcentricRobot EccentricRobot JointLimits Load Friction Slots Discretisation Newton
        Ipopt Problem EntryRegion PlacedRobot PlanOptions RateLimits TipGoal
        RegionReach PairReach DesignTask DesignSolver InverseOptions EquilibriaSearch
        SnapSearch MoldSpec HeatingSpec Rig Uncertainty Camera Thermocouple TubeResistance""",
    design: """Avoid Coverage Deployment Free Length Nesting Objective Poses Reach SnapFree SnapFreeInUse StockTube
        Strain Stroke StrokeForce Target Tolerances Wall""",
    bodies: "Box Capsule HalfSpace MeshObstacle Sphere",
    validation: "BasePose FitOptions Measurements",
}

for owner, names in CONSTRUCTORS.items():
    for name in names.split():
        CALLS[name] = getattr(owner, name), lambda name=name: dict(REQUIRED.get(name, {}))
for kind in (Command, ServoOptions, EstimatorOptions, ServerOptions):
    CALLS[kind.__name__] = kind, dict

WRONG: dict[str, Any] = {
    "None": None,
    "a text": "wrong",
    "a number as text": "0.5",
    "a number": 3,
    "a fraction": 1.5,
    "a truth": True,
    "no number": float("nan"),
    "a complex number": 1 + 2j,
    "an empty list": [],
    "a ragged list": [[1.0], [2.0, 3.0]],
    "a list of texts": ["a", "b"],
    "a dict": {"a": 1.0},
    "a material": tubeopt.NITINOL,
    "a tuple of tubes": (ONE, ONE),
    "a path": Path("nowhere"),
    "an array of no dimension": np.array(1.0),
    "a table": np.ones((2, 2)),
    "an object": object(),
}
"""One of each kind that somebody may pass where it does not belong."""


def wrong_values(parameter: inspect.Parameter, given: Callable[[], Given]) -> list[tuple[str, Any]]:
    """Label and value; None is left out where it is the default, since it is right there."""
    processes = parameter.name == "workers"  # which numbers start
    return [
        (label, value)
        for label, value in WRONG.items()
        if not (value is None and parameter.default is None) and not (processes and isinstance(value, int))
    ]

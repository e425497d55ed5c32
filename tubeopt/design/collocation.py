"""A design task as one nonlinear program of equilibrium blocks, with exact second derivatives, solved by IPOPT.

The equilibria of all poses are unknowns beside the dimensions and the joint values. It answers the same question as the
reduced program, in another way: the order of the breakpoints is that of the start, and requirements that no block
expresses are refused.
"""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import cache
from itertools import chain
from typing import Any

import casadi as ca
import numpy as np

from ..block.custom import CustomRequirement
from ..block.equilibrium_block import EquilibriumBlock, OrderWarning
from ..block.quantities import PoseNumber, Quantity
from ..equilibrium.kinematics import forward_kinematics
from ..equilibrium.result import Equilibrium
from ..errors import InputError
from ..physics.certificate import determinant_function
from ..physics.strain import surface_strain
from ..robots.assembly import assemble
from ..robots.breakpoints import DIMENSIONS
from ..robots.concentric import ConcentricRobot
from ..solvers.named_program import in_time
from ..solvers.time_limit import check_time
from ..stability.certificate import breakpoint_pattern
from ..typing import Array
from .attempt import Attempt, attempt, evaluated_at, objective_value
from .layout import Via
from .objectives import AnyObjective, Objective, key_of
from .program import BOUNDED, Program
from .requirements import Avoid, Coverage, Length, Nesting, Poses, Reach, SnapFree, SnapFreeInUse, Strain, Stroke, Wall
from .rows import linear_rows
from .task import DesignTask

TAKEN = (CustomRequirement, Coverage, Length, Nesting, Poses, Reach, SnapFree, SnapFreeInUse, Strain, Stroke, Wall)
"""Requirements that the program takes."""

HELD = (3e-7, 3e-6)
"""Part of a step by which limits are held inside, for what blocks and the reduced program differ; the second where the
first is not enough."""

DEEPEST = 1e-7
"""How exactly (m) the pose of the objective reach_radius keeps its depth."""

EXACT: dict[str, Any] = {"ipopt.bound_relax_factor": 0.0, "ipopt.honor_original_bounds": "yes"}
"""Bounds are kept as they are."""

UNKNOWN = {
    "clearance": "clearance from a body",
    "deflection": "deflection under a force",
    "stroke_force": "stroke force",
    "jacobian": "Jacobian of the tip (its second derivatives are too many)",
    "turning": "Jacobian of the tip (its second derivatives are too many)",
}
"""Quantities that no block of a design has."""

REFUSED: dict[type[Any], str] = {
    Strain: "in poses, since it is largest between the points of a block",
    Avoid: "since the arm comes nearest to a body between the points of a block",
}
"""Requirements that no block expresses, and why."""


def check_collocation(task: DesignTask) -> None:
    """Raise InputError where a task holds a requirement that no block expresses, or is about pieces."""
    if task.space.pieced:
        raise InputError("method 'collocation' does not support free shapes and slots of pieces; use method 'reduced'")
    for one in task.requirements:
        if not isinstance(one, TAKEN) or (isinstance(one, Strain) and one.in_poses and task.has_poses):
            why = f" {REFUSED[type(one)]}" if type(one) in REFUSED else ""
            raise InputError(
                f"method 'collocation' does not support the requirement {type(one).__name__}{why}; use method 'reduced'"
            )


def collocate(program: Program, x: Array) -> Attempt:
    """The optimum of the collocated program from x (X,), SI, at which the poses have equilibria."""
    check_collocation(program.task)
    if any(isinstance(pose, Via) for pose in program.layout.poses):
        raise InputError("method 'collocation' does not support margins on joint paths; use method 'reduced'")
    for held in HELD:
        found, words = _Collocated(program, x, held).solved()
        reached = attempt(program, np.clip(found, program.lower, program.upper))
        if words or reached.feasible:
            break
    if not words:
        return reached
    return replace(reached, violation=np.inf, worst=f"convergence of the collocated program ({words})")


class _Collocated:
    """The program: unknowns as in the layout of the reduced one, and blocks near the equilibria at x."""

    def __init__(self, program: Program, x: Array, held: float) -> None:
        self.program, self.opti, self.held = program, ca.Opti(), held
        start = evaluated_at(program, x)
        self.state = start.state
        scaled = self.opti.variable(len(x))
        self.opti.set_initial(scaled, x / program.scale)
        self.opti.subject_to(self.opti.bounded(program.lower / program.scale, scaled, program.upper / program.scale))
        self.x = scaled * ca.DM(program.scale)
        self.moved = self.x - ca.DM(self.state.x)
        layout = program.layout
        self.dimensions = layout.space.expressions(self.x[: layout.designs])
        self.robot = ConcentricRobot(self.state.tubes)
        self.blocks: dict[PoseNumber, EquilibriumBlock[Equilibrium]] = {}
        for k in range(len(layout.poses)):
            self._block(k)
        self.look = cache(self._quantity)
        """A quantity as an expression of the program."""
        values, slopes = linear_rows(self.state, program.task)
        self._at_least(ca.DM(values) + ca.DM(slopes) @ self.moved)
        for statement in chain.from_iterable(program.stated):
            self._at_least(statement.expression(self.look) / statement.limit.size - self.held)
        aims = [one.sign * one.weight * self._aim(one) for one in program.task.objectives]
        self.opti.minimize(sum(aims) / start.size)

    def _block(self, k: PoseNumber) -> EquilibriumBlock[Equilibrium]:
        """The block of a pose, or of its arm drawn back, posed where it is first asked for."""
        if k not in self.blocks:
            self.blocks[k] = self._posed(k)
        return self.blocks[k]

    def _posed(self, k: PoseNumber) -> EquilibriumBlock[Equilibrium]:
        joints, slopes = self.state.joint_values(k), self.state.joint_slopes(k)
        near = forward_kinematics(self.robot, *joints)
        # Joint values are linear in the unknowns.
        given = [
            ca.DM(value) + ca.DM(slope) @ self.moved if slope.any() else value
            for value, slope in zip(joints, slopes, strict=True)
        ]
        free = {name: self.dimensions[name] for name in DIMENSIONS if self.state.slopes[name].any()}
        return EquilibriumBlock(self.opti, near, rotations=given[0], translations=given[1], tubes=free)

    def _at_least(self, expression: Any, size: float = 1.0) -> None:
        # What no unknown moves was kept at the start.
        if expression.numel() and ca.depends_on(expression, self.opti.x):
            self.opti.subject_to(ca.vec(expression) / size >= 0)

    # --- quantities ---------------------------------------------------------------------------------------------------

    def _quantity(self, one: Quantity) -> Any:
        if one.name == "certificate":
            return self._certificate(one.at)
        if one.name == "straightened_strain":
            radius, natural = (self.dimensions[name][one.at[0]] for name in ("outer_diameter", "curvature"))
            return surface_strain(radius / 2, ca.fabs(natural), natural)
        if one.pose is None:
            return self.dimensions[one.name]
        block = self._block(one.pose)
        match one.name:
            case "strain":
                return ca.mmax(block.strain(one.at[0]))
            case name if name in UNKNOWN:
                raise InputError(f"method 'collocation' does not support the {UNKNOWN[name]}; use method 'reduced'")
            case "tip_direction":
                return block.tip_rotation[:, 2]
            case "margin":
                return self._margin(one.pose)
            case "position" | "curvature":
                return getattr(block, one.name)(one.at[0])
            case name:
                return ca.MX(getattr(block, name))

    def _margin(self, pose: PoseNumber) -> Any:
        """An unknown that the margin of a pose is not below: as good as the margin where more of it is better."""
        margin = self.opti.variable()
        self.opti.set_initial(margin, min(max(self.state.pose(pose).margin - 0.01, 0.0), 0.9))
        self.opti.subject_to(margin <= 0.999)  # the greatest that a block can be asked for
        self._block(pose).margin_at_least(margin)
        return margin

    def _certificate(self, translations: tuple[float, ...]) -> Any:
        """mu_cert = 1 - lambda, with lambda an unknown: the root of D nearest to that of the start."""
        shift = np.array(translations)
        assembly = assemble(self.state.tubes, shift)
        function = determinant_function(breakpoint_pattern(assembly))
        root = self.opti.variable()
        self.opti.set_initial(root, 1 - self.state.certificate_at(translations)[0])
        names = ("bending_stiffness", "torsional_stiffness", "curvature", "straight_length", "curved_length")
        self.opti.subject_to(function(root, *(self.dimensions[name] for name in names), shift) == 0)
        return 1 - root

    # --- what is posed ------------------------------------------------------------------------------------------------

    def _aim(self, one: AnyObjective) -> Any:
        """An objective in its own sign, SI; of several numbers an unknown that none is worse than."""
        layout = self.program.layout
        if one not in self.program.aims:
            space = layout.space
            base = np.where(np.abs(space.start) > 0, space.start, space.scale)
            return ca.sumsqr((self.x[: len(base)] - ca.DM(space.start)) / ca.DM(base))
        if isinstance(one, Objective) and one.depth is not None and self.program.depth_pose is not None:
            height = self.blocks[self.program.depth_pose].tip_position[2] - one.depth
            self.opti.subject_to(self.opti.bounded(-DEEPEST / 1e-2, height / 1e-2, DEEPEST / 1e-2))
        numbers = self.program.aims[one](self.look)
        if numbers.numel() == 1 and key_of(one) not in layout.auxiliary:
            return numbers
        if key_of(one) in layout.auxiliary:
            worst = self.x[layout.column(key_of(one))]
        else:
            worst = self.opti.variable()
            self.opti.set_initial(worst, objective_value(self.program, self.state, one)[0])
        self._at_least(one.sign * (worst - numbers), BOUNDED.get(key_of(one), (0.0, 0.0, 1.0))[2])
        return worst

    def solved(self) -> tuple[Array, str]:
        """x (X,) where IPOPT ended, and in its words why not at an optimum, "" where it did."""
        self.opti.solver("ipopt", {**in_time(self.program.task.solver.collocation).options(warm=False), **EXACT})
        solution: Any
        try:
            solution = self.opti.solve()
        except RuntimeError:
            solution = self.opti.debug
        check_time()
        for k, block in self.blocks.items():
            for text in block.meetings(solution):
                where = f"task pose {k + 1}" if isinstance(k, int) else f"task pose {k[0] + 1}, drawn back,"
                words = f"at {where} {text}: better designs may lie beyond; method 'reduced' searches there"
                warnings.warn(words, OrderWarning, stacklevel=2)
        stats = self.opti.stats()
        words = "" if stats["success"] else str(stats["return_status"]).replace("_", " ").lower()
        return np.array(solution.value(self.x)).ravel(), words

"""The torsion of an arm in a nonlinear program: its unknowns and equations, on the mesh of a reduced problem.

Constants of the arm are parameters of the program or expressions of its other variables, so that one program serves all
arms of one structure.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ...typing import Array
from .arm import Profile, rotations_at
from .chain import column_length, interpolated_columns
from .collocated import Grid
from .model import TorsionModel, unknowns_of
from .reduced import ReducedProblem


@dataclass(frozen=True)
class Violation:
    """A violated constraint."""

    name: str
    amount: float
    """Amount of the violation, in its own units."""
    relative: float
    """Amount of the violation relative to its scale."""

    def __str__(self) -> str:
        return f"{self.name}: violated by {self.amount:.1e}"


def violations_of(
    names: Sequence[str], values: Array, bounds: tuple[Array, Array], scale: Array, tolerance: float
) -> list[Violation]:
    """Constraints lower <= values <= upper that are violated by more than `tolerance` times their scale."""
    lower, upper = bounds
    amount = np.maximum(lower - values, values - upper)
    amount = np.where(np.isfinite(values), amount, np.inf)
    violated = np.flatnonzero(amount > tolerance * scale)
    return [Violation(names[k], float(amount[k]), float(amount[k] / scale[k])) for k in violated.tolist()]


def worst(violations: Iterable[Violation], count: int) -> tuple[Violation, ...]:
    """The `count` largest violations relative to their scales, largest first."""
    return tuple(sorted(violations, key=lambda each: -each.relative)[:count])


class Program(Protocol):
    """A nonlinear program under construction."""

    def variable(self, name: str, size: int = 1, *, guess: ArrayLike = 0.0, scale: ArrayLike = 1.0) -> Any:
        """Column of `size` unknowns."""

    def subject_to(
        self,
        name: str,
        expression: Any,
        *,
        upper: ArrayLike = np.inf,
        scale: ArrayLike = 1.0,
        entries: Sequence[str] | None = None,
    ) -> None:
        """Constrain 0 <= expression <= upper; `entries` are the labels of its rows."""

    def parameter(self, name: str, value: ArrayLike) -> Any:
        """Column of numbers that may be changed between solves."""

    def set_value(self, parameter: Any, value: ArrayLike) -> None:
        """Set the value of a parameter."""

    def set_guess(self, variable: Any, value: ArrayLike) -> None:
        """Set the start value of a variable."""

    def rename(self, name: str, entries: Sequence[str]) -> None:
        """Set the labels of the rows of a constraint."""

    def enter(self, block: Any) -> str:
        """Default name of a newly registered block. The program may later change the order of its breakpoints."""


@dataclass(frozen=True)
class Structure:
    """Structure of an arm in a program; arms of equal structure share one program with other parameters."""

    grid: Grid
    section: tuple[int, ...]
    """Section of each element, from 0."""
    coupled: tuple[bool, ...]
    """Mask of the elements with nonlinear torsion."""

    @property
    def shapes(self) -> dict[str, tuple[int, int]]:
        """Shapes of the constants of an arm, by their names in `TorsionModel`."""
        n, elements = self.grid.n_tubes, len(self.section)
        shapes = {"transmission": (n, 1), "lengths": (elements, 1), "torsional_stiffness": (n, elements)}
        if self.grid.detail:
            return {**shapes, "along": (column_length(n, self.grid.detail), elements)}
        shapes |= {"stiffness": (n, elements), "moment": (n, elements)}
        return {**shapes, **({"offset": (n, 1), "angle": (n, 1)} if self.grid.eccentric else {})}


def structure_of(problem: ReducedProblem) -> Structure:
    """Structure of a reduced problem's mesh."""
    mesh, assembly = problem.mesh, problem.assembly
    detail = mesh.tableau.degree if assembly.general else 0
    grid = Grid(assembly.n_tubes, mesh.tableau.family, mesh.tableau.degree, assembly.eccentric, detail)
    return Structure(grid, tuple(mesh.section.tolist()), tuple(mesh.collocated.tolist()))


def torsion_numbers(problem: ReducedProblem) -> dict[str, Array]:
    """Constants of the arm of a problem by name, each by columns."""
    assembly, mesh = problem.assembly, problem.mesh
    if assembly.general:
        kt = assembly.held_stiffness
        return {
            "transmission": problem.compliant.transmission * kt,
            "lengths": mesh.length,
            "torsional_stiffness": np.tile(kt, len(mesh.length)),
            "along": interpolated_columns(problem.compliant.sections, mesh.tableau.nodes),
        }
    offsets = {"offset": assembly.offset, "angle": assembly.offset_angle} if assembly.eccentric else {}
    stiffness, moment = problem.on_elements
    return {
        "transmission": assembly.transmission,
        "lengths": mesh.length,
        "stiffness": stiffness.ravel(),
        "moment": moment.ravel(),
        "torsional_stiffness": np.tile(assembly.torsional_stiffness, len(mesh.length)),
        **offsets,
    }


def torsion_constants(program: Program, structure: Structure, expressions: Mapping[str, Any]) -> dict[str, Any]:
    """Constants of an arm by name: `expressions` of the program, the others as parameters with the value 0."""
    constants = dict(expressions)
    for name, (rows, columns) in structure.shapes.items():
        if name not in expressions:
            constants[name] = ca.reshape(program.parameter(name, np.zeros(rows * columns)), rows, columns)
    return constants


def add_torsion(program: Program, structure: Structure, rotations: Any, expressions: Mapping[str, Any]) -> TorsionModel:
    """Add the torsion of an arm with tubes clamped at `rotations` (n,): as many equations as unknowns.

    Args:
        expressions: constants of the arm that are expressions of the program, by name; the others become parameters.
    """
    constants = torsion_constants(program, structure, expressions)
    offsets = tuple(constants.pop(name) for name in ("offset", "angle") if name in constants)
    constants = {"stiffness": None, "moment": None, "along": None, **constants}
    theta, twist, inner = (
        ca.reshape(program.variable(name, rows * columns), rows, columns)
        for name, (rows, columns) in list(unknowns_of(structure.grid, len(structure.section)).items())[:3]
    )
    arm = TorsionModel(structure.grid, theta=theta, twist=twist, inner=inner, offsets=offsets, **constants)
    for each in arm.torsion_equations(rotations, 1.0, structure.section):
        program.subject_to(each.name, each.expression, upper=0.0, entries=each.entries)
    return arm


def torsion_guess(problem: ReducedProblem, profile: Profile) -> dict[str, Array]:
    """Start of the unknowns of an arm by name, by columns, from a torsion profile on the same mesh."""
    theta = rotations_at(problem, profile, tuple(problem.mesh.tableau.nodes.tolist()))
    twist = profile.torque / problem.assembly.held_stiffness
    return {"rotation": profile.rotation.ravel(), "torsion": twist.ravel(), "rotation inside": theta.ravel()}


def compliance_ratio_at_plate(problem: ReducedProblem) -> Array:
    """Torsional compliance (n,) of tubes made of pieces at the plate, relative to that at the clamp."""
    assert problem.assembly.lengthwise is not None
    stiffness = problem.assembly.lengthwise.values(problem.assembly.transmission[None])[1][0]
    return np.asarray(problem.assembly.held_stiffness / stiffness)

"""The torsion of an arm in a nonlinear program: its unknowns and equations, on the mesh of a reduced problem.

What is given of the arm are parameters of the program or expressions of its other variables, so that one program serves
all arms of one structure.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from ...typing import Array
from .arm import Profile, rotations_at
from .chain import at_points, width
from .collocated import Grid
from .model import TorsionModel, unknowns_of
from .reduced import ReducedProblem


class Program(Protocol):
    """A nonlinear program under construction."""

    def variable(self, name: str, size: int = 1, *, guess: ArrayLike = 0.0, scale: ArrayLike = 1.0) -> Any:
        """A column of `size` unknowns."""

    def subject_to(
        self,
        name: str,
        expression: Any,
        *,
        upper: ArrayLike = np.inf,
        scale: ArrayLike = 1.0,
        entries: Sequence[str] | None = None,
    ) -> None:
        """Demand 0 <= expression <= upper; `entries` are words for each row."""

    def parameter(self, name: str, value: ArrayLike) -> Any:
        """A column of numbers that may be changed between solves."""

    def set_value(self, parameter: Any, value: ArrayLike) -> None:
        """Give a parameter other numbers."""

    def set_guess(self, variable: Any, value: ArrayLike) -> None:
        """Start the next solve there."""

    def rename(self, name: str, entries: Sequence[str]) -> None:
        """Give the rows of a constraint other words."""

    def enter(self, block: Any) -> str:
        """Take note of a block, which can be asked about its solution; returns what to call it."""


@dataclass(frozen=True)
class Structure:
    """What makes the arms of two problems the same program but for numbers: the section (from 0) of each piece, and
    whether its torsion is more than linear."""

    grid: Grid
    section: tuple[int, ...]
    coupled: tuple[bool, ...]

    @property
    def shapes(self) -> dict[str, tuple[int, int]]:
        """Of what is given of an arm, by its name in `TorsionModel`."""
        n, pieces = self.grid.n_tubes, len(self.section)
        shapes = {"transmission": (n, 1), "lengths": (pieces, 1), "torsional_stiffness": (n, pieces)}
        if self.grid.detail:
            return {**shapes, "along": (width(n, self.grid.detail), pieces)}
        shapes |= {"stiffness": (n, pieces), "moment": (n, pieces)}
        return {**shapes, **({"offset": (n, 1), "angle": (n, 1)} if self.grid.eccentric else {})}


def structure_of(problem: ReducedProblem) -> Structure:
    """Structure of a reduced problem's mesh."""
    mesh, assembly = problem.mesh, problem.assembly
    detail = mesh.tableau.degree if assembly.general else 0
    grid = Grid(assembly.n_tubes, mesh.tableau.family, mesh.tableau.degree, assembly.eccentric, detail)
    return Structure(grid, tuple(mesh.section.tolist()), tuple(mesh.collocated.tolist()))


def torsion_numbers(problem: ReducedProblem) -> dict[str, Array]:
    """What is given of the arm of a problem, each by columns."""
    assembly, mesh = problem.assembly, problem.mesh
    if assembly.general:
        kt = assembly.held_stiffness
        return {
            "transmission": problem.here.transmission * kt,
            "lengths": mesh.length,
            "torsional_stiffness": np.tile(kt, len(mesh.length)),
            "along": at_points(problem.here.sections, mesh.tableau.nodes),
        }
    place = {"offset": assembly.offset, "angle": assembly.offset_angle} if assembly.eccentric else {}
    stiffness, moment = problem.on_pieces
    return {
        "transmission": assembly.transmission,
        "lengths": mesh.length,
        "stiffness": stiffness.ravel(),
        "moment": moment.ravel(),
        "torsional_stiffness": np.tile(assembly.torsional_stiffness, len(mesh.length)),
        **place,
    }


def torsion_given(program: Program, structure: Structure, own: Mapping[str, Any]) -> dict[str, Any]:
    """What is given of an arm, by name: `own` are expressions of the program, the rest parameters, all 0."""
    inputs = dict(own)
    for name, (rows, columns) in structure.shapes.items():
        if name not in own:
            inputs[name] = ca.reshape(program.parameter(name, np.zeros(rows * columns)), rows, columns)
    return inputs


def add_torsion(program: Program, structure: Structure, rotations: Any, own: Mapping[str, Any]) -> TorsionModel:
    """Add the torsion of an arm whose tubes are held at `rotations` (n,): a square system if all is given.

    Of what is given of it `own` are expressions of the program; the rest become parameters, of the same names.
    """
    inputs = torsion_given(program, structure, own)
    place = tuple(inputs.pop(name) for name in ("offset", "angle") if name in inputs)
    inputs = {"stiffness": None, "moment": None, "along": None, **inputs}
    theta, twist, inner = (
        ca.reshape(program.variable(name, rows * columns), rows, columns)
        for name, (rows, columns) in list(unknowns_of(structure.grid, len(structure.section)).items())[:3]
    )
    arm = TorsionModel(structure.grid, theta=theta, twist=twist, inner=inner, place=place, **inputs)
    for each in arm.torsion_equations(rotations, 1.0, structure.section):
        program.subject_to(each.name, each.expression, upper=0.0, entries=each.entries)
    return arm


def torsion_guess(problem: ReducedProblem, profile: Profile) -> dict[str, Array]:
    """The unknowns of an arm, by name and by columns, at a torsion profile on the same mesh."""
    theta = rotations_at(problem, profile, tuple(problem.mesh.tableau.nodes.tolist()))
    twist = profile.torque / problem.assembly.held_stiffness
    return {"rotation": profile.rotation.ravel(), "torsion": twist.ravel(), "rotation inside": theta.ravel()}


def ease_at_plate(problem: ReducedProblem) -> Array:
    """(n,) how much softer in torsion tubes made of pieces are at the plate than where they are held."""
    assert problem.assembly.lengthwise is not None
    here = problem.assembly.lengthwise.values(problem.assembly.transmission[None])[1][0]
    return np.asarray(problem.assembly.held_stiffness / here)

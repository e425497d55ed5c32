"""Discretised equations of a robot at its translations, with or without a load: sections, mesh, forces, weight."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ..block.transcription.loaded import LoadedProblem, Loading, load_problem
from ..block.transcription.mesh import element_counts, loaded_counts, loaded_mesh, make_mesh
from ..block.transcription.reduced import ReducedProblem, reduce
from ..block.transcription.tableau import FAMILIES
from ..constants import GRAVITY
from ..display import Displayed
from ..errors import InputError, choice, triple, warn_implausible, whole
from ..robots.assembly import Assembly, cut
from ..robots.limits import MOST_BEND
from ..robots.load import Load, Stretch, masses
from ..robots.robot import Robot
from ..solvers.compiled.loaded import ROUGH_DEGREE, LoadedRules


@dataclass(frozen=True)
class Discretisation(Displayed):
    """Collocation family, degree and mesh of the torsion problem."""

    family: str = "gauss"
    """Family of collocation points."""
    degree: int = 6
    """Degree of the collocation polynomials."""
    refinement: int = 0
    """Number of times that the default mesh is halved."""

    def __post_init__(self) -> None:
        choice("family", self.family, FAMILIES)
        whole("degree", self.degree, 1)
        whole("refinement", self.refinement)


DEFAULT_DISCRETISATION = Discretisation()

# Collocation of degree 6 gains 2^12 with each halving: six halvings reduce any error of the mesh to round-off. A larger
# error comes from unknowns that are not well determined (close to a fold), which finer elements do not improve.
REFINEMENTS = 6
"""Largest number of times that the elements of the mesh are halved."""

# Under load the elements are shorter from the start, and every point has two more unknowns.
LOADED_REFINEMENTS = 4
"""Largest number of times that the elements of the mesh are halved under a load."""

# With one point more per element than without a load the margin, too, is accurate to about 1e-8.
LOADED_DISCRETISATION = Discretisation(degree=7)
"""Default discretisation under a load."""


# A motion uses the problems of its equilibria a second time, for the speed of the tip.
CACHED_PROBLEMS = 128
"""Number of problems in a cache."""

EXTRA_COLLOCATION_POINTS = 1
"""Number of collocation points per element that the check of the mesh has more than the solution."""


@lru_cache(maxsize=CACHED_PROBLEMS)
def assembly_of(robot: Robot, translations: tuple[float, ...]) -> Assembly:
    """Assembly of a robot at translations (n,), m."""
    return robot.assembly(np.array(translations))


@lru_cache(maxsize=64)
def reduced_problem(robot: Robot, translations: tuple[float, ...], discretisation: Discretisation) -> ReducedProblem:
    """Reduced torsion problem of a robot at translations (n,), built once for all rotations."""
    return reduced_assembly(assembly_of(robot, translations), discretisation)


def reduced_assembly(assembly: Assembly, discretisation: Discretisation = DEFAULT_DISCRETISATION) -> ReducedProblem:
    """Reduced torsion problem of an assembly."""
    d = discretisation
    mesh = make_mesh(assembly, element_counts(assembly, d.refinement), family=d.family, degree=d.degree)
    return reduce(assembly, mesh)


def check_load(robot: Robot, load: Load, translations: tuple[float, ...]) -> None:
    """Raise InputError if a load cannot act on a robot.

    Such cases are an eccentric robot, a force beyond the tip, an arm of length 0, or a tube of unknown weight.
    """
    if not isinstance(load, Load):
        raise InputError(f"load is {load!r}; it must be a Load")
    _check(robot, load, translations)


# No tube withstands more, and the mesh would be too fine to solve.
MAX_BEND = 1000.0
"""Largest force times length^2 over bending stiffness."""

# Ten times that of the earth: more was probably meant in another unit.
USUAL_GRAVITY = 100.0
"""Largest gravity without a warning, m/s^2."""

# It bends a straight arm by a turn and a half.
USUAL_TURN = 10.0
"""Largest moment times length over bending stiffness without a warning, rad."""

# It bends a straight arm to a coil of five turns.
MAX_TURN = 30.0
"""Largest moment times length over bending stiffness, rad."""


def _check_size(robot: Robot, load: Load, length: float) -> None:
    """Raise InputError for forces and moments too large for these tubes; warn of unusually large values.

    They were probably meant in mN and mN m.
    """
    stiffness = sum(float(tube.bending_stiffness) for tube in robot.tubes)
    forces, moments = {"tip force": load.force}, {"tip moment": load.moment}
    for k, part in enumerate(load.points):
        forces[f"force of points[{k}]"], moments[f"moment of points[{k}]"] = part.force, part.moment
    along: Any = load.distributed if isinstance(load.distributed, tuple) else ()
    stretches = along if not along or isinstance(along[0], Stretch) else (Stretch(0.0, length, along),)
    for k, stretch in enumerate(stretches):
        over = min(stretch.end, length) - stretch.start
        forces[f"force of distributed[{k}]"] = triple("force", np.multiply(over, stretch.force))
    for parts, unit, scale, usual, largest in (
        (forces, "N", stiffness / length**2, MOST_BEND, MAX_BEND),
        (moments, "N m", stiffness / length, USUAL_TURN, MAX_TURN),
    ):
        for name, vector in parts.items():
            size = max(map(abs, vector))
            subject = f"{name} of the load has {size:g} {unit}; on this arm it"
            if size > largest * scale:
                raise InputError(f"{subject} must be at most {largest * scale:.3g} {unit}: was {size:g} m{unit} meant?")
            if size > usual * scale:
                warn_implausible(
                    f"{subject} is usually at most {usual * scale:.3g} {unit}: was {size:g} m{unit} meant?"
                )
    gravity = float(np.linalg.norm(load.gravity or 0.0))
    if gravity > USUAL_GRAVITY:
        warn_implausible(
            f"gravity is {gravity:.4g} m/s^2, {gravity / GRAVITY:.3g} times that of the earth: "
            f"was {gravity:.4g} mm/s^2 meant?"
        )


def _check_points(load: Load, length: float) -> None:
    """Raise InputError for points and stretches beyond the end of the arm.

    A stretch that starts on the arm and ends beyond acts up to the end of the arm, with a warning.
    """
    arm = f"the length of the arm, {length:g} m ({length * 1e3:.6g} mm)"
    for k, part in enumerate(load.points):
        if part.at > length * (1 + 1e-12):
            raise InputError(
                f"points[{k}] of the load is at {part.at:g} m ({part.at * 1e3:.6g} mm); it must be at most {arm}"
            )
    stretches = load.distributed if isinstance(load.distributed, tuple) else ()
    for k, stretch in enumerate(stretches):
        if not isinstance(stretch, Stretch):
            return
        start, end = (f"{s:g} m ({s * 1e3:.6g} mm)" for s in (stretch.start, stretch.end))
        if stretch.start >= length * (1 - 1e-12):
            raise InputError(
                f"distributed[{k}] of the load begins at {start}; it must begin before the end of the arm, at "
                f"{length:g} m ({length * 1e3:.6g} mm)"
            )
        if stretch.end > length * (1 + 1e-9):
            warn_implausible(
                f"distributed[{k}] of the load ends at {end}, beyond the end of the arm; it is cut at {arm}"
            )


@lru_cache(maxsize=CACHED_PROBLEMS)
def _check(robot: Robot, load: Load, translations: tuple[float, ...]) -> None:
    """Check a load as `check_load` does, once for each robot, load and translations."""
    if robot.fixed_sections:
        assembly = assembly_of(robot, translations)
        if assembly.eccentric:
            raise InputError("model of the robot is thesis, a balance of moments without loads; take the model energy")
        length = assembly.total_length
    else:
        length = max(d + tube.curved_length for d, tube in zip(translations, robot.tubes, strict=True))
    if not length:
        raise InputError("no tube is in front of the base plate, so no load can act on the arm")
    _check_size(robot, load, length)
    _check_points(load, length)
    masses(robot.tubes, load)


@lru_cache(maxsize=CACHED_PROBLEMS)
def loaded_problem(
    robot: Robot,
    translations: tuple[float, ...],
    load: Load,
    discretisation: Discretisation = LOADED_DISCRETISATION,
    elements: tuple[int, ...] | None = None,
) -> LoadedProblem:
    """Problem of a robot at translations (n,) under a load, built once for all rotations.

    Args:
        elements: number of elements of each section; by default as many as the load needs.
    """
    return _problem(robot, translations, load, discretisation, elements)


def _problem(
    robot: Robot,
    translations: tuple[float, ...],
    load: Load,
    discretisation: Discretisation,
    elements: tuple[int, ...] | None = None,
) -> LoadedProblem:
    """Problem of a loaded robot, built for the cache of `loaded_problem`."""
    _, loading = loading_of(robot, translations, load)
    counts = tuple((loading.counts * 2**discretisation.refinement).tolist()) if elements is None else elements
    torsion = _torsion(robot, translations, tuple(load.cuts().tolist()), counts, discretisation)
    return load_problem(torsion, load, loading.density)


@lru_cache(maxsize=CACHED_PROBLEMS)
def loading_of(robot: Robot, translations: tuple[float, ...], load: Load) -> tuple[Assembly, Loading]:
    """Assembly at translations (n,), cut where the load jumps, and the load on its sections."""
    density = masses(robot.tubes, load)
    assembly = _cut(robot, translations, tuple(load.cuts().tolist()))
    mass = float((assembly.present @ density) @ assembly.length) if load.gravity else 0.0
    counts = loaded_counts(assembly, *load.bounds(assembly.total_length, mass))
    return assembly, Loading(load, density, counts)


@lru_cache(maxsize=CACHED_PROBLEMS)
def loaded_rules(robot: Robot, translations: tuple[float, ...], load: Load, refinement: int = 0) -> LoadedRules:
    """Problem of a robot under a load on the three quadrature rules of the compiled kernel."""
    family, degree = LOADED_DISCRETISATION.family, LOADED_DISCRETISATION.degree
    problem = loaded_problem(robot, translations, load, Discretisation(family, degree, refinement))
    # Only the kernel uses the two other rules: they are not cached on their own.
    rough_and_fine = (Discretisation(family, k, refinement) for k in (ROUGH_DEGREE, degree + EXTRA_COLLOCATION_POINTS))
    return LoadedRules(problem, *(_problem(robot, translations, load, d) for d in rough_and_fine))


@lru_cache(maxsize=CACHED_PROBLEMS)
def _cut(robot: Robot, translations: tuple[float, ...], cuts: tuple[float, ...]) -> Assembly:
    assembly = assembly_of(robot, translations)
    return cut(assembly, np.array(cuts)) if cuts else assembly


@lru_cache(maxsize=CACHED_PROBLEMS)
def _torsion(
    robot: Robot, translations: tuple[float, ...], cuts: tuple[float, ...], counts: tuple[int, ...], d: Discretisation
) -> ReducedProblem:
    """Torsion problem on the mesh of a load; forces and moments do not enter it."""
    assembly = _cut(robot, translations, cuts)
    return reduce(assembly, loaded_mesh(assembly, np.array(counts), family=d.family, degree=d.degree))

"""The problem of a robot at translations, under a load or none: sections, mesh, forces and weight."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any

import numpy as np

from ..block.transcription.loaded import LoadedProblem, Loading, load_problem
from ..block.transcription.mesh import loaded_counts, loaded_mesh, make_mesh, piece_counts
from ..block.transcription.reduced import ReducedProblem, reduce
from ..block.transcription.tableau import FAMILIES
from ..constants import GRAVITY
from ..display import Displayed
from ..errors import InputError, choice, triple, warn_implausible, whole
from ..robots.assembly import Assembly, cut
from ..robots.limits import MOST_BEND
from ..robots.load import FORCE, MOMENT, Load, Stretch, masses
from ..robots.robot import Robot
from ..solvers.compiled.loaded import ROUGH_DEGREE, LoadedRules
from ..solvers.settings import NEWTON, Ipopt, Newton
from ..typing import Array


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

# Collocation of degree 6 gains 2^12 with each halving: six take any error that halving can lower to round-off. A larger
# error comes from unknowns that are not well determined (close to a fold), which finer pieces do not improve.
REFINEMENTS = 6
"""Largest number of times that the pieces of the mesh are halved."""

# Under load the pieces are shorter from the start, and every point has two more unknowns.
LOADED_REFINEMENTS = 4
"""The same under load."""

LOADED_DISCRETISATION = Discretisation(degree=7)
"""One point more per piece than without load: then the margin, too, is right to about 1e-8."""


KEPT = 128
"""Problems that are kept: a motion asks for those of its equilibria once more, for the speed of the tip."""

EXTRA_POINTS = 1
"""Collocation points by which the check of the mesh is finer than the solution."""


@lru_cache(maxsize=KEPT)
def assembly_of(robot: Robot, translations: tuple[float, ...]) -> Assembly:
    """The bundle of a robot at translations (n,), m."""
    return robot.assembly(np.array(translations))


@lru_cache(maxsize=64)
def reduced_problem(robot: Robot, translations: tuple[float, ...], discretisation: Discretisation) -> ReducedProblem:
    """The reduced torsion problem at given translations, built once for all rotations."""
    return reduced_assembly(assembly_of(robot, translations), discretisation)


def reduced_assembly(assembly: Assembly, discretisation: Discretisation = DEFAULT_DISCRETISATION) -> ReducedProblem:
    """The reduced torsion problem of tubes that are placed."""
    d = discretisation
    mesh = make_mesh(assembly, piece_counts(assembly, d.refinement), family=d.family, degree=d.degree)
    return reduce(assembly, mesh)


def check_load(robot: Robot, load: Load, translations: tuple[float, ...]) -> None:
    """Raise InputError where a robot cannot bear a load: tubes beside one another, a force beyond the tip, an arm that
    does not exist, a tube of unknown weight."""
    if not isinstance(load, Load):
        raise InputError(f"load is {load!r}; it must be a Load")
    _check(robot, load, translations)


LARGEST_BEND = 1000.0
"""The same for a force that is refused: no tube bears it, and a mesh that would is too fine to solve."""

MOST_GRAVITY = 100.0
"""m/s^2, ten times that of the earth: beyond, it was probably meant in another unit."""

MOST_TURN = 10.0
"""Moment times length over bending stiffness, rad: beyond, it bends a straight arm by more than a turn and a half."""

LARGEST_TURN = 30.0
"""Moment times length over bending stiffness, rad: beyond, an arm is bent to a coil of five turns."""


def _check_size(robot: Robot, load: Load, length: float) -> None:
    """Refuse forces and moments that no arm of these tubes bears, and warn of forces that none is made for: they were
    probably meant in mN and mN m."""
    stiffness = sum(float(tube.bending_stiffness) for tube in robot.tubes)
    forces, moments = {"tip force": load.force}, {"tip moment": load.moment}
    for k, part in enumerate(load.points):
        forces[f"force of points[{k}]"], moments[f"moment of points[{k}]"] = part.force, part.moment
    along: Any = load.distributed if isinstance(load.distributed, tuple) else ()
    stretches = along if not along or isinstance(along[0], Stretch) else (Stretch(0.0, length, along),)
    for k, stretch in enumerate(stretches):
        over = min(stretch.end, length) - stretch.start
        forces[f"force of distributed[{k}]"] = triple("force", np.multiply(over, stretch.force))
    for parts, unit, scale, most, largest in (
        (forces, "N", stiffness / length**2, MOST_BEND, LARGEST_BEND),
        (moments, "N m", stiffness / length, MOST_TURN, LARGEST_TURN),
    ):
        for name, vector in parts.items():
            size = max(map(abs, vector))
            words = f"{name} of the load has {size:g} {unit}; on this arm it"
            if size > largest * scale:
                raise InputError(f"{words} must be at most {largest * scale:.3g} {unit}: was {size:g} m{unit} meant?")
            if size > most * scale:
                warn_implausible(f"{words} is usually at most {most * scale:.3g} {unit}: was {size:g} m{unit} meant?")
    pull = float(np.linalg.norm(load.gravity or 0.0))
    if pull > MOST_GRAVITY:
        warn_implausible(
            f"gravity is {pull:.4g} m/s^2, {pull / GRAVITY:.3g} times that of the earth: was {pull:.4g} mm/s^2 meant?"
        )


def _check_places(load: Load, length: float) -> None:
    """Refuse points and stretches that lie beyond the end of the arm, where there is nothing that they could act on;
    warn of stretches that begin on it and end beyond: they act as far as the arm goes."""
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
        begin, end = (f"{s:g} m ({s * 1e3:.6g} mm)" for s in (stretch.start, stretch.end))
        if stretch.start >= length * (1 - 1e-12):
            raise InputError(
                f"distributed[{k}] of the load begins at {begin}; it must begin before the end of the arm, at "
                f"{length:g} m ({length * 1e3:.6g} mm)"
            )
        if stretch.end > length * (1 + 1e-9):
            warn_implausible(
                f"distributed[{k}] of the load ends at {end}, beyond the end of the arm; it is cut at {arm}"
            )


@lru_cache(maxsize=KEPT)
def _check(robot: Robot, load: Load, translations: tuple[float, ...]) -> None:
    assembly = assembly_of(robot, translations)
    if assembly.eccentric:
        raise InputError("this robot is eccentric; only concentric robots can be loaded")
    length = assembly.total_length
    if not length:
        raise InputError("no tube is in front of the base plate, so no load can act on the arm")
    _check_size(robot, load, length)
    _check_places(load, length)
    masses(robot.tubes, load)


@lru_cache(maxsize=KEPT)
def loaded_problem(
    robot: Robot,
    translations: tuple[float, ...],
    load: Load,
    discretisation: Discretisation = LOADED_DISCRETISATION,
    pieces: tuple[int, ...] | None = None,
) -> LoadedProblem:
    """The problem of a robot at given translations under a load, built once for all rotations; `pieces` of each
    section, by default those that the load needs."""
    return _problem(robot, translations, load, discretisation, pieces)


def _problem(
    robot: Robot,
    translations: tuple[float, ...],
    load: Load,
    discretisation: Discretisation,
    pieces: tuple[int, ...] | None = None,
) -> LoadedProblem:
    """See `loaded_problem`."""
    _, loading = loading_of(robot, translations, load)
    counts = tuple((loading.counts * 2**discretisation.refinement).tolist()) if pieces is None else pieces
    torsion = _torsion(robot, translations, tuple(load.cuts().tolist()), counts, discretisation)
    return load_problem(torsion, load, loading.density)


@lru_cache(maxsize=KEPT)
def loading_of(robot: Robot, translations: tuple[float, ...], load: Load) -> tuple[Assembly, Loading]:
    """The tubes at given translations, in sections that end where the load jumps, and what the load is on them."""
    density = masses(robot.tubes, load)
    assembly = _cut(robot, translations, tuple(load.cuts().tolist()))
    return assembly, Loading(load, density, loaded_counts(assembly, *_bounds(assembly, load, density)))


@lru_cache(maxsize=KEPT)
def loaded_rules(robot: Robot, translations: tuple[float, ...], load: Load, refinement: int = 0) -> LoadedRules:
    """The problem of a robot under a load on the rules of the compiled kernel."""
    family, degree = LOADED_DISCRETISATION.family, LOADED_DISCRETISATION.degree
    problem = loaded_problem(robot, translations, load, Discretisation(family, degree, refinement))
    # What only the kernel asks for is not kept beside the rules.
    others = (Discretisation(family, k, refinement) for k in (ROUGH_DEGREE, degree + EXTRA_POINTS))
    return LoadedRules(problem, *(_problem(robot, translations, load, d) for d in others))


@lru_cache(maxsize=KEPT)
def _cut(robot: Robot, translations: tuple[float, ...], cuts: tuple[float, ...]) -> Assembly:
    assembly = assembly_of(robot, translations)
    return cut(assembly, np.array(cuts)) if cuts else assembly


@lru_cache(maxsize=KEPT)
def _torsion(
    robot: Robot, translations: tuple[float, ...], cuts: tuple[float, ...], counts: tuple[int, ...], d: Discretisation
) -> ReducedProblem:
    """The problem of the rotations, which the numbers of the load do not change."""
    assembly = _cut(robot, translations, cuts)
    return reduce(assembly, loaded_mesh(assembly, np.array(counts), family=d.family, degree=d.degree))


def _bounds(assembly: Assembly, load: Load, density: Array) -> tuple[float, float]:
    """Bounds of the force on any cross-section, N, and of the moment of what is not a force, N m."""
    along = turning = 0.0
    if load.distributed is not None:
        per_length = load.per_length(np.linspace(0, assembly.total_length, 33)[1:-1])
        along, turning = (float(np.linalg.norm(per_length[:, k], axis=-1).max(initial=0.0)) for k in (FORCE, MOMENT))
    weight = math.hypot(*load.gravity) * (assembly.present @ density) @ assembly.length if load.gravity else 0.0
    force = sum(math.hypot(*part.force) for part in load.acting) + weight + along * assembly.total_length
    moment = sum(math.hypot(*part.moment) for part in load.acting)
    return float(force), moment + turning * assembly.total_length


# --- Method -----------------------------------------------------------------------------------------------------------

METHODS = ("newton", "ipopt", "energy")

TOLERANCE = 1e-8
"""Wanted accuracy of theta(s), rad, and of the tip, as a fraction of the length of the arm."""


@dataclass(frozen=True)
class Method:
    """One of METHODS with the settings of its solver."""

    name: str
    newton: Newton = NEWTON
    ipopt: Ipopt | None = None


NAMED = {name: Method(name) for name in METHODS}


@dataclass(frozen=True)
class SolveRequest:
    """By which method, to which tolerance (see TOLERANCE), and since when (s)."""

    method: Method = NAMED["newton"]
    tolerance: float = TOLERANCE
    began: float = field(default_factory=time.perf_counter)

    def by_kernel(self, load: Load | None, discretisation: Discretisation) -> bool:
        """Whether a compiled kernel solves what is asked: by its own method, on its own points. Under a load the
        settings of Newton's method that hold there are the kernel's, too."""
        if load is not None:
            return self.method.name == "newton"
        return self.method is NAMED["newton"] and discretisation == DEFAULT_DISCRETISATION


def method_of(method: str | Newton | Ipopt, load: Load | None, discretisation: Discretisation) -> Method:
    """Behind a name or the settings of a solver; raises InputError where it is neither, or cannot solve under the
    load."""
    if isinstance(method, Newton):
        by = Method("newton", newton=method)
    elif isinstance(method, Ipopt):
        by = Method("ipopt", ipopt=method)
    else:
        by = NAMED[choice("method", method, METHODS)]
    if isinstance(load, Load):
        _must_bear(by, load, discretisation)
    return by


def _must_bear(by: Method, load: Load, discretisation: Discretisation) -> None:
    """Raise InputError for what there is not under a load."""
    if replace(by.newton, margin_tolerance=NEWTON.margin_tolerance) != NEWTON:
        raise InputError("method has settings other than margin_tolerance; only this one applies under load")
    if by.name != "newton" and not load.has_energy:
        raise InputError(
            f"method is {by.name!r}; under a moment or a follower force, which have no energy, it must be 'newton'"
        )
    if discretisation != DEFAULT_DISCRETISATION:
        raise InputError("discretisation is given; under load it is chosen automatically")

"""The collocated torsion problem solved by IPOPT, as equations or as the energy whose stationary points they are."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from ..errors import SolveError
from ..transcription.arm import Profile, rotations_at, torsion_at
from ..transcription.block import Structure, add_energy, add_equilibrium, parameter_values, parameters, structure_of
from ..transcription.nlp import Builder, Nlp
from ..transcription.reduced import ReducedProblem, evaluate, to_unknowns
from ..typing import Array
from .newton import NewtonResult
from .settings import Ipopt


@lru_cache(maxsize=64)
def _problem(structure: Structure, formulation: str, settings: Ipopt | None = None) -> tuple[Nlp, Any, Any]:
    """The program, its IPOPT solver, and the functions from a guess to x and from x to theta at the points."""
    builder = Builder()
    given = parameters(builder, structure)
    if formulation == "equations":
        rotation = add_equilibrium(builder, structure, given).rotation
    else:
        rotation = add_energy(builder, structure, given)
    nlp = builder.build()
    solver = nlp.ipopt(formulation, **(settings.options(warm=False) if settings else {}))
    read = ca.Function("read", [nlp.x, nlp.p], [ca.densify(rotation)])
    return nlp, solver, read


def solve_ipopt(
    problem: ReducedProblem,
    rotations: Array,
    guess: Profile,
    formulation: str = "equations",
    settings: Ipopt | None = None,
) -> NewtonResult:
    """Solve the collocated problem from the torsion `guess`.

    Args:
        formulation: "equations" (no objective, the equations as constraints) or "energy" (least elastic energy).
        settings: None are those of `transcription.nlp`.

    Raises:
        SolveError: IPOPT did not converge; the message names its verdict and the worst constraints.
    """
    structure = structure_of(problem)
    nlp, solver, read = _problem(structure, formulation, settings)
    p = parameter_values(problem, rotations)
    x = start_values(structure, problem, guess, formulation)
    result = solver(x0=x / nlp.scale, p=p, **nlp.bounds)
    stats = solver.stats()
    if not stats["success"]:
        worst = "; ".join(f"{name}: violated by {size:.1e}" for name, size in nlp.worst(result["g"].full().ravel()))
        verdict = stats["return_status"].replace("_", " ").lower()
        raise SolveError(f"IPOPT found no equilibrium ({verdict}): {worst or 'all constraints hold'}")
    theta = read(result["x"], p).full().T
    state = evaluate(problem, rotations, to_unknowns(problem, rotations, theta))
    return NewtonResult(state, True, int(stats["iter_count"]), 0.0)


def start_values(structure: Structure, problem: ReducedProblem, guess: Profile, formulation: str) -> Array:
    """The unknowns of the program, in its order, at a torsion profile on the same mesh."""
    nodes = tuple(problem.mesh.tableau.nodes.tolist())
    theta, slope = rotations_at(problem, guess, nodes), torsion_at(problem, guess, nodes)
    parts: list[Array] = []
    if formulation == "energy":
        parts.append(guess.twist[0] if len(guess.twist) else np.zeros(problem.assembly.n_tubes))
    for piece, collocated in enumerate(structure.collocated):
        if formulation == "equations":
            parts += [guess.rotation[piece], guess.twist[piece]]
            if collocated:
                parts.append(theta[piece].ravel())
            continue
        if collocated:
            parts += [theta[piece].ravel(), slope[piece].ravel()]
        else:
            parts.append(guess.twist[piece])
        if piece + 1 < structure.n_pieces:
            parts.append(guess.rotation[piece + 1])
    return np.concatenate([*parts, np.zeros(0)])

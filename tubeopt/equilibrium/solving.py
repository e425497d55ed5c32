"""Meshes of the torsion problem of a robot, and an equilibrium at their points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..block.transcription.collocated import ENDS, STEPS
from ..block.transcription.mesh import make_mesh, piece_counts
from ..block.transcription.reduced import ReducedProblem, pull_rate, reduce
from ..block.transcription.tableau import FAMILIES
from ..display import Displayed
from ..errors import choice, whole
from ..robots.assembly import ROUND_OFF, Assembly
from ..robots.robot import Robot, is_general
from ..typing import Array
from .result import Equilibrium


@dataclass(frozen=True)
class Discretisation(Displayed):
    """How the torsion problem is transcribed."""

    family: str = "gauss"
    """Of collocation."""
    degree: int = 6
    """Of its polynomials."""
    refinement: int = 0
    """How often the default pieces of the mesh are halved."""

    def __post_init__(self) -> None:
        choice("family", self.family, FAMILIES)
        whole("degree", self.degree, 1)
        whole("refinement", self.refinement)


DEFAULT_DISCRETISATION = Discretisation()


@lru_cache(maxsize=64)
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
    pieces = piece_counts(assembly, d.refinement)
    return reduce(assembly, make_mesh(assembly, pieces, family=d.family, degree=d.degree))


def discretisation_of(equilibrium: Equilibrium) -> Discretisation:
    """The discretisation on which an equilibrium was solved."""
    how = equilibrium.statistics
    return Discretisation(how.family, how.degree, how.refinement)


def sample_rotation(equilibrium: Equilibrium, arc_length: Array) -> Array:
    """theta (len(arc_length), n) of an equilibrium: as solved at its own collocation points, else cubic Hermite; phi
    where a tube is made of pieces."""
    own = equilibrium.point
    if len(own) == len(arc_length) and np.abs(own - arc_length).max(initial=0.0) <= ROUND_OFF:
        theta = equilibrium.point_rotation
        if is_general(equilibrium.robot):
            placed = assembly_of(equilibrium.robot, tuple(equilibrium.translations.tolist()))
            theta = theta - placed.wound(arc_length)
        return theta
    arm = np.stack([equilibrium.rotation.T, equilibrium.torsion.T])
    return sample_arms(equilibrium.robot, equilibrium.translations, equilibrium.arc_length, arm, arc_length)


def sample_arms(robot: Robot, translations: Array, s: Array, arms: Array, arc_length: Array) -> Array:
    """The same (..., len(arc_length), n) of arms (..., 2, m, n), rotation and torsion at arc lengths s (m,)."""
    rotation, torsion = arms[..., 0, :, :], arms[..., 1, :, :]
    phi = rotation - robot.assembly(translations).wound(s) if is_general(robot) else rotation
    if len(s) < 2:
        return np.repeat(phi, len(arc_length), axis=-2)
    if is_general(robot):
        # The polynomial through the shape points of each piece: its rate jumps between.
        piece = np.clip(np.searchsorted(s[::STEPS], arc_length, side="right") - 1, 0, len(s) // STEPS - 1)
        x = np.clip((arc_length - s[piece * STEPS]) / (s[(piece + 1) * STEPS] - s[piece * STEPS]), 0.0, 1.0)
        basis = np.vander(x, STEPS + 1) @ np.linalg.inv(np.vander(ENDS, STEPS + 1))
        around = phi[..., piece[:, None] * STEPS + np.arange(STEPS + 1), :]
        return np.asarray(np.einsum("ak,...aki->...ai", basis, around))
    k = np.clip(np.searchsorted(s, arc_length, side="right") - 1, 0, len(s) - 2)
    h = (s[k + 1] - s[k])[:, None]
    x = np.clip((arc_length - s[k]) / h[:, 0], 0.0, 1.0)[:, None]
    value = rotation[..., k, :] * ((1 + 2 * x) * (1 - x) ** 2) + rotation[..., k + 1, :] * (x**2 * (3 - 2 * x))
    value += h * (torsion[..., k, :] * (x * (1 - x) ** 2) - torsion[..., k + 1, :] * (x**2 * (1 - x)))
    return np.asarray(value)


@lru_cache(maxsize=16)
def lever(problem: ReducedProblem) -> float:
    """By how much a tip can move with a wrong theta, m per rad: |dp| <= int |du / dtheta| |dtheta| (L - s) ds.

    The curvature u itself can vanish where tubes oppose each other, its change with theta does not: sum |m_i| / sum
    kb_i bounds it.
    """
    mesh = problem.mesh
    if not len(mesh.length):
        return 0.0
    ahead = mesh.start[-1] + mesh.length[-1] - mesh.start - mesh.length / 2
    return float((pull_rate(problem) * mesh.length) @ ahead)

"""What shows that no design can meet a task: bounds that hold for all designs in the ranges of the free dimensions.

A search that ends without a design shows nothing. These do:

- limits on dimensions that are linear in what is free, as lengths, walls and clearances: a linear program finds whether
  one design keeps all of them;
- the strain of a tube that is held straight, which grows with its curvature and its diameter;
- a target farther from the plate than the longest tube may get: no tube begins beyond the plate;
- the certificate where only curvatures are free: its coupling |c_ij| grows with the size of every curvature, the
  torsional part of the second variation has none of them, so that it is largest at the least curvatures.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import casadi as ca
import numpy as np
import scipy

from ..errors import undoubted
from ..physics.strain import surface_strain
from ..stability import snap_free_certificate
from ..typing import Array
from .constraints import Limit
from .parameters import TUBE_FIELDS, WHOLE
from .program import Program, points_of
from .requirements import Coverage, Reach, SnapFree, Strain, of_kind
from .task import extreme_lengths

SURELY = 1e-6
"""Steps of a limit, or part of a margin, by which a bound must miss it: far more than round-off."""


def shown_infeasible(program: Program) -> str:
    """Why no design in the ranges of a task meets it, in words; "" where nothing of this kind shows it."""
    kinds = (_dimensions, _targets) if program.task.space.pieced else (_dimensions, _strains, _targets, _certificates)
    for kind in kinds:
        for words in kind(program):
            return words
    return ""


def _dimensions(program: Program) -> Iterator[str]:
    """Least violation t, in steps, of all rows a x + b + t >= 0 that are linear in the dimensions x."""
    space = program.layout.space
    rows: list[tuple[Limit, Array, float]] = []
    for statement in (each for stated in program.stated for each in stated):
        found = statement.expression
        fields = WHOLE if space.pieced else TUBE_FIELDS
        if not all(one.pose is None and one.name in fields for one in found.quantities):
            continue
        y = ca.SX.sym("y", found.value.size1_in(0))
        slope = ca.jacobian(found.value(y), y)
        if ca.depends_on(slope, y):
            continue
        maps = [_linear(program, one.name) for one in found.quantities]
        matrix, offset = (np.concatenate([each[k] for each in maps]) for k in (0, 1))
        slopes = np.array(ca.DM(slope)) @ matrix
        values = np.array(found.value(offset)).ravel()
        rows += [
            (statement.limit, slopes[k] / statement.limit.size, values[k] / statement.limit.size)
            for k in range(len(values))
        ]
    if not rows:
        return
    size = len(space.lower)
    missed = scipy.optimize.linprog(
        np.append(np.zeros(size), 1.0),
        A_ub=-np.column_stack([np.array([slope for _, slope, _ in rows]), np.ones(len(rows))]),
        b_ub=np.array([value for *_, value in rows]),
        bounds=[*zip(space.lower, space.upper, strict=True), (0.0, None)],
    )
    if missed.status == 0 and missed.fun > SURELY:
        against = np.flatnonzero(missed.ineqlin.marginals < -1e-9)
        names = dict.fromkeys(f"{rows[k][0].words} {_at(rows[k][0])}" for k in against)
        yield f"the ranges of the dimensions exclude {' with '.join(names)}"


def _at(limit: Limit) -> str:
    return f"of at {'most' if limit.most else 'least'} {limit.shown()}"


def _linear(program: Program, name: str) -> tuple[Array, Array]:
    """Matrix (n, D) and offset (n,) by which a dimension of the tubes follows from x."""
    space = program.layout.space
    offset = np.array([getattr(tube, name) for tube in space.robot_tubes], dtype=float)
    matrix = np.zeros((len(offset), len(space.unknowns)))
    for k, one in enumerate(space.unknowns):
        for i in one.tubes if one.field == name else ():
            matrix[i, k] = offset[i] if one.scaled else 1.0
            offset[i] = 0.0
    return matrix, offset


def _least(program: Program, field: str) -> Array:
    """(n,) the least size of a dimension of the tubes that their ranges have, with its sign."""
    space = program.layout.space
    found = np.array([getattr(tube, field) for tube in space.robot_tubes], dtype=float)
    for one, *bounds in zip(space.unknowns, space.lower, space.upper, strict=True):
        for i in one.tubes if one.field == field else ():
            low, high = sorted(float(bound) * (found[i] if one.scaled else 1.0) for bound in bounds)
            found[i] = min(max(0.0, low), high)
    return found


def _strains(program: Program) -> Iterator[str]:
    for one in of_kind(program.task.requirements, Strain):
        curvature, outer = (_least(program, field).tolist() for field in ("curvature", "outer_diameter"))
        for i, (bend, diameter, most) in enumerate(zip(map(abs, curvature), outer, one.limits, strict=True)):
            if not one.straightened or bend * diameter >= 2:
                continue
            least = surface_strain(diameter / 2, bend, bend)
            if least > most * (1 + SURELY):
                yield (
                    f"tube {i + 1} held straight is strained by at least {100 * least:.4g} %, and {100 * most:.4g} % "
                    "is allowed"
                )


def _targets(program: Program) -> Iterator[str]:
    task = program.task
    most = extreme_lengths(task, "upper")
    longest = float((most["straight_length"] + most["curved_length"]).max())
    for one, points in zip(task.requirements, points_of(task.requirements, program.added), strict=True):
        tolerances = [target.tolerance for target in one.targets] if isinstance(one, Reach) else [
            one.tolerance if isinstance(one, Coverage) else 0.0] * len(points)  # fmt: skip
        for k, (point, tolerance) in enumerate(zip(points, tolerances, strict=True)):
            far = float(np.linalg.norm(point))
            if far - tolerance > longest + SURELY * longest:
                what = f"target {k + 1}" if isinstance(one, Reach) else "a corner of the workspace box"
                yield (
                    f"{what} is {far * 1e3:.4g} mm from the plate, and no tube gets longer than {longest * 1e3:.4g} mm"
                )


def _certificates(program: Program) -> Iterator[str]:
    space = program.layout.space
    if any(one.field != "curvature" for one in space.unknowns):
        return
    least = _least(program, "curvature").tolist()
    tubes = tuple(replace(tube, curvature=bend) for tube, bend in zip(space.robot_tubes, least, strict=True))
    with undoubted():
        robot = replace(program.task.robot, tubes=tubes)
    for one in of_kind(program.task.requirements, SnapFree):
        for row in program.layout.certified:
            most = snap_free_certificate(robot, np.array(row))
            if most < one.floor - max(SURELY, one.tolerance if one.box is not None else 0.0):
                yield (
                    f"the certified margin is at most {most:.4g} in the ranges of the curvatures, and {one.floor:.4g} "
                    "is demanded"
                )

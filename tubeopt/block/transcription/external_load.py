"""An arm in a program under a load: forces on its elements, and the equations of its bending moment.

Dead forces determine the force n on every cross-section. With the bending moment m in the Bishop frame, nu = R'n and
the torque t of all tubes (Rucker, Jones, Webster, IEEE T-RO 26 (2010)),

    u = (m + sum a_i) / sum kb_i,    m_x' = -u_y t + nu_y,    m_y' = u_x t - nu_x,    R m = M at the tip,

where the axial part of M acts on the tube that ends last. Poses where elements begin are unknowns, as without load.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import casadi as ca
import numpy as np

from ...physics.shape import rotation_matrix
from ...typing import Array
from .collocated import Grid
from .functions import FRAME
from .model import Equation, LayoutNumbers, Model, equation, location_labels, model_of


@dataclass(frozen=True, eq=False)
class BlockLoad:
    """A load on a block, in world axes unless it follows the tip."""

    force: Any
    """Force (3,) at the tip, N."""
    moment: Any
    """Moment (3,) at the tip, N m."""
    following: bool
    """True if force and moment at the tip turn with it."""
    per_length: Array
    """Force (3,) per length of the arm, N/m."""
    weight: Array
    """Weight (n, 3) per length of each tube, N/m."""
    tip_tube: int
    """Tube that ends last; the axial moment acts on it."""
    stiffness: float
    """Typical bending stiffness, N m^2, which scales the moments."""


@dataclass(frozen=True, eq=False)
class LoadedModel(Model):
    """An arm under load."""

    moment_start: Any
    """Bending moment (2, P) where elements begin, N m."""
    moment_inside: Any
    """Bending moment (2 K, P) at their points, N m."""
    force: Any
    """Force (3 K, P) at the points, N, each in the frame where its element begins."""
    tip_moment: Any
    """Moment (3,) at the tip in its own frame, N m."""
    on_tip_tube: Any
    """(n,) 1 for the tube that carries the axial moment at the tip, else 0."""
    bending_stiffness: float = 1.0
    """Typical bending stiffness, N m^2, which scales the moments."""

    @property
    def data(self) -> list[Any]:
        """Constants of all elements side by side, then their moments and forces."""
        return [*super().data, self.moment_start, self.moment_inside, self.force]

    def softness(self, margin: Any) -> tuple[Any, ...]:
        """Coefficients of the equations of the Jacobi fields at all points, rates (2 N, 2 N K P)."""
        inputs = [ca.repmat(part, 1, self.n_elements) for part in (margin, self.bending_stiffness)]
        return (self.mapped("rates")(*inputs, *self.arguments),)

    @property
    def plate_compliance(self) -> Any:
        """Ratio (N,) of a Jacobi field to its rate at the plate, where the frame is fixed."""
        return ca.vertcat(self.transmission, ca.DM.zeros(FRAME))

    def equations(self, rotations: Any, reach: float) -> list[Equation]:
        """Equations of torsion, shape and bending moment, with `reach` as typical length, m."""
        defect, end = self.mapped("bending")(*self.arguments)
        typical, tubes = self.bending_stiffness / reach, range(self.theta.shape[0])
        after, points = location_labels(self.n_elements, self.grid.degree)
        continuity = self.moment_start[:, 1:] - end[:, :-1]
        tip = self.ends.twist[:, -1] - self.on_tip_tube * self.tip_moment[2] / self.torsional_stiffness[:, -1]
        added = [
            equation("torsion at the end", [f"tube {i + 1}" for i in tubes], None, tip, 1 / reach),
            equation("moment equation", ["x", "y"], points, defect, typical),
            equation("continuity of bending moment", ["x", "y"], after, continuity, typical),
            equation("bending moment at the end", ["x", "y"], None, end[:, -1] - self.tip_moment[:2], typical),
        ]
        # The torque at the tip replaces the condition w = 0.
        return [each for each in super().equations(rotations, reach) if each.name != added[0].name] + added


def arm_of(grid: Grid, numbers: LayoutNumbers, unknowns: tuple[Any, ...], inputs: Mapping[str, Any]) -> Model:
    """Model of an arm, as `model_of`, under the load that is in `inputs`, if any."""
    model, load = model_of(grid, numbers, unknowns, inputs), inputs.get("load")
    if load is None:
        return model
    degree, elements = grid.degree, model.n_elements
    on_tip_tube = np.zeros(grid.n_tubes)
    on_tip_tube[load.tip_tube] = 1.0
    arm = LoadedModel(
        **{field.name: getattr(model, field.name) for field in fields(model)},
        moment_start=unknowns[5],
        moment_inside=unknowns[6],
        force=ca.DM.zeros(3 * degree, elements),
        tip_moment=ca.vertcat(0, 0, 0),
        on_tip_tube=ca.DM(on_tip_tube),
        bending_stiffness=load.stiffness,
    )
    # The pose at the tip depends on the moments, which are unknowns, but not on the forces, so these follow from it.
    tip = rotation_matrix(arm.pose_ends[0][:, -1])
    tip_moment = load.moment if load.following else tip.T @ load.moment
    tip_force = tip @ load.force if load.following else load.force
    per_length = ca.repmat(ca.DM(load.per_length), 1, elements) + ca.DM(load.weight.T) @ model.present
    on_element = per_length * ca.repmat(ca.reshape(model.lengths, 1, elements), 3, 1)
    beyond = ca.repmat(ca.sum2(on_element), 1, elements) - ca.cumsum(on_element, 1)
    columns = []
    for k in range(elements):
        to_element = rotation_matrix(arm.poses[0][:, k]).T
        ahead = tip_force + beyond[:, k]
        columns.append(
            ca.vertcat(*(to_element @ (ahead + (1 - x) * on_element[:, k]) for x in grid.tableau.nodes.tolist()))
        )
    return replace(arm, force=ca.horzcat(*columns), tip_moment=tip_moment)

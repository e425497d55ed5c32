"""An arm in a program that bears a load: what its pieces feel, and the equations of its bending moment.

Dead forces fix the force n on every cross-section in advance. With the bending moment m in the Bishop frame, nu = R'n
and the torque t of all tubes (Rucker, Jones, Webster, IEEE T-RO 26 (2010)),

    u = (m + sum a_i) / sum kb_i,    m_x' = -u_y t + nu_y,    m_y' = u_x t - nu_x,    R m = M at the tip,

where the part of M along the tip acts on the tube that ends last. Quaternions begin every piece, as without load.
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
from .model import Equation, Model, equation, model_of, places_in_words


@dataclass(frozen=True, eq=False)
class Push:
    """A load, SI: force and moment (3,) at the tip, in world axes or `turning` with the tip; force per length (3,), and
    per length of each tube (n, 3), in world axes; the tube that ends last; a typical bending stiffness, N m^2."""

    force: Any
    moment: Any
    turning: bool
    along: Array
    weight: Array
    tip_tube: int
    typical: float


@dataclass(frozen=True, eq=False)
class LoadedModel(Model):
    """An arm under load.

    bend (2, P), bent (2 K, P): bending moment where pieces begin and at their points, N m.  push: (3 K, P) force at the
    points, N, each in the frame where its piece begins.  wrench: (3,) bending moment and torque at the tip, in its own
    frame.  torque: (n,) which tube feels that torque.
    """

    bend: Any
    bent: Any
    push: Any
    wrench: Any
    torque: Any
    typical: float = 1.0

    @property
    def data(self) -> list[Any]:
        """What is given of the pieces to their functions, side by side."""
        return [*super().data, self.bend, self.bent, self.push]

    def softness(self, margin: Any) -> tuple[Any, ...]:
        """What the Jacobi fields need: (2 N, 2 N K P) rates at all points."""
        inputs = [ca.repmat(part, 1, self.n_pieces) for part in (margin, self.typical)]
        return (self.mapped("rates")(*inputs, *self.arguments),)

    @property
    def held_at_the_plate(self) -> Any:
        """(N,) by how much of its rate a Jacobi field is away from 0 at the plate: the frame is held there."""
        return ca.vertcat(self.transmission, ca.DM.zeros(FRAME))

    def equations(self, rotations: Any, reach: float) -> list[Equation]:
        """Those of torsion and shape, and of the bending moment."""
        defect, end = self.mapped("bending")(*self.arguments)
        typical, tubes = self.typical / reach, range(self.theta.shape[0])
        after, points = places_in_words(self.n_pieces, self.grid.degree)
        tip = self.ends[2][:, -1] - self.torque * self.wrench[2] / self.torsional_stiffness[:, -1]
        own = [
            equation("torsion at the end", [f"tube {i + 1}" for i in tubes], None, tip, 1 / reach),
            equation("moment equation", ["x", "y"], points, defect, typical),
            equation("continuity of bending moment", ["x", "y"], after, self.bend[:, 1:] - end[:, :-1], typical),
            equation("bending moment at the end", ["x", "y"], None, end[:, -1] - self.wrench[:2], typical),
        ]
        free = own[0].name
        return [each for each in super().equations(rotations, reach) if each.name != free] + own


def arm_of(grid: Grid, numbers: tuple[Any, ...], unknowns: tuple[Any, ...], inputs: Mapping[str, Any]) -> Model:
    """`model_of`, with the load that is `inputs` as "push", if any."""
    model, push = model_of(grid, numbers, unknowns, inputs), inputs.get("push")
    return model if push is None else _under(model, unknowns[5:], push)


def _under(model: Model, unknowns: tuple[Any, ...], push: Push) -> LoadedModel:
    """The same arm under a load."""
    degree, pieces = model.grid.degree, model.n_pieces
    inputs = {field.name: getattr(model, field.name) for field in fields(model)}
    bend, bent = unknowns
    torque = np.zeros(model.theta.shape[0])
    torque[push.tip_tube] = 1.0
    nothing = ca.DM.zeros(3 * degree, pieces), ca.vertcat(0, 0, 0)
    arm = LoadedModel(
        **inputs, bend=bend, bent=bent, push=nothing[0], wrench=nothing[1], torque=ca.DM(torque), typical=push.typical
    )
    # Where the tip points does not ask for the forces, but for the moments that they make.
    tip, force, moment = rotation_matrix(arm.pose_ends[0][:, -1]), push.force, push.moment
    wrench = moment if push.turning else tip.T @ moment
    force = tip @ force if push.turning else force
    per_length = ca.repmat(ca.DM(push.along), 1, pieces) + ca.DM(push.weight.T) @ model.present
    whole = per_length * ca.repmat(ca.reshape(model.lengths, 1, pieces), 3, 1)
    ahead = ca.repmat(ca.sum2(whole), 1, pieces) - ca.cumsum(whole, 1)
    columns = []
    for k in range(pieces):
        back = rotation_matrix(arm.poses[0][:, k]).T
        rest = (force + ahead[:, k], whole[:, k])
        felt = [back @ (rest[0] + (1 - x) * rest[1]) for x in model.grid.tableau.nodes.tolist()]
        columns.append(ca.vertcat(*felt))
    return replace(arm, push=ca.horzcat(*columns), wrench=wrench)

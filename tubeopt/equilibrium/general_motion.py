"""How an equilibrium of tubes made of pieces moves with its joints: what `Derivatives` tells of the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import groupby
from operator import itemgetter

import numpy as np

from ..block.transcription.collocated import STEPS
from ..block.transcription.linear import cumulate
from ..robots.breakpoints import coincides
from ..robots.robot import resized
from ..typing import Array
from .answer import point_of
from .arm_change import check_wrt
from .general_derivatives import Answer, Change, Linearised, together
from .kinematics import forward_kinematics
from .result import Equilibrium
from .solving import discretisation_of

NUDGE = 1e-7
"""Motion (m) by which it is seen what lies to a side."""


def nudged(equilibrium: Equilibrium, name: str, tube: int, side: int) -> Linearised:
    """The equilibrium with a tube moved or stretched a little: where breakpoints coincide its derivatives stand for
    those to that side, and are off by about the motion times the second ones. A tube that is wholly advanced moves back
    only."""
    robot, shift = equilibrium.robot, equilibrium.translations.copy()
    if name == "translations":
        advanced = shift[tube] + NUDGE > robot.tubes[tube].straight_length
        shift[tube] += -NUDGE if advanced else side * NUDGE
    else:
        robot = resized(robot, tube, name, robot.tubes[tube].curved_length + side * NUDGE)
    moved = forward_kinematics(robot, equilibrium.rotations, shift, guess=equilibrium, tolerance=1e-6)
    return Linearised(point_of(moved, discretisation=discretisation_of(equilibrium)), moved)


class GeneralMotion:
    """Derivatives by what `wrt` names of the n tubes, n columns each, as those of `Derivatives`; behind them those by
    what `more` says that changes.

    Raises:
        InputError: a name that is not among PARAMETERS, or a side that is neither 1 nor -1.
    """

    def __init__(
        self,
        equilibrium: Equilibrium,
        wrt: Sequence[str] = ("rotations", "translations"),
        side: int = 1,
        more: Callable[[Linearised], Sequence[Change]] | None = None,
    ) -> None:
        check_wrt(wrt, side)
        self.equilibrium, self.wrt, self.side, self._more = equilibrium, tuple(wrt), side, more
        self.here = Linearised(point_of(equilibrium, discretisation=discretisation_of(equilibrium)), equilibrium)
        self.arm, self.cuts = equilibrium.arm, equilibrium.arc_length[::STEPS]

    @cached_property
    def changes(self) -> list[tuple[Linearised, Change]]:
        """What every parameter changes, and of which equilibrium, to the side where breakpoints coincide; then the same
        of what else changes."""
        out = []
        for name in self.wrt:
            for tube in range(self.here.n):
                moves = name in ("translations", "curved_length")
                aside = moves and coincides(self.here.problem.assembly, tube)
                at = nudged(self.equilibrium, name, tube, self.side) if aside else self.here
                out.append((at, at.change(name, tube)))
        own = () if self._more is None else self._more(self.here)
        return [*out, *((self.here, change) for change in own)]

    @cached_property
    def answers(self) -> list[tuple[Linearised, Change, Answer]]:
        """The same with what each does along the arm."""
        out: list[tuple[Linearised, Change, Answer]] = []
        for at, run in groupby(self.changes, key=itemgetter(0)):
            changes = [change for _, change in run]
            whole = at.answer(together(changes))
            out += [(at, change, whole.only(k)) for k, change in enumerate(changes)]
        return out

    @cached_property
    def _columns(self) -> Array:
        """(8 + n, Q)."""
        runs = groupby(self.changes, key=itemgetter(0))
        return np.concatenate([at.columns([change for _, change in run]) for at, run in runs]).T

    @property
    def tip_position(self) -> Array:
        """(3, Q) of the tip, m."""
        return self._columns[:3]

    @property
    def tip_rotation(self) -> Array:
        """(3, Q) turn vector of the tip frame in the plate frame, rad."""
        return self._columns[3:6]

    @property
    def tip_rotations(self) -> Array:
        """(n, Q) of theta at each tube's own end."""
        return self._columns[6 : 6 + self.here.n]

    @property
    def margin(self) -> Array:
        """(Q,) of the margin; NaN where it is a double eigenvalue."""
        return np.asarray(self._columns[6 + self.here.n])

    @property
    def energy(self) -> Array:
        """(Q,) of the elastic energy, J."""
        return np.asarray(self._columns[7 + self.here.n])

    @property
    def pushed(self) -> Array:
        """(3, Q) motion of the tip with the tubes that push it out, or that alone hold it there."""
        return np.outer(self.arm.frame[-1][:, 2], self.shape[2][-1])

    def per_tube(self, columns: Array) -> Array:
        """Every tube has a carriage of its own."""
        return columns

    @cached_property
    def position(self) -> Array:
        """(m, 3, Q) of the shape points at fixed arc lengths; the last one is the tip, which moves along."""
        moved, _, ahead = self.shape
        ahead = np.concatenate([ahead[:-1], np.zeros_like(ahead[-1:])])
        return np.asarray(moved - self.arm.frame[:, :, 2, None] * ahead[:, None])

    @cached_property
    def shape(self) -> tuple[Array, Array, Array]:
        """(m, 3, Q) of the shape points, and of the frames there (turn vector), with the arc lengths (m, Q) at which
        they are: with their pieces of the mesh, or fixed where a joint cuts these anew, but for the tip."""
        parts = zip(*(self._moved(*one) for one in self.answers), strict=True)
        position, turn, ahead = (np.stack(part, axis=-1) for part in parts)
        return position, turn, ahead[:, 0]

    def _moved(self, at: Linearised, change: Change, answer: Answer) -> tuple[Array, Array, Array]:
        """(m, 3) of the shape points with one joint, the turn vectors, and (m, 1) of their arc lengths."""
        turn, length = answer.turn[0], np.repeat(change.length[0][:, None, None], at.t.degree, axis=1)
        turned, ahead = (cumulate(at.t, part) for part in (turn, length))
        shifted = at.frame[..., 2] * length - np.cross(turn, at.position)
        out = np.cross(turned, at.arm.position) + cumulate(at.t, shifted)
        if at is self.here:
            return np.asarray(out), turned, ahead
        bend = (at.arm.frame[..., :2] @ at.arm.curvature[..., None])[..., 0]
        own, s = self.equilibrium.arc_length, at.arm.arc_length[:-1]
        rows = []
        for part, rate in ((out, at.arm.frame[..., 2]), (turned, bend)):
            fixed = part - rate * ahead
            columns = (np.interp(own, s, column[:-1]) if len(s) else 0 * own for column in fixed.T)
            found = np.column_stack([*columns])
            found[-1] = part[-1]
            rows.append(found)
        return rows[0], rows[1], np.where(np.arange(len(own)) < len(own) - 1, 0.0, ahead[-1])[:, None]

    @property
    def total_bend(self) -> float:
        """int |u|^2 ds along the arm, 1/m."""
        here = self.here
        return float(((here.length[:, None] * here.t.weights) * (here.u**2).sum(2)).sum())

    @cached_property
    def bend(self) -> Array:
        """(Q,) of int |u|^2 ds, 1/m."""
        out = []
        for at, change, answer in self.answers:
            bent, weights = answer.bent[0], at.t.weights
            grown = change.length[0][:, None] * (at.u**2).sum(2) + 2 * at.length[:, None] * (at.u * bent).sum(2)
            out.append(float((weights * grown).sum()))
        return np.array(out)

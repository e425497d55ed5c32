"""The equilibrium of a tube robot as a block of a nonlinear program that its user composes.

Every piece of the arm is the same function of the rotations and torsions where it begins, of the rotations at its
points, of the pose where it begins, and of the cross-section: lifted into unknowns, so that every derivative is local
and IPOPT has exact sparse Hessians. Joint values and dimensions of the tubes are numbers or expressions.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import casadi as ca
import numpy as np

from ..errors import InputError
from ..mechanics.shape import rotation_matrix
from ..robots.assembly import Array
from ..robots.breakpoints import DIMENSIONS, dimensions_of, order_of, places
from . import functions
from .layout import FREE_REFINEMENT, Layout, gap_names, layout
from .piece import Grid
from .program import as_program

if TYPE_CHECKING:
    from ..equilibrium import Equilibrium

SMOOTH = 1e-9
"""Rounds off the root of a strain at 0."""


class OrderWarning(UserWarning):
    """A solution at which breakpoints meet: behind the meeting another order of them may be better."""


class EquilibriumBlock:
    """One equilibrium of a robot in a nonlinear program.

    Args:
        opti: a `casadi.Opti` or a `tubeopt.Problem`, to which unknowns and equations are added.
        near: a solved equilibrium: the start, and the order of the breakpoints. Its robot is the block's.
        rotations, translations: (n,) rad and m, numbers or expressions of the program; None keeps those of `near`.
        tubes: dimensions of the tubes that are expressions or other numbers, (n,) each, by name: any of `DIMENSIONS`;
            what is not named stays.
        side: where a transition lies at the plate and may move: -1 lets it move behind, 1 to the front.
        refinement: how often the pieces of the mesh are halved; None halves them once where lengths, curvatures or
            stiffnesses are free.

    Attributes:
        tip_position (3,) m, tip_rotation (3, 3): pose of the tip in the plate frame.
        energy: elastic energy, J.  length: of the arm in front of the plate, m.
        rotations, translations, dimensions: as given or taken over.

    Raises:
        InputError: an unknown name, or a vector of the wrong length.

    Example:
        >>> import casadi, tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/two_tube.yaml")
        >>> near = tubeopt.forward_kinematics(robot, [0.0, 1.0])
        >>> opti = casadi.Opti()
        >>> turn = opti.variable(2)
        >>> block = tubeopt.EquilibriumBlock(opti, near, rotations=turn)
        >>> opti.set_initial(turn, near.rotations)
        >>> opti.minimize(casadi.sumsqr(turn - near.rotations))
        >>> opti.subject_to(block.tip_position[0] == near.tip_position[0] + 1e-3)
        >>> opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes"})
        >>> found = block.equilibrium(opti.solve())
        >>> round(1e3 * (found.tip_position[0] - near.tip_position[0]), 6)
        1.0
    """

    def __init__(
        self,
        opti: Any,
        near: Equilibrium,
        *,
        rotations: Any = None,
        translations: Any = None,
        tubes: Mapping[str, Any] | None = None,
        side: int = -1,
        refinement: int | None = None,
    ) -> None:
        robot = near.robot
        self.near, self.robot, self.program = near, robot, as_program(opti)
        self._n, self._free = robot.n_tubes, _symbolic(translations)
        self.rotations = self._column("rotations", rotations, near.rotations)
        self.translations = self._column("translations", translations, near.translations)
        self.dimensions = self._dimensions(tubes or {})
        assembly = robot.assembly(near.translations)
        self._grid = Grid(self._n, eccentric=assembly.eccentric)
        given = self.dimensions
        self._transmission, self._transition, self._end = places(
            self.translations, given["straight_length"], given["curved_length"]
        )
        free_tubes = any(_symbolic(value) for value in given.values())
        self._refinement = (FREE_REFINEMENT if free_tubes else 0) if refinement is None else refinement
        self._moving = self._free or any(_symbolic(given[name]) for name in ("straight_length", "curved_length"))
        order = order_of(assembly, robot.moving_together, side=side)
        self.layout: Layout = layout(assembly, order, refinement=self._refinement)
        if not self.layout.n_pieces:
            raise InputError("the robot lies behind the plate: an arm without length has no equilibrium to solve for")
        self._lay_out()
        self._add_unknowns()
        self._add_equations()
        self.program.enter(self)

    # --- construction -------------------------------------------------------------------------------------------------

    def _column(self, name: str, value: Any, otherwise: Any) -> Any:
        """An (n,) column of numbers or an expression."""
        if value is None:
            value = otherwise
        if isinstance(value, (list, tuple)) and any(_symbolic(entry) for entry in value):
            value = ca.vertcat(*value)
        if _symbolic(value):
            if value.numel() != self._n:
                raise InputError(f"{name} has {value.numel()} entries; the robot has {self._n} tubes")
            return ca.vec(value)
        numbers = np.asarray(value, dtype=float).ravel()
        if numbers.shape != (self._n,) or not np.isfinite(numbers).all():
            raise InputError(f"{name} is {numbers.tolist()}; it must be {self._n} finite numbers, one per tube")
        return ca.DM(numbers)

    def _dimensions(self, tubes: Mapping[str, Any]) -> dict[str, Any]:
        unknown = sorted(set(tubes) - set(DIMENSIONS))
        if unknown:
            raise InputError(f"tubes names {unknown[0]!r}; it may name {', '.join(DIMENSIONS)}")
        values = dimensions_of(self.robot.tubes)
        return {name: self._column(name, tubes.get(name), values[name]) for name in DIMENSIONS}

    def _lay_out(self) -> None:
        """Lengths and cross-sections of the pieces: numbers of the layout times places and dimensions."""
        lay, n = self.layout, self._n
        shapes = [np.shape(part) for part in (lay.length, lay.gap, lay.present, lay.curved)]
        if self._moving:
            self._numbers = self.program.parameter("layout", lay.numbers())
            sizes = np.cumsum([0, *(rows * columns for rows, columns in shapes)]).tolist()
            parts = ca.vertsplit(self._numbers, sizes)
            length, gap, present, curved = (ca.reshape(part, *size) for part, size in zip(parts, shapes, strict=True))
        else:
            length, gap, present, curved = (ca.DM(part) for part in (lay.length, lay.gap, lay.present, lay.curved))
        where = ca.vertcat(self._transition, self._end)
        self._lengths = length @ where
        self._gaps = gap @ where
        given, pieces = self.dimensions, lay.n_pieces
        kb = ca.repmat(given["bending_stiffness"], 1, pieces)
        self._stiffness = kb * present
        self._moment = kb * ca.repmat(given["curvature"], 1, pieces) * curved
        self._torsional = ca.repmat(given["torsional_stiffness"], 1, pieces)
        place = self.robot.assembly(self.near.translations)
        self._place = (place.offset, place.offset_angle) if self._grid.eccentric else ()
        self.length = ca.sum1(self._lengths)
        assert n == present.shape[0]

    def _add_unknowns(self) -> None:
        """Rotations and torsions where pieces begin and at their points, poses where they begin."""
        n, pieces, degree = self._n, self.layout.n_pieces, self._grid.degree
        reach = max(float(self.near.arc_length[-1]), 1e-3)
        self._reach = reach
        program = self.program
        self._theta = ca.reshape(program.variable("rotation", n * pieces), n, pieces)
        self._twist = ca.reshape(program.variable("torsion", n * pieces, scale=1 / reach), n, pieces)
        self._inner = ca.reshape(program.variable("rotation inside", n * pieces * degree), n, pieces * degree)
        self._q = ca.reshape(program.variable("orientation", 4 * (pieces - 1)), 4, pieces - 1)
        self._p = ca.reshape(program.variable("position", 3 * (pieces - 1), scale=reach), 3, pieces - 1)
        for symbol, value in zip(self._unknowns, self._guess(), strict=True):
            program.set_guess(ca.vec(symbol), value.ravel(order="F"))

    @property
    def _unknowns(self) -> tuple[Any, ...]:
        return self._theta, self._twist, self._inner, self._q, self._p

    @property
    def _arguments(self) -> list[Any]:
        """Of the functions of a piece, all pieces side by side."""
        place = [ca.repmat(ca.DM(v), 1, self.layout.n_pieces) for v in self._place]
        data = [self._stiffness, self._moment, self._torsional, self._lengths.T]
        return [self._theta, self._twist, self._inner, *data, *place]

    @property
    def _poses(self) -> tuple[Any, Any]:
        """Quaternions (4, P) and positions (3, P) where the pieces begin."""
        return ca.horzcat(ca.DM([1, 0, 0, 0]), self._q), ca.horzcat(ca.DM.zeros(3), self._p)

    def _mapped(self, function: ca.Function) -> Any:
        return function.map(self.layout.n_pieces)

    def _add_equations(self) -> None:
        n, add = self._n, self.program.subject_to
        defect, theta, twist = self._mapped(functions.torsion_function(self._grid))(*self._arguments)
        add("torsion equation", ca.vec(defect), upper=0.0)
        add("continuity of rotation", ca.vec(self._theta[:, 1:] - theta[:, :-1]), upper=0.0)
        add("continuity of torsion", ca.vec(self._twist[:, 1:] - twist[:, :-1]), upper=0.0, scale=1 / self._reach)
        wound = self._transmission * self._twist[:, 0]
        add("base rotation", self._theta[:, 0] - self.rotations - wound, upper=0.0)
        add("torsion at the end", twist[:, -1], upper=0.0, scale=1 / self._reach)
        q, p = self._mapped(functions.pose_function(self._grid))(*self._poses, *self._arguments)
        add("continuity of orientation", ca.vec(self._q - q[:, :-1]), upper=0.0)
        add("continuity of position", ca.vec(self._p - p[:, :-1]), upper=0.0, scale=self._reach)
        self.tip_position = p[:, -1]
        self.tip_rotation = rotation_matrix(q[:, -1])
        self.tip_rotations = theta[:, -1]
        bending = ca.sum2(self._mapped(functions.energy_function(self._grid))(*self._arguments))
        kt = self.dimensions["torsional_stiffness"]
        self.energy = bending + ca.dot(kt * self._transmission, self._twist[:, 0] ** 2) / 2
        if self._moving:
            add(gap_names(self.layout.order), self._gaps, scale=self._reach)
        assert n == theta.shape[0]

    def _guess(self) -> tuple[Array, ...]:
        """Values of the unknowns at `near`, by interpolation of its torsion on the pieces of the block."""
        from ..solution import discretisation_of, polish
        from ..transcription import arm as arms

        solution = polish(self.near, discretisation_of(self.near))
        assembly, t = solution.problem.assembly, self._grid.tableau
        length = self.layout.length @ np.concatenate([assembly.transition, assembly.end])
        start = np.concatenate([[0.0], np.cumsum(length)[:-1]])
        theta = arms.interpolate(solution.problem, solution.arm, start).T
        twist = np.array([arms.twist_at(solution.problem, solution.arm, s) for s in start]).T
        inside = (start[:, None] + length[:, None] * t.nodes).ravel()
        inner = arms.interpolate(solution.problem, solution.arm, inside).T
        return theta, twist, inner, *self._pose_guess((theta, twist, inner), length, assembly)

    def _pose_guess(self, torsion: tuple[Array, ...], length: Array, assembly: Any) -> tuple[Array, Array]:
        """Poses where the pieces begin but the first, by integration."""
        kb = assembly.bending_stiffness[:, None] * self.layout.present
        m = (assembly.bending_stiffness * assembly.curvature)[:, None] * self.layout.curved
        step, degree = functions.pose_function(self._grid), self._grid.degree
        q, p = np.array([1.0, 0, 0, 0]), np.zeros(3)
        out = []
        for k in range(self.layout.n_pieces - 1):
            inner = torsion[2][:, k * degree : (k + 1) * degree]
            own = [
                torsion[0][:, k],
                torsion[1][:, k],
                inner,
                kb[:, k],
                m[:, k],
                assembly.torsional_stiffness,
                length[k],
            ]
            q, p = (np.array(part).ravel() for part in step(q, p, *own, *self._place))
            out.append((q, p))
        return (
            np.array([q for q, _ in out]).reshape(-1, 4).T,
            np.array([p for _, p in out]).reshape(-1, 3).T,
        )

    # --- outputs ------------------------------------------------------------------------------------------------------

    def position(self, fraction: float) -> Any:
        """(3,) position, m, at a fraction of the arm's length in front of the plate: 0 the plate, 1 the tip."""
        return self.tip_position if fraction == 1.0 else self._inside(fraction)[1]

    def orientation(self, fraction: float) -> Any:
        """(3, 3) Bishop frame at a fraction of the arm's length."""
        return rotation_matrix(self._inside(fraction)[0])

    def curvature(self, fraction: float) -> Any:
        """(2,) curvature of the arm in its Bishop frame, 1/m, at a fraction of its length."""
        return self._inside(fraction)[4]

    def rotation(self, fraction: float) -> Any:
        """(n,) rotations theta_i of the tubes, rad, at a fraction of the arm's length."""
        return self._inside(fraction)[2]

    def _inside(self, fraction: float) -> Any:
        """All of `inside_function` at a fraction of the arm's length."""
        if not 0 <= fraction <= 1:
            raise InputError(f"fraction is {fraction:g}; it must lie between 0, the plate, and 1, the tip")
        assembly = self.robot.assembly(self.near.translations)
        length = self.layout.length @ np.concatenate([assembly.transition, assembly.end])
        behind = np.cumsum(length)
        k = min(int(np.searchsorted(behind, fraction * behind[-1])), len(length) - 1)
        start = ca.sum1(self._lengths[:k]) if k else 0.0
        x = (fraction * self.length - start) / self._lengths[k]
        degree = self._grid.degree
        piece = [self._theta[:, k], self._twist[:, k], self._inner[:, k * degree : (k + 1) * degree]]
        piece += [self._stiffness[:, k], self._moment[:, k], self._torsional[:, k], self._lengths[k], *self._place]
        q, p = self._poses
        return functions.inside_function(self._grid)(q[:, k], p[:, k], x, *piece)

    def strain(self, tube: int) -> Any:
        """(points,) bending strain r |u - u*| / (1 - r |u*|) at the surface of a tube (0 is the innermost), at the
        collocation points where it is."""
        if tube not in range(self._n):
            raise InputError(f"tube is {tube}; the robot has tubes 0 to {self._n - 1}")
        degree = self._grid.degree
        theta, u = self._mapped(functions.curvature_function(self._grid))(*self._arguments)
        radius = self.robot.tubes[tube].outer_diameter / 2
        out = []
        for k in np.flatnonzero(self.layout.present[tube]).tolist():
            own = self._moment[tube, k] / self._stiffness[tube, k]
            for c in range(k * degree, (k + 1) * degree):
                gap = u[:, c] - own * ca.vertcat(ca.cos(theta[tube, c]), ca.sin(theta[tube, c]))
                out.append(radius * ca.sqrt(ca.sumsqr(gap) + SMOOTH**2) / (1 - radius * ca.fabs(own)))
        return ca.vertcat(*out)

    def points(self) -> Any:
        """(3, m) shape points of the arm, four per piece, the tip last, m."""
        return self._mapped(functions.places_function(self._grid))(*self._poses, *self._arguments)

    def clearance(self, body: Any) -> Any:
        """(m,) distance of the arm's surface from a body at its shape points, m: at least 0 keeps them apart there.

        `body` is any of `tubeopt.obstacles`, or whatever has `distance(x, y, z)` written with arithmetic alone. Between
        the points nothing is known: `verify_trajectory` proves clearance.
        """
        places = self.points()
        thick = np.array([tube.outer_diameter / 2 for tube in self.robot.tubes])
        offset = self._place[0] if self._place else np.zeros(self._n)
        radius = np.repeat(
            (self.layout.present * (thick + offset)[:, None]).max(0), places.shape[1] // self.layout.n_pieces
        )
        x, y, z = (ca.SX.sym(axis) for axis in "xyz")
        far = ca.Function("distance", [x, y, z], [body.distance(x, y, z)]).map(places.shape[1])
        return ca.vec(far(places[0, :], places[1, :], places[2, :])) - ca.DM(radius)

    def margin_at_least(self, margin: Any) -> None:
        """Demand that the stability margin is at least `margin`, a number or an expression, for instance a variable that
        is maximised; below 1.

        By Jacobi's condition on softened tubes, whose determinants are smooth where an eigenvalue is not; for eccentric
        robots on their own equations. Accurate to about 1e-8; `equilibrium` gives the margin itself.
        """
        if not _symbolic(margin) and not float(margin) < 1:
            raise InputError(f"margin is {float(margin):g}; it must be below 1")
        n, pieces, reach = self._n, self.layout.n_pieces, self._reach
        size = np.concatenate([np.ones((n, n)), np.full((n, n), 1 / reach)]).ravel(order="F")
        flat = self.program.variable("Jacobi fields", 2 * n * n * (pieces - 1), scale=np.tile(size, pieces - 1))
        tip = ca.vertcat(ca.DM.eye(n), ca.DM.zeros(n, n))
        after = ca.horzcat(ca.reshape(flat, 2 * n, n * (pieces - 1)), tip)
        floor = ca.repmat(ca.MX(margin), 1, pieces)
        before = self._mapped(functions.fields_function(self._grid))(after, floor, *self._arguments)
        scale = np.tile(size, pieces - 1)
        inner = ca.vec(before[:, n:])
        self.program.set_guess(flat, self._fields_guess(margin))
        self.program.subject_to("Jacobi fields", flat - inner, upper=0.0, scale=scale)
        det = functions.determinant_function(n)
        base = before[:n, :n] - ca.repmat(self._transmission, 1, n) * before[n:, :n]
        fields = [det(before[:n, n * k : n * (k + 1)]) for k in range(pieces)]
        self.program.subject_to("margin", ca.vertcat(*fields, det(base)))

    def _fields_guess(self, margin: Any) -> Array:
        """The Jacobi fields where pieces begin, but the first, at `near`."""
        floor = float(margin) if not _symbolic(margin) else min(max(self.near.margin - 0.1, 0.0), 0.9)
        theta, twist, inner, *_ = self._guess()
        assembly = self.robot.assembly(self.near.translations)
        length = self.layout.length @ np.concatenate([assembly.transition, assembly.end])
        kb = assembly.bending_stiffness[:, None] * self.layout.present
        m = (assembly.bending_stiffness * assembly.curvature)[:, None] * self.layout.curved
        step, degree = functions.fields_function(self._grid), self._grid.degree
        fields = np.concatenate([np.eye(self._n), np.zeros((self._n, self._n))])
        out = []
        for k in reversed(range(1, self.layout.n_pieces)):
            own = [theta[:, k], twist[:, k], inner[:, k * degree : (k + 1) * degree], kb[:, k], m[:, k]]
            fields = np.array(step(fields, floor, *own, assembly.torsional_stiffness, length[k], *self._place))
            out.append(fields.ravel(order="F"))
        return np.concatenate([*reversed(out), np.zeros(0)])

    # --- solutions ----------------------------------------------------------------------------------------------------

    def equilibrium(self, solution: Any) -> Equilibrium:
        """The equilibrium of a solution, solved again on a mesh of its own and verified by adaptive re-integration.

        Args:
            solution: what `casadi.Opti.solve` or `tubeopt.Problem.solve` returned (`casadi.Opti.debug` serves where
                that failed).

        Raises:
            SolveError: Newton's method does not stay at the solution, or the tip differs by more than 1e-6 of the
                length: the pieces of the block are too long (`refinement`).
            InputError: dimensions of which no tube can be made.

        Warns:
            OrderWarning: breakpoints meet at the solution, so that another order of them may be better; `reorder`
                changes places.
        """
        from .answer import confirmed

        for text in self.meetings(solution):
            warnings.warn(text, OrderWarning, stacklevel=2)
        return confirmed(self, solution.value)

    def rotation_at(self, arc_length: Array, value: Any) -> Array:
        """(len(arc_length), n) theta of a solution, whose numbers `value` gives, at places along the arm, m."""
        length = np.array(value(self._lengths)).ravel()
        parts = [np.array(value(part), ndmin=2).reshape(part.shape) for part in self._arguments[:6]]
        start = np.concatenate([[0.0], np.cumsum(length)[:-1]])
        inside, degree = functions.inside_function(self._grid), self._grid.degree
        out = []
        for s in arc_length:
            k = max(int(np.searchsorted(start, s, side="right")) - 1, 0)
            theta, twist, inner, *data = parts
            own = [theta[:, k], twist[:, k], inner[:, k * degree : (k + 1) * degree], *(part[:, k] for part in data)]
            x = (s - start[k]) / length[k]
            out.append(np.array(inside(np.array([1.0, 0, 0, 0]), np.zeros(3), x, *own, length[k], *self._place)[2]))
        return np.array(out).reshape(-1, self._n)

    def meetings(self, solution: Any) -> list[str]:
        """Which breakpoints, free to move, meet at a solution, in words."""
        return [f"{gap_names(self.layout.order)[k]}, and they meet" for k in self._touching(solution)]

    def _touching(self, solution: Any) -> list[int]:
        """Rows of the gaps that are free and closed at a solution."""
        if not self._moving:
            return []
        gaps = np.array(solution.value(self._gaps)).ravel()
        return [int(k) for k in np.flatnonzero(np.abs(gaps) < 1e-7)]


def _symbolic(value: Any) -> bool:
    return isinstance(value, (ca.SX, ca.MX))

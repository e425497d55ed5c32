"""How hard a heating is planned, and a rig calibrated: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ...errors import Settings
from ...solvers.settings import Ipopt

OPTIMAL_CONTROL = Ipopt(tolerance=1e-4, constraint_tolerance=1e-7, iterations=250, barrier=1e-2)


@dataclass(frozen=True)
class ProgramSolver(Settings):
    """Settings of the optimal control problem."""

    ipopt: Ipopt = OPTIMAL_CONTROL
    """Its objective is in units of about 1 K and 30 s: the tolerance is far below what the coarse grid and whole counts
    change."""
    again_iterations: int = 25
    """Maximum number of IPOPT iterations from an earlier solution; a new start follows."""
    room: float = 0.75
    """Reserve below the ramp limit, as heating by this many duty counts."""
    more_room: float = 1.0
    """Larger reserve, if integer duties fall behind with the first."""
    duty_points: int = 401
    """Number of points of the piecewise linear duty over heating and hold."""
    ramp_kept: float = 0.03
    """Share of the ramp that is kept for the fine grid."""
    ramp_left: float = 0.15
    """Share of it that is left at least when room is made for whole counts."""
    most_miss: float = 1500.0
    """Largest miss of the window, K; with it the program is always feasible, at a price."""
    guess_slot: float = 0.25
    """Slot of the controller that gives the starting schedule, s."""
    guess_miss: float = 20.0
    """Miss of the window by the starting schedule, K, above which the program starts with slack."""


@dataclass(frozen=True)
class CountSolver(Settings):
    """Settings for integer duties and the shortest schedule of them."""

    colder: float = 4.0
    """Largest temperature loss by duties reduced for the ramp limit, K."""
    watched: float = 10.0
    """Time of the hold, s, after which no duty comes near the ramp, and counts follow without a look."""
    spared: float = 0.005
    """Share of the ramp that counts leave unused, for what the quick simulation beside them gets
    wrong."""
    decided: float = 0.5
    """Least time, s, for which a duty of the soonest hold is chosen; slots that are shorter share it."""
    stall: float = 10.0
    """Time, s, over which it is looked how fast the coldest point warms."""
    sooner: float = 2.0
    """Largest speed-up of later heating."""
    probe: float = 8.0
    """Counts between which temperatures at the end of a slot are taken to be linear."""


@dataclass(frozen=True)
class NearestSolver(Settings):
    """How the schedule that misses the window by least is searched for."""

    places: int = 800
    """At which the hold may begin, at least half a second apart."""
    branches: int = 9
    """Times from which on the curved part is brought to the window's middle."""
    settling: float = 60.0
    """Time, s, after which the hold begins at the latest then."""
    burst: float = 20.0
    """Length of a hold, s, up to which a colder wait before it may pay."""
    waits: tuple[float, ...] = (0.6, 0.85)
    """Shares of the limit's rise over ambient at which it waits."""
    rises: tuple[float, ...] = (2.0, 5.0, 10.0, 20.0, 40.0)
    """By how much the hold begins below the limit, K, to which it rises."""
    before: float = 5.0
    """Time before the hold, s, from which on it does."""
    same: float = 0.02
    """Misses, K, that differ by less are equal: the soonest is taken."""
    caps: int = 4
    """Temperatures of the hottest point that are tried, until its counts come to just below the limit."""


@dataclass(frozen=True)
class CureSearch(Settings):
    """Settings of the search for changes that help a missed window."""

    most: int = 3
    """Maximum number of changes tried; may be 0."""
    quick_slot: float = 0.1
    """Slots, s, that are proposed for a window that is too narrow for those that were asked for."""
    miss: float = 0.05
    """Miss of the window by the program, K, below which an integer schedule is computed as a check."""
    worth: float = 0.1
    """Smallest relative reduction of the miss that is reported."""
    slot: float = 0.5
    """Longest duration of equal duties in that check, s."""
    swing: float = 0.1
    """Largest heating by half a count in that time, as a fraction of the window's width."""

    _none: ClassVar[tuple[str, ...]] = ("most",)


@dataclass(frozen=True)
class FabricationSolver(Settings):
    """Settings of the joint search over mold and heating of a tube."""

    molds: int = 5
    """Maximum number of molds drawn."""
    same_length: float = 1e-5
    """Lengths of mold and heating, m, that differ by less are equal."""
    longer_lead: float = 1e-3
    """Length of the leads beyond cold ends that reach into the curved part, m."""
    lead_peak: float = 0.98
    """Share of the circuit's peak current for which leads are made longer, where a shorter tube would draw more."""


@dataclass(frozen=True)
class LawSolver(Settings):
    """Settings of the controller design."""

    inside: float = 0.25
    """Distance of the coldest point inside the window at the start of a controlled hold, as a fraction of its width."""
    rigs: int = 48
    """Number of random rigs for choosing gains and set-point; other rigs test them."""


@dataclass(frozen=True)
class ReplanningSolver(Settings):
    """Settings for replanning a running heating, and of its observer."""

    share: float = 0.5
    """Largest relative deviation of the heating power from the model."""
    strength: float = 0.01
    """Change of that share in a slot."""
    drift: float = 1.0
    """Expected temperature drift per slot, K."""
    rough: float = 2.0
    """Model error of a reading, K, in addition to the sensor noise."""
    probe: float = 0.05
    """Relative increase of a planned duty that tests the response."""


@dataclass(frozen=True)
class HeatingSolver(Settings):
    """Settings of the search for a heating schedule, its corrections and its control; a field of `HeatingSpec`.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `trims` and `cures.most`), another number that
            is not positive.
    """

    program: ProgramSolver = ProgramSolver()
    """Settings of the optimal control problem."""
    counts: CountSolver = CountSolver()
    """Settings of the rounding to integer duties."""
    nearest: NearestSolver = NearestSolver()
    """Settings of the search for the smallest miss."""
    cures: CureSearch = CureSearch()
    """Settings of the search for changes that help a missed window."""
    fabrication: FabricationSolver = FabricationSolver()
    """Settings of the joint search over mold and heating."""
    law: LawSolver = LawSolver()
    """Settings of the controller design."""
    replanning: ReplanningSolver = ReplanningSolver()
    """Settings of replanning during heating."""
    rounds: int = 4
    """Rounds of the optimal control problem; each is corrected by the difference between its grid and the fine one."""
    trims: int = 8
    """Times that duties are scaled down until no point is above the limit."""
    cooling: float = 10.0
    """Simulated time after the hold, the tube still in the mold, s."""
    same_shift: float = 0.3
    """Change of the correction, K, below which another round would change nothing."""
    hopeless: float = 5.0
    """Miss of the window after the first round, K, that no correction repairs."""
    settled: float = 2.0
    """Miss of the window by the corrected program, K, that no further round repairs."""
    fine_swing: float = 0.5
    """Largest temperature ripple by the rounding of duties, K, with a sufficiently accurate estimate."""
    first_error: float = 0.004
    """Expected mesh error before it is known, as a fraction of the temperature rise."""
    reserve: float = 0.3
    """Kept from the window's ends beyond rounding and mesh error, K."""

    _none: ClassVar[tuple[str, ...]] = ("trims",)


DEFAULT_HEATING = HeatingSolver()


@dataclass(frozen=True)
class RigSolver(Settings):
    """Settings of the calibration of a rig to a log, for `calibrate`.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    step: float = 0.5
    """Longest of the simulation of a log, s."""
    perturbation: float = 1e-3
    """Step of the logarithm of a factor for finite differences."""
    bias: float = 25.0
    """Bias of a thermometer that counts as much as a factor of e, K."""
    weak: float = 0.4
    """Standard error of a factor's logarithm above which it is fixed: the log does not determine it."""
    flat: int = 3
    """Readings in a row at a channel's greatest value that are more than chance."""
    heated: float = 30.0
    """Rise, K, that the rig's file must expect of a thermometer before it is called dead or saturated."""
    shifted: float = 5.0
    """Difference between a thermometer and the ambient temperature before heating that causes a remark, K."""
    rare: float = 1e-4
    """Probability below which what is seen is no accident of noise."""


DEFAULT_RIG_SOLVER = RigSolver()

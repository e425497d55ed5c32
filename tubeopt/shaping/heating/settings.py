"""How hard a heating is planned, and a rig calibrated: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ...errors import Settings
from ...solvers.settings import Ipopt

OPTIMAL_CONTROL = Ipopt(tolerance=1e-4, constraint_tolerance=1e-7, iterations=250, barrier=1e-2)


@dataclass(frozen=True)
class ProgramSolver(Settings):
    """How the optimal control problem is posed and solved."""

    ipopt: Ipopt = OPTIMAL_CONTROL
    """Its objective is in units of about 1 K and 30 s: the tolerance is far below what the coarse grid and whole counts
    change."""
    again_iterations: int = 25
    """Of IPOPT from an earlier answer, from which few are enough; where they are not, a new start is better."""
    room: float = 0.75
    """Counts of the duty for whose warming room is left below the ramp."""
    more_room: float = 1.0
    """The same, where counts fall behind with that."""
    duty_points: int = 401
    """Between which the ideal duty is taken to be linear, over heating and hold."""
    ramp_kept: float = 0.03
    """Share of the ramp that is kept for the fine grid."""
    ramp_left: float = 0.15
    """Share of it that is left at least when room is made for whole counts."""
    most_miss: float = 1500.0
    """Of the window, K, which so is always solvable, at a price."""
    guess_slot: float = 0.25
    """Slots, s, of the controller with whose schedule it begins."""
    guess_miss: float = 20.0
    """Of the window by a guess, K, from which on it begins with it."""


@dataclass(frozen=True)
class CountSolver(Settings):
    """How duties become whole counts, and which are the soonest."""

    colder: float = 4.0
    """What counts held back for the sake of the ramp may cost, K."""
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
    """How many times as fast it may warm later."""
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
    """How changes that would help are searched for, where the window is missed."""

    most: int = 3
    """That are tried; there may be none."""
    quick_slot: float = 0.1
    """Slots, s, that are proposed for a window that is too narrow for those that were asked for."""
    miss: float = 0.05
    """Of the window by the program, K, below which a schedule of counts is made to see whether it is held."""
    worth: float = 0.1
    """Share of the miss that a change must take away to be told."""
    slot: float = 0.5
    """To see that a change cures, duties are kept for up to this long, s."""
    swing: float = 0.1
    """Share of the window's width by which half a count may warm in that time, for duties to be kept so long."""

    _none: ClassVar[tuple[str, ...]] = ("most",)


@dataclass(frozen=True)
class FabricationSolver(Settings):
    """How a tube's mold and heating are planned for each other."""

    molds: int = 5
    """That are drawn at most."""
    same_length: float = 1e-5
    """Lengths of mold and heating, m, that differ by less are equal."""
    longer_lead: float = 1e-3
    """What leads get beyond the cold ends, m, where these reach into the curved part."""
    lead_peak: float = 0.98
    """Share of the circuit's peak current for which leads are made longer, where a shorter tube would draw more."""


@dataclass(frozen=True)
class LawSolver(Settings):
    """How the law of a sensor is chosen."""

    inside: float = 0.25
    """Share of the window's width by which the coldest point is inside where a led hold begins."""
    rigs: int = 48
    """On which gains and set-point are chosen; others tell how well they do."""


@dataclass(frozen=True)
class ReplanningSolver(Settings):
    """How the rest of a heating is planned anew; what its observer expects of a slot."""

    share: float = 0.5
    """Greatest by which the heating may be stronger or weaker than the model says."""
    strength: float = 0.01
    """Change of that share in a slot."""
    drift: float = 1.0
    """Of the temperature in a slot, K."""
    rough: float = 2.0
    """What the model gets wrong of a reading, K, beside the sensor's noise."""
    probe: float = 0.05
    """Share of a planned duty by which it is raised to see what the reading does."""


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

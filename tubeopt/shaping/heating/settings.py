"""How hard a heating is planned: what a user may want to change, as documented fields."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ...errors import Settings
from ...solvers.settings import Ipopt

OPTIMAL_CONTROL = Ipopt(tolerance=1e-4, constraint_tolerance=1e-7, iterations=250, barrier=1e-2)


@dataclass(frozen=True)
class HeatingSolver(Settings):
    """How a heating schedule is searched for, corrected and led; a field of `HeatingSpec`.

    Args:
        ipopt: how the optimal control problem is solved. Its objective is in units of about 1 K and 30 s: the tolerance
            is far below what the coarse grid and whole counts change.
        again_iterations: of IPOPT from an earlier answer, from which few are enough; where they are not, a new start is
            better.
        rounds: of the optimal control problem, corrected by the difference between its grid and the fine one.
        trims: times that duties are scaled down until no point is above the limit.
        room, more_room: counts of the duty for whose warming the program leaves room below the ramp, tried in turn.
        cooling: time, s, for which the simulation goes on after the hold, the tube still in the mold.
        same_shift: change of the correction, K, below which another round would change nothing.
        hopeless: miss of the window, K, from which on a first round is far from what a correction can mend.
        settled: miss of the window by the corrected program, K, from which on no other round lets it be held.
        fine_swing: swing by rounding to counts, K, up to which it is told well enough before it is known.
        first_error: of the mesh, expected before it is known, as a share of the rise in temperature.
        reserve: kept from the window's ends beyond rounding and mesh error, K.
        duty_points: between which the ideal duty is taken to be linear, over heating and hold.
        ramp_kept: share of the ramp that is kept for the fine grid.
        ramp_left: share of it that is left at least when room is made for whole counts.
        most_miss: of the window by the program, K, which so is always solvable, at a price.
        guess_slot: slots, s, of the controller with whose schedule the program begins.
        guess_miss: of the window by a guess, K, from which on the program begins with it.
        colder: what counts held back for the sake of the ramp may cost, K.
        watched: time of the hold, s, after which no duty comes near the ramp, and counts follow without a look.
        spared: share of ramp and current limit that counts leave unused, for what the quick simulation beside them gets
            wrong.
        decided: least time, s, for which a duty of the soonest hold is chosen; slots that are shorter share it.
        stall: time, s, over which it is looked how fast the coldest point warms.
        sooner: how many times as fast it may warm later.
        probe: counts between which temperatures at the end of a slot are taken to be linear.
        cures: changes that are tried where the window is missed.
        quick_slot: slots, s, that are proposed for a window that is too narrow for those that were asked for.
        cure_miss: of the window by the program, K, below which a schedule of counts is made to see whether it is held.
        cure_worth: share of the miss that a change must take away to be told.
        cure_slot, cure_swing: to see that a change cures, duties are kept for up to this long, s, where half a count
            warms by no more than this share of the window in that time.
        molds: that are drawn at most where a tube's mold and heating are planned for each other.
        same_length: lengths of mold and heating, m, that differ by less are equal.
        longer_lead: what leads get beyond the cold ends, m, where these reach into the curved part.
        lead_peak: share of the circuit's peak current for which leads are made longer, where a shorter tube would draw
            more.
        law_inside: share of the window's width by which the coldest point is inside where a led hold begins.
        law_rigs: on which gains and set-point of the law are chosen; others tell how well they do.
        replanned_share: greatest by which the heating may be stronger or weaker than the model says, in replanning.
        replanned_strength, replanned_drift, replanned_rough: what its observer expects of a slot: change of that share,
            drift of the temperature, K, and what the model gets wrong of a reading, K, beside the sensor's noise.
        replanned_probe: share of a planned duty by which it is raised to see what the reading does.

    Raises:
        InputError: a count that is no whole number of at least 1 (0 for `trims` and `cures`), another number that is
            not positive.
    """

    ipopt: Ipopt = OPTIMAL_CONTROL
    again_iterations: int = 25
    rounds: int = 4
    trims: int = 8
    room: float = 0.75
    more_room: float = 1.0
    cooling: float = 10.0
    same_shift: float = 0.3
    hopeless: float = 5.0
    settled: float = 2.0
    fine_swing: float = 0.5
    first_error: float = 0.004
    reserve: float = 0.3
    duty_points: int = 401
    ramp_kept: float = 0.03
    ramp_left: float = 0.15
    most_miss: float = 1500.0
    guess_slot: float = 0.25
    guess_miss: float = 20.0
    colder: float = 4.0
    watched: float = 10.0
    spared: float = 0.005
    decided: float = 0.5
    stall: float = 10.0
    sooner: float = 2.0
    probe: float = 8.0
    cures: int = 3
    quick_slot: float = 0.1
    cure_miss: float = 0.05
    cure_worth: float = 0.1
    cure_slot: float = 0.5
    cure_swing: float = 0.1
    molds: int = 5
    same_length: float = 1e-5
    longer_lead: float = 1e-3
    lead_peak: float = 0.98
    law_inside: float = 0.25
    law_rigs: int = 48
    replanned_share: float = 0.5
    replanned_strength: float = 0.01
    replanned_drift: float = 1.0
    replanned_rough: float = 2.0
    replanned_probe: float = 0.05

    _none: ClassVar[tuple[str, ...]] = ("trims", "cures")


DEFAULT_HEATING = HeatingSolver()


@dataclass(frozen=True)
class RigSolver(Settings):
    """How a rig is calibrated to a log, or to trials; of `calibrate` and `calibrate_from_trials`.

    Args:
        step: longest of the simulation of a log, s.
        perturbation: of the logarithm of a factor, for derivatives.
        bias: of a thermometer, K, that counts as much as a factor of e.
        weak: standard error of a factor's logarithm from which on it is held: the log does not determine it.
        flat: readings in a row at a channel's greatest value that are more than chance.
        heated: rise, K, that the rig's file must expect of a thermometer before it is called dead or saturated.
        shifted: what a thermometer may be off the ambient temperature before heating, K, before that is remarked.
        rare: probability below which what is seen is no accident of noise.
        trial_spread: standard deviation, K, of the temperature at which a trial turns out so or so: tubes and eyes
            differ; assumed.
        trial_prior: standard deviation of the logarithm of the loss factor before any trial; assumed.
        trial_slots: of the simulation of a trial.

    Raises:
        InputError: a count that is no whole number of at least 1, another number that is not positive.
    """

    step: float = 0.5
    perturbation: float = 1e-3
    bias: float = 25.0
    weak: float = 0.4
    flat: int = 3
    heated: float = 30.0
    shifted: float = 5.0
    rare: float = 1e-4
    trial_spread: float = 15.0
    trial_prior: float = 0.3
    trial_slots: int = 120


DEFAULT_RIG_SOLVER = RigSolver()

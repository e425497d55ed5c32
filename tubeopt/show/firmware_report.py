"""What is said and saved about a heating that a sensor leads, and the sketch that runs it."""

from __future__ import annotations

from pathlib import Path

from rich.console import RenderableType

from ..errors import SolveError
from ..runs.heating_study import LedHeating
from ..shaping.firmware.boards import Part, parts_list
from ..shaping.firmware.sketch_files import write_sketch
from ..shaping.heating.controller import Contribution, Feedback
from .heat_report import missed
from .quantities import Quantity, columns, described, line, of_field, within
from .report import Report, grid, remarks

CONTRIBUTION = described(
    Contribution,
    of_field(Contribution, "name", label="not known", words=lambda item: item.name.replace("_", " ")),
    "deviation",
)  # fmt: skip

PART = described(Part)

FEEDBACK = described(
    Feedback,
    Quantity("sensor", "sensor", lambda f: f.sensor.name),
    Quantity("sensor_bias_K", "half-width of its constant error", lambda f: f.sensor.bias),
    Quantity("proportional_per_K", "proportional gain: fraction of the planned duty per K",
             lambda f: f.law.proportional),
    Quantity("integral_per_K_s", "integral gain", lambda f: f.law.integral),
    Quantity("samples", "number of uncertain rigs"),
    Quantity("probability", "fraction of them that keeps window and limit", label="keeps the window",
             words=lambda f: f"{100 * f.probability:.1f} % of {f.samples} uncertain rigs "
             f"({100 * f.interval[0]:.1f} to {100 * f.interval[1]:.1f} %)"),
    Quantity("interval", "95 % confidence interval of the probability"),
    of_field(Feedback, "open_loop", label="without the sensor",
             words=lambda f: f"{100 * f.open_loop:.0f} % of {f.samples}; the schedule leaves the sensor room"),
    Quantity("too_cold", "fraction below the window"),
    Quantity("too_hot", "fraction above window or limit"),
    Quantity("lowest_degC", "lowest temperature of the curved part in the hold, all rigs", lambda f: f.lowest.min()),
    Quantity("highest_degC", "highest temperature of the curved part in the hold, all rigs", lambda f: f.highest.max()),
    line("curved part, any rig", "{lowest_degC:.1f} to {highest_degC:.1f} degC in the hold"),
    Quantity("top_degC", "highest temperature of any point at any time, all rigs", lambda f: f.top.max(),
             label="hottest point, any rig", words="{top_degC:.1f} degC"),
    of_field(Feedback, "contributions", of=CONTRIBUTION),
)  # fmt: skip

LED_HEATING = described(
    LedHeating,
    Quantity("rig", "name of the rig", lambda a: a.plan.rig.name),
    Quantity("window_degC", "temperature window of the hold", lambda a: a.plan.spec.window_degC),
    Quantity("limit_degC", "temperature limit of every point at all times", lambda a: a.plan.spec.limit),
    Quantity("feasible", "true if the schedule alone keeps all limits on the nominal rig", lambda a: a.plan.feasible),
    Quantity("board", "board for the sketch", lambda a: a.wiring.known.title, label="board",
             words="{board}, pulses at {pwm_Hz:.1f} Hz"),
    "frequency",
    *within(FEEDBACK, lambda a: a.feedback),
    Quantity("parts", "list of parts", lambda a: list(parts_list(a.plan, a.wiring)), of=PART),
)  # fmt: skip


class LedHeatingReport(Report[LedHeating]):
    command = "heat firmware"
    quantities = LED_HEATING
    file = "law.json"
    drawn = (("feedback", "heating.plot_feedback"), ("wiring", "heating.plot_wiring"))

    def title(self) -> str:
        return self.answer.plan.rig.name or "rig"

    def below(self) -> list[RenderableType]:
        """What moves the temperature, and what to buy."""
        answer = self.answer
        moved = columns(answer.feedback.contributions[:6], CONTRIBUTION)
        return [
            grid(*moved, title="what moves the temperature (standard deviation)"),
            grid(*columns(parts_list(answer.plan, answer.wiring), PART), title="what to build it of"),
            *remarks(answer.plan.problems, what="problem"),
        ]

    def save(self, directory: Path) -> list[Path]:
        """Write law.json and the sketch."""
        answer = self.answer
        return [self.save_record(directory), *write_sketch(answer.plan, answer.feedback, answer.wiring, directory)]

    def conclude(self) -> None:
        """Raise SolveError where the schedule does not keep everything on the rig as filed, or most rigs fail."""
        answer, feedback = self.answer, self.answer.feedback
        if not answer.plan.feasible:
            raise SolveError(missed(answer.plan))
        if feedback.probability < 0.5:
            raise SolveError(f"{100 * feedback.probability:.1f} % of {feedback.samples} random rigs stay in the window")

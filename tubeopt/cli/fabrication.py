"""`tubeopt fabricate`: molds and heating schedules for every tube of a robot, in one go."""

from __future__ import annotations

from ..runs.fabrication_study import FabricationStudy
from .flags import answer, asks
from .heat import DEFAULT_CHARGES
from .output import Output


@asks(
    FabricationStudy,
    defaults={"charges_percent": DEFAULT_CHARGES, "samples": "32"},
    example="tubeopt fabricate configs/robots/thesis_etr.yaml --rig configs/rigs/thesis_calcium_silicate.yaml "
    "--out results",
)
def fabricate(study: FabricationStudy, output: Output) -> None:
    """Molds and schedules for every tube of a robot: drawings, G-code, duties by the battery's voltage, pictures.

    The mold is drawn for the rig, and the heating planned on the rig with the mold as drawn. Ends with 3 where the
    window is not held within limit, ramp and currents for one of them, or where mold and heating do not agree;
    everything is shown and saved all the same.
    """
    answer(study, output)

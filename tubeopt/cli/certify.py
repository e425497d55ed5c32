"""`tubeopt certify`: whether a robot can snap."""

from __future__ import annotations

from dataclasses import replace

from ..runs.stability_studies import CertifyStudy
from ..show.reports import report
from .flags import ask, asks
from .output import Output, present


@asks(
    CertifyStudy,
    example="tubeopt certify configs/robots/crl_ctr.yaml --translations-mm -20,0,0",
    note=CertifyStudy.assuming,
)
def certify(study: CertifyStudy, output: Output, robot: str) -> None:
    """Whether the robot can snap at any rotation: what is proved, and what search finds.

    Ends with 0 if it cannot snap, 3 if it can, 4 if neither is known; with a box, at the translations of its least
    certificate that was found. With a force, 0 is only for what is proved under it.
    """
    present(report(replace(ask(study, output), robot_file=robot)), output)

"""Studies as YAML: a question about a robot, with everything that it takes to answer it.

A new kind of study is a subclass of `Study` with its own keys and `run`, entered in `STUDY_KINDS`.
"""

from __future__ import annotations

from os import PathLike
from typing import cast

from ..arguments import typed
from ..errors import InputError
from ..files.checked import check_kind
from ..files.shipped import found
from ..files.yaml_file import load_yaml
from .base import Kinds, Study

STUDY_KINDS = Kinds(
    {
        "forward_kinematics": "forward_study.ForwardKinematicsStudy",
        "inverse_kinematics": "inverse_study.InverseStudy",
        "equilibria": "stability_studies.EquilibriaStudy",
        "snap": "stability_studies.SnapStudy",
        "follow": "stability_studies.FollowStudy",
        "load_limit": "load_studies.LoadLimitStudy",
        "force": "load_studies.ForceStudy",
        "certify": "stability_studies.CertifyStudy",
        "stability_map": "stability_studies.StabilityMapStudy",
        "validation": "validation_study.ValidationStudy",
        "measure": "validation_study.MeasureStudy",
        "design": "design_study.DesignStudy",
        "design_pair": "pair_study.PairStudy",
        "plan": "plan_study.PlanStudy",
        "plan_arms": "arms_study.ArmsStudy",
        "verify": "verify_study.VerifyStudy",
        "workspace": "workspace_study.WorkspaceStudy",
        "heating": "heating_study.HeatingStudy",
        "led_heating": "firmware_study.LedHeatingStudy",
        "heating_run": "heating_run.HeatingRunStudy",
        "heating_calibration": "calibration_studies.HeatingCalibrationStudy",
        "mold_plan": "mold_study.MoldStudy",
        "mandrel": "mold_study.MandrelStudy",
        "mold_materials": "mold_study.MaterialsStudy",
        "mold_calibration": "calibration_studies.MoldCalibrationStudy",
        "fabrication": "fabrication_study.FabricationStudy",
    }
)
"""What the key `kind` of a study file may say."""


@typed
def load_study(path: str | PathLike[str]) -> Study:
    """The study in a YAML file, or of this name, its robot loaded; call its `run` for the answer.

    Raises:
        InputError: no such file or name, not YAML, or keys or values that make no study: one line for every problem.

    Examples:
        >>> import tubeopt
        >>> snap = tubeopt.load_study("thesis_snap").run().snap
        >>> round(snap.fraction, 6)
        0.595062
    """
    path = found(path, "studies")
    data = load_yaml(path)
    if data.get("kind") == "sweep":
        raise InputError(f"{path}: kind is 'sweep'; use `tubeopt sweep`")
    return cast(Study, check_kind(STUDY_KINDS, data, path))

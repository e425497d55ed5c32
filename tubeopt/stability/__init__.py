"""Stability: every equilibrium, the branch that is followed, the exact snap, and the certificate against it."""

from .branch import Branch, trace_branch
from .certificate import Certificate, certify, snap_free_certificate
from .deflection import deflection_bound
from .drives import Drives, drives_along, drives_at
from .energy import EnergyMap, energy_map
from .equilibria import EquilibriaSearch, find_equilibria
from .fatigue import Endurance, Fatigue, StrainLife, TubeFatigue, fatigue
from .following import Path, find_snap, follow
from .friction_path import FrictionBand, friction_band
from .load_limit import LoadLimit, find_load_limit
from .maps import StabilityMap, stability_map
from .motion import Snap
from .snap_assessment import ASSUMING, EccentricSnapAssessment, Finding, SnapAssessment, assess_snapping
from .snap_distance import SnapDistance, least_snap_distance, snap_distance
from .snap_in_time import SnapInTime, snap_in_time
from .stroke import find_stroke_force
from .worst import SnapSearch, WorstCertificate, WorstMargin, worst_certificate, worst_margin

__all__ = [
    "ASSUMING",
    "Branch",
    "Certificate",
    "Drives",
    "EccentricSnapAssessment",
    "Endurance",
    "EnergyMap",
    "EquilibriaSearch",
    "Fatigue",
    "Finding",
    "FrictionBand",
    "LoadLimit",
    "Path",
    "Snap",
    "SnapAssessment",
    "SnapDistance",
    "SnapInTime",
    "SnapSearch",
    "StabilityMap",
    "StrainLife",
    "TubeFatigue",
    "WorstCertificate",
    "WorstMargin",
    "assess_snapping",
    "certify",
    "deflection_bound",
    "drives_along",
    "drives_at",
    "energy_map",
    "fatigue",
    "find_equilibria",
    "find_load_limit",
    "find_snap",
    "find_stroke_force",
    "follow",
    "friction_band",
    "least_snap_distance",
    "snap_distance",
    "snap_free_certificate",
    "snap_in_time",
    "stability_map",
    "trace_branch",
    "worst_certificate",
    "worst_margin",
]

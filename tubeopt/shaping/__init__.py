"""Fabrication of the tubes of a robot: molds, heating."""

from .materials import CALCIUM_SILICATE, GLASS_MICA, MDF, MOLD_MATERIALS, STEEL, MoldMaterial, mold_material
from .mold.checks import Check
from .mold.files import write_mold
from .mold.heat import ColdEnd, HeatSpec, cold_end, heat_drawn, heat_flow, thermal_growth
from .mold.layout import Hole
from .mold.mandrel import Mandrel, plan_mandrel, predict_wound_tube, write_mandrel
from .mold.measured_tube import MeasuredTube, measure_tube
from .mold.mold import Clamp, Groove, Mold, plan_mold, predict_tube, predict_tubes
from .mold.photo import TubePhoto, load_photo
from .mold.ranking import MaterialRating, rank_mold_materials
from .mold.spec import ClampSpec, EndMill, GrooveSpec, MillingSpec, MoldSpec, PlateSpec, VentSpec
from .mold.springback import Calibration, Springback, calibrate_springback

__all__ = [
    "CALCIUM_SILICATE",
    "GLASS_MICA",
    "MDF",
    "MOLD_MATERIALS",
    "STEEL",
    "Calibration",
    "Check",
    "Clamp",
    "ClampSpec",
    "ColdEnd",
    "EndMill",
    "Groove",
    "GrooveSpec",
    "HeatSpec",
    "Hole",
    "Mandrel",
    "MaterialRating",
    "MeasuredTube",
    "MillingSpec",
    "Mold",
    "MoldMaterial",
    "MoldSpec",
    "PlateSpec",
    "Springback",
    "TubePhoto",
    "VentSpec",
    "calibrate_springback",
    "cold_end",
    "heat_drawn",
    "heat_flow",
    "load_photo",
    "measure_tube",
    "mold_material",
    "plan_mandrel",
    "plan_mold",
    "predict_tube",
    "predict_tubes",
    "predict_wound_tube",
    "rank_mold_materials",
    "thermal_growth",
    "write_mandrel",
    "write_mold",
]

"""How the tubes of a robot are made: molds, heating."""

from .heating.settings import HeatingSolver, RigSolver
from .materials import CALCIUM_SILICATE, GLASS_MICA, MDF, MOLD_MATERIALS, STEEL, MoldMaterial, mold_material
from .mold.checks import Check
from .mold.files import write_mold
from .mold.heat import ColdEnd, HeatSpec, cold_end, heat_drawn, heat_flow, thermal_growth
from .mold.holes import Hole
from .mold.mandrel import Mandrel, plan_mandrel, predict_wound_tube
from .mold.mandrel_files import write_mandrel
from .mold.mold import Clamp, Groove, Mold, plan_mold
from .mold.ranking import MaterialRating, rank_mold_materials
from .mold.robot import predict_tube, predict_tubes
from .mold.settings import MoldSolver
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
    "HeatingSolver",
    "Hole",
    "Mandrel",
    "MaterialRating",
    "MillingSpec",
    "Mold",
    "MoldMaterial",
    "MoldSolver",
    "MoldSpec",
    "PlateSpec",
    "RigSolver",
    "Springback",
    "VentSpec",
    "calibrate_springback",
    "cold_end",
    "heat_drawn",
    "heat_flow",
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

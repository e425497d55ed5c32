# The names of `tubeopt.plot`, and where each comes from: loaded when it is first used.

from .show.page import tube_colour
from .show.plots.clamps import plot_clamp_sheet
from .show.plots.commission import plot_commissioning
from .show.plots.design import (
    plot_before_after,
    plot_front,
    plot_pair_fractions,
    plot_pair_places,
    plot_poses,
    plot_stock,
    plot_tolerance,
)
from .show.plots.drives import plot_drives, plot_fatigue
from .show.plots.eccentric import plot_permutations, plot_reach
from .show.plots.heating import plot_feedback, plot_heating, plot_oven, plot_rig_fit, plot_wiring
from .show.plots.loads import (
    plot_bearing,
    plot_force_estimates,
    plot_friction_band,
    plot_hysteresis,
    plot_load_limits,
    plot_payload,
)
from .show.plots.maps import plot_branch, plot_energy_maps, plot_stability_map
from .show.plots.mold import plot_mandrel, plot_materials, plot_mold, plot_springback
from .show.plots.path import plot_path, plot_snap
from .show.plots.shape import plot_deployment, plot_equilibria, plot_shape, plot_shapes, plot_torsion, plot_torsions
from .show.plots.sheets import plot_fabrication_sheet, plot_hole_sheet, plot_parts_sheet, plot_setup_sheet
from .show.plots.snap_in_time import plot_snap_in_time
from .show.plots.style import new_figure, picture, save_figure
from .show.plots.trajectory import plot_arms, plot_checked, plot_section, plot_trajectory, save_film
from .show.plots.tube_photo import plot_mark_sheet, plot_measured_tube
from .show.plots.validation import plot_effects, plot_error_table, plot_errors, plot_residuals, plot_simulated_circles
from .show.plots.workspace import plot_inverse, plot_targets, plot_workspace

__all__ = [
    "new_figure",
    "picture",
    "plot_arms",
    "plot_bearing",
    "plot_before_after",
    "plot_branch",
    "plot_checked",
    "plot_clamp_sheet",
    "plot_commissioning",
    "plot_deployment",
    "plot_drives",
    "plot_effects",
    "plot_energy_maps",
    "plot_equilibria",
    "plot_error_table",
    "plot_errors",
    "plot_fabrication_sheet",
    "plot_fatigue",
    "plot_feedback",
    "plot_force_estimates",
    "plot_friction_band",
    "plot_front",
    "plot_heating",
    "plot_hole_sheet",
    "plot_hysteresis",
    "plot_inverse",
    "plot_load_limits",
    "plot_mandrel",
    "plot_mark_sheet",
    "plot_materials",
    "plot_measured_tube",
    "plot_mold",
    "plot_oven",
    "plot_pair_fractions",
    "plot_pair_places",
    "plot_parts_sheet",
    "plot_path",
    "plot_payload",
    "plot_permutations",
    "plot_poses",
    "plot_reach",
    "plot_residuals",
    "plot_rig_fit",
    "plot_section",
    "plot_setup_sheet",
    "plot_shape",
    "plot_shapes",
    "plot_simulated_circles",
    "plot_snap",
    "plot_snap_in_time",
    "plot_springback",
    "plot_stability_map",
    "plot_stock",
    "plot_targets",
    "plot_tolerance",
    "plot_torsion",
    "plot_torsions",
    "plot_trajectory",
    "plot_wiring",
    "plot_workspace",
    "save_figure",
    "save_film",
    "tube_colour",
]

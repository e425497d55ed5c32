"""The commands of `tubeopt`: what is typed, and the study that it asks or the function that it runs.

Most commands ask a study, show its answer and save it: a row here is all of them. Nothing is imported for a row before
its command is run.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Asked:
    """A command that asks a study of a kind, and shows and saves its answer. Its flags are the study's keys."""

    kind: str
    """Of the study."""
    help: str
    example: str
    """The last line of its help."""
    arguments: Mapping[str, tuple[str, str]] | None = None
    """Keys that are arguments, in order -> (metavar, help); by default the robot's file."""
    flags: Mapping[str, str] = field(default_factory=dict)
    """Keys whose flag is not their name -> the flag, or several with "/" or "," between."""
    defaults: Mapping[str, str] = field(default_factory=dict)
    """Keys whose default on the command line is not that of a study, as they would be typed."""
    from_file: bool = False
    """The study is read from a file, whose keys the flags override."""


ROBOT = ("ROBOT.yaml", "Robot file.")
"""Metavar and help of the robot as an argument."""

RIG = ("RIG.yaml", "Rig file.")

PATH = (
    "Waypoints, with the columns rotation_1_deg, rotation_2_deg, ... in deg and, where tubes slide, translation_1_mm, "
    "... in mm; a row per waypoint."
)

LOG = (
    "time_s, duty, and any of temperature_degC, voltage_V, current_A; or trials: duty, time_s, ramp_s, and result or "
    "spring_back_percent."
)

TRAJECTORY = "Columns time_s, rotation_1_deg, ... and, where tubes slide, translation_1_mm, ..."

CHARGES = "100,90,80,70,60"
"""States of charge, percent, for which a command writes tables."""

COMMANDS: dict[str, Asked | str] = {
    "fk": Asked(
        "forward_kinematics",
        "Forward kinematics: the stable shape at given joint values, with its margin to snapping.",
        flags={"tolerance_rad": "--tolerance-rad,--tolerance"},
        example="tubeopt fk configs/robots/thesis_ctr.yaml --rotations-deg 0,57.3,114.6 --translations-mm 0,0,0",
    ),
    "ik": Asked(
        "inverse_kinematics",
        """Inverse kinematics: stable joint values that bring the tip to a target, and point it there.

        Ends with 3 where the target, or every one of a table, is missed, with --closest as well; misses within a table
        are named in it. With --follow, targets are put between those of the table where the robot would leap.""",
        flags={"start": "--from"},
        example="tubeopt ik configs/robots/thesis_ctr.yaml --target-mm 50,30,150 --all --out results",
    ),
    "equilibria": Asked(
        "equilibria",
        "Every equilibrium at given joint values, stable and unstable, the lowest energy first.",
        example="tubeopt equilibria configs/robots/two_tube.yaml --rotations-deg 190,0",
    ),
    "snap": Asked(
        "snap",
        "The first snap on the straight way from one set of joint values to another, computed exactly.",
        example="tubeopt snap configs/robots/thesis_ctr.yaml --to-deg 360,0,0 --out results",
    ),
    "follow": Asked(
        "follow",
        "Slow motion through waypoints, with its history: where the robot snaps and where it lands.",
        arguments={"robot": ROBOT, "path": ("PATH.csv", PATH)},
        example="tubeopt follow configs/robots/thesis_ctr.yaml configs/paths/turn_and_back.csv",
    ),
    "load-limit": Asked(
        "load_limit",
        "How many times a load the robot bears before it snaps or buckles, computed exactly, and where it lands.",
        example="tubeopt load-limit configs/robots/thesis_ctr.yaml --from-deg 0,0,0 --rotations-deg 200,0,0 "
        "--tip-force-mN=-10,0,0",
    ),
    "force": Asked(
        "force",
        "The force on the tip in every row of a recording, how sure it is, and what cannot be told.",
        arguments={"robot": ROBOT, "measurements": ("MEASURED.csv", "Measured positions of the arm.")},
        example="tubeopt force configs/robots/thesis_ctr.yaml configs/experiments/synthetic_forces.csv --noise-mm 0.1",
    ),
    "certify": Asked(
        "certify",
        """Whether the robot can snap at any rotation: what is proved, and what search finds.

        Ends with 0 if it cannot snap, 3 if it can, 4 if neither is known; with a box, at the translations of its least
        certificate that was found. With a force, 0 is only for what is proved under it.""",
        example="tubeopt certify configs/robots/crl_ctr.yaml --translations-mm -20,0,0",
    ),
    "stability-map": Asked(
        "stability_map",
        "The margin over the rotations of two tubes turned together from home, and where the robot snaps.",
        example="tubeopt stability-map configs/robots/crl_ctr.yaml --out results",
    ),
    "run": "studies.run",
    "validate": Asked(
        "validation",
        "Measured tips against the model: errors, residuals, and a calibrated robot.",
        arguments={"robot": ROBOT, "measurements": ("MEASURED.csv", "Measured tips.")},
        example="tubeopt validate configs/robots/thesis_etr.yaml configs/experiments/synthetic_etr.csv --fit curvature",
    ),
    "measure": Asked(
        "measure",
        "Where to measure: configurations that determine parameters best, and a way through them without a snap.",
        example="tubeopt measure configs/robots/crl_ctr.yaml --fit rotation_2,rotation_3,curvature_1 --count 12 "
        "--out results",
    ),
    "design": Asked(
        "design",
        "Design the tubes of a robot: what may change, what must hold and what is wanted stand in a file.",
        example="tubeopt design configs/studies/design_thesis_snap_free.yaml --out results",
        from_file=True,
    ),
    "design-pair": Asked(
        "design_pair",
        """Design two robots together, so that both tips hold as many pairs of places of a region as can be found.

        What may change, what must hold, where the plates stand and the region stand in a file.""",
        example="tubeopt design-pair configs/studies/design_pair.yaml --out results",
        from_file=True,
    ),
    "sweep": "studies.sweep",
    "workspace": Asked(
        "workspace",
        """Where the tip reaches within the robot's limits: volume, directions, margin, and the part lost to snapping.

        With --out the samples are saved as they come, so that memory does not grow with them, and a run that was
        stopped goes on.""",
        example="tubeopt workspace configs/robots/crl_ctr.yaml --samples 20000 --out results",
    ),
    "fabricate": Asked(
        "fabrication",
        """Molds and schedules for every tube of a robot: drawings, G-code, duties by the battery's voltage, pictures.

        The mold is drawn for the rig, and the heating planned on the rig with the mold as drawn. Ends with 3 where the
        window is not held within limit, ramp and currents for one of them, where fewer than half of uncertain rigs
        keep it and no sensor closes the loop, or where mold and heating do not agree; everything is shown and saved all
        the same.""",
        defaults={"charges_percent": CHARGES},
        example="tubeopt fabricate configs/robots/thesis_etr.yaml --rig configs/rigs/thesis_calcium_silicate.yaml "
        "--sensor thermocouple --out results",
    ),
    "heat plan": Asked(
        "heating",
        """The heating schedule that holds the curved part of a tube in the window: duties, temperatures, files.

        Ends with 3 where no schedule is found that holds the window within limit, ramp and currents, or where fewer
        than half of uncertain rigs keep it and no sensor closes the loop; the best schedule and what would help are
        shown and saved all the same.""",
        arguments={"rig": RIG},
        defaults={"charges_percent": CHARGES},
        example="tubeopt heat plan configs/rigs/thesis_calcium_silicate.yaml --sensor thermocouple --out results",
    ),
    "heat firmware": Asked(
        "led_heating",
        """A heating that a sensor leads: the law, how likely uncertain rigs keep the window, and the sketch for a
        board.

        The schedule is that of `tubeopt heat plan`; the law corrects it by what the sensor reads; its gains follow from
        the model. Ends with 3 where the schedule does not keep window, limit, ramp and currents on the rig as filed, or
        most uncertain rigs do not keep the window; everything is shown and saved all the same.""",
        arguments={"rig": RIG},
        defaults={"objective": "margin"},
        example="tubeopt heat firmware configs/rigs/thesis_calcium_silicate.yaml --board uno --out results",
    ),
    "heat run": "heat.run",
    "heat calibrate": Asked(
        "heating_calibration",
        "Loss and contacts of a rig from a logged heating, or from trials without a thermometer.",
        arguments={"log": ("LOG.csv", LOG)},
        example="tubeopt heat calibrate configs/experiments/heating_log.csv "
        "--rig configs/rigs/thesis_calcium_silicate.yaml --out results",
    ),
    "view": "view.view",
    "plan": Asked(
        "plan",
        """Plan a motion that stays on one stable branch, around obstacles and within rates, and prove it.

        Ends with 0 if it is proved, 3 where none was found, and 4 where one was found, shown and saved, but the time
        limit was reached before its proof was finished.""",
        example="tubeopt plan configs/studies/plan_thesis_turn.yaml --out results",
        from_file=True,
    ),
    "plan-arms": Asked(
        "plan_arms",
        """Plan motions of several robots beside each other, none of which snaps or touches another, and prove them.

        Ends with 0 if they are proved, 3 where none were found, and 4 where some were found, shown and saved, but are
        not proved.""",
        example="tubeopt plan-arms configs/studies/plan_two_arms.yaml --out results",
        from_file=True,
    ),
    "verify": Asked(
        "verify",
        "Follow a trajectory, of whatever origin, and say whether it snaps, collides or is too fast. "
        "Ends with 3 if so.",
        arguments={"trajectory": ("TRAJECTORY.csv", TRAJECTORY)},
        example="tubeopt verify results/trajectory.csv --min-margin 0.05",
    ),
    "export": "export.export",
    "serve": "serve.serve",
    "doctor": "doctor.doctor",
    "mold plan": Asked(
        "mold_plan",
        "The mold for the tubes of a robot: DXF, SVG, STL, G-code and a set-up sheet.",
        example="tubeopt mold plan configs/robots/thesis_etr.yaml --out results",
    ),
    "mold mandrel": Asked(
        "mandrel",
        "The mandrel for a helix or another space curve: STL, table of rotation and feed, G-code for a 4th axis.",
        example="tubeopt mold mandrel configs/robots/example_pieces.yaml --tube 1 --out results",
    ),
    "mold pegs": Asked(
        "pegs",
        "An adjustable mold: where pegs go on a board that is drilled once; table, DXF, SVG, G-code of the board.",
        example="tubeopt mold pegs configs/robots/thesis_etr.yaml --out results",
    ),
    "mold calibrate": Asked(
        "mold_calibration",
        "Spring-back from trials: how much of the mold's curvature tubes lose.",
        arguments={"trials": ("TRIALS.csv", "Columns mold_radius_mm and obtained_radius_mm.")},
        example="tubeopt mold calibrate configs/molds/example_trials.csv --out results",
    ),
    "mold materials": Asked(
        "mold_materials",
        "Mold materials for a tube, best first: heat drawn, limit temperature, current that leaks, and why.",
        arguments={"robot": ("[ROBOT.yaml]", "Robot whose tube it is.")},
        example="tubeopt mold materials configs/robots/thesis_ctr.yaml --tube 1",
    ),
    "robot list": "robot.list_robots",
    "robot show": "robot.show",
    "list": "robot.list_files",
}
"""What is typed after `tubeopt` -> the study that it asks, or the module of this package and function that it runs."""


def flowing(documentation: str) -> str:
    """A docstring whose paragraphs are a line each, which the terminal breaks where it is full."""
    return re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.cleandoc(documentation))

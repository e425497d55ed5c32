"""The commands of `tubeopt`, each with its study or its function.

Most commands run a study, show its answer and save it; such a command is one row here. A row imports nothing before its
command runs.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class StudyCommand:
    """Command that runs a study of a kind, and shows and saves its answer. Its flags are the study's keys."""

    kind: str
    """Kind of the study."""
    help: str
    example: str
    """Example in the last line of the help."""
    arguments: Mapping[str, tuple[str, str]] | None = None
    """Keys that are arguments, in order -> (metavar, help); by default the robot file."""
    flags: Mapping[str, str] = field(default_factory=dict)
    """Keys with a flag of another name -> flag, or several flags separated by "/" or ","."""
    defaults: Mapping[str, str] = field(default_factory=dict)
    """Keys with another default on the command line than in a study -> this default, as text."""
    from_file: bool = False
    """True if the study is read from a file; flags override its keys."""
    pictures: bool = True
    """True if the answer has plots."""


ROBOT = ("ROBOT.yaml", "Robot file, or the name of a built-in robot such as thesis_ctr.")
"""Metavar and help of the robot as an argument."""

OVEN = ("OVEN.yaml", "Oven file, or the name of a built-in oven such as steel_slab.")

RIG = ("RIG.yaml", "Rig file, or the name of a built-in rig such as thesis_steel.")

PATH = (
    "Waypoints, one per row: columns rotation_1_deg, rotation_2_deg, ... and, if tubes translate, translation_1_mm, ..."
)

LOG = "Log: columns time_s, duty and any of temperature_degC, voltage_V, current_A."

TRAJECTORY = "Trajectory: columns time_s, rotation_1_deg, ... and, if tubes translate, translation_1_mm, ..."

CHARGES = "100,90,80,70,60"
"""States of charge, percent, for the tables of a command."""

COMMANDS: dict[str, StudyCommand | str] = {
    "fk": StudyCommand(
        "forward_kinematics",
        "Forward kinematics: compute the stable shape at given joint values, and its stability margin.",
        flags={"tolerance_rad": "--tolerance-rad,--tolerance"},
        example="tubeopt fk thesis_ctr --rotations-deg 0,57.3,114.6 --translations-mm 0,0,0",
    ),
    "ik": StudyCommand(
        "inverse_kinematics",
        """Inverse kinematics: find stable joint values for a position and direction of the tip.

        Give one target (--target-mm) or a table (--targets). With --follow, targets are inserted between two targets of
        the table if the robot would jump to another branch. Exit code 3: no target was reached; the output names every
        missed target.""",
        flags={"start": "--from"},
        example="tubeopt ik thesis_ctr --target-mm 50,30,150 --all --out results",
    ),
    "equilibria": StudyCommand(
        "equilibria",
        "Find all equilibria at given joint values, stable and unstable, lowest energy first.",
        example="tubeopt equilibria two_tube --rotations-deg 190,0",
    ),
    "snap": StudyCommand(
        "snap",
        "Find the first snap on the straight joint path between two configurations, and the jump of the tip.",
        example="tubeopt snap thesis_ctr --to-deg 360,0,0 --out results",
    ),
    "follow": StudyCommand(
        "follow",
        "Simulate slow motion through waypoints, with history: snaps, and the equilibria after them.",
        arguments={"robot": ROBOT, "path": ("PATH.csv", PATH)},
        example="tubeopt follow thesis_ctr turn_and_back",
    ),
    "drives": StudyCommand(
        "drives",
        """Size the drives: largest torque, force and power of every drive, along a motion or over the workspace.

        With --along the motion has waypoints, or times too, as a plan has; then the powers are known.""",
        example="tubeopt drives thesis_ctr --along turn_and_back --out results",
    ),
    "fatigue": StudyCommand(
        "fatigue",
        """Count the strain cycles of the tubes along a repeated motion, and estimate their life.

        A motion that does not end where it begins is repeated forth and back. The tubes must be concentric, without
        slots.""",
        arguments={"robot": ROBOT, "along": ("MOTION.csv", PATH)},
        example="tubeopt fatigue thesis_ctr turn_and_back --out results",
    ),
    "load-limit": StudyCommand(
        "load_limit",
        "Find the load factor at which the robot snaps or buckles, and the equilibrium after it.",
        example="tubeopt load-limit thesis_ctr --from-deg 0,0,0 --rotations-deg 200,0,0 --tip-force-mN=-10,0,0",
    ),
    "force": StudyCommand(
        "force",
        """Estimate the tip force in every row of a recording, with its uncertainty and undetermined directions.

        Load flags give known loads, such as the weight; the estimate is the tip force in addition to them.""",
        arguments={
            "robot": ROBOT,
            "measurements": ("MEASURED.csv", "Measured positions of the arm and joint readings (CSV or YAML)."),
        },
        example="tubeopt force thesis_ctr synthetic_forces --noise-mm 0.1",
        pictures=False,
    ),
    "certify": StudyCommand(
        "certify",
        """Prove for all rotations that the robot cannot snap, or search for a snap.

        Exit code 0: proved that it cannot snap. 3: a snap was found. 4: undecided. With --box, the search runs at the
        translations with the smallest certificate found. With --max-tip-force-mN, exit code 0 means proved under that
        force.""",
        example="tubeopt certify crl_ctr --translations-mm -20,0,0",
    ),
    "stability-map": StudyCommand(
        "stability_map",
        "Map the margin over the rotations of two tubes, started at home, and the snap boundary.",
        example="tubeopt stability-map crl_ctr --out results",
    ),
    "run": "studies.run",
    "validate": StudyCommand(
        "validation",
        "Compare the model with measured tips, and calibrate it: errors, residuals, fitted parameters.",
        arguments={
            "robot": ROBOT,
            "measurements": ("MEASURED.csv", "Measured tip positions and joint readings (CSV or YAML)."),
        },
        example="tubeopt validate thesis_etr synthetic_etr --fit curvature",
    ),
    "measure": StudyCommand(
        "measure",
        "Choose the configurations to measure that determine parameters best, and a snap-free path through them.",
        example="tubeopt measure crl_ctr --fit rotation_2,rotation_3,curvature_1 --count 12 --out results",
        pictures=False,
    ),
    "commission": StudyCommand(
        "commission",
        """Calibrate a robot from logs of its drives and a tracker: from logs to a servo in one command.

        It finds units, directions and zeros of all columns, the latency, and the effects that explain the errors. It
        saves the calibrated robot, what to measure next, the servo in C, and a page to print. Exit code 2: a column
        has two possible meanings; --answer decides. 3: no reading explains the tips.""",
        arguments={
            "robot": ROBOT,
            "logs": (
                "LOG...",
                "Logs, one for each recording, or two for joints and positions: CSV, tracker export, or YAML map.",
            ),
        },
        example="tubeopt commission braunschweig_pair commission_log --out results",
    ),
    "design": StudyCommand(
        "design",
        "Optimise tube dimensions. Free parameters, constraints and objective come from a study file.",
        example="tubeopt design design_thesis_snap_free --out results",
        from_file=True,
    ),
    "design-pair": StudyCommand(
        "design_pair",
        """Optimise two robots together for the number of point pairs of a region that both tips reach.

        Free parameters, constraints, base poses and region come from a study file.""",
        example="tubeopt design-pair design_pair --out results",
        from_file=True,
    ),
    "figure": "studies.figure",
    "sweep": "studies.sweep",
    "workspace": StudyCommand(
        "workspace",
        """Compute the workspace within the joint limits: volume, directions, margin, and the part lost to snapping.

        With --out, samples are saved during the run, memory stays constant, and an interrupted run resumes.""",
        example="tubeopt workspace crl_ctr --samples 20000 --out results",
    ),
    "fabricate": StudyCommand(
        "fabrication",
        """Prepare molds and heating for every tube of a robot: drawings, G-code, schedules, firmware, sheets.

        Molds are drawn for the rig, and the heating is planned with these molds. Exit code 3: a tube violates
        window, limit, ramp or current limits, or too few random rigs succeed: less than 95 % with a sensor, less than
        half without one. Also if mold and heating do not match. All results are still shown and saved.""",
        defaults={"charges_percent": CHARGES},
        example="tubeopt fabricate thesis_etr --rig thesis_calcium_silicate --board uno --out results",
    ),
    "heat plan": StudyCommand(
        "heating",
        """Plan the duty cycle over time that heats the curved part of a tube into its temperature window.

        Exit code 3: no plan satisfies window, limit, ramp and current limits, or fewer than half of the random rigs
        succeed without a sensor. The best plan and possible remedies are still shown and saved.""",
        arguments={"rig": RIG},
        defaults={"charges_percent": CHARGES},
        example="tubeopt heat plan thesis_calcium_silicate --sensor thermocouple --out results",
    ),
    "heat oven": StudyCommand(
        "oven",
        """Plan shape setting in an oven, a furnace or a salt bath: soak time, quench, and radius of the cold tube.

        Exit code 3: no soak time keeps the curved part of the tube in its window for the hold time; the output names
        the reason.""",
        arguments={"oven": OVEN},
        example="tubeopt heat oven steel_slab --hold-s 600 --out results",
    ),
    "heat firmware": StudyCommand(
        "led_heating",
        """Design closed-loop heating: controller gains, success probability on random rigs, and firmware for a board.

        The plan is that of `tubeopt heat plan`; the controller corrects the duty cycle from the sensor reading. Exit
        code 3: the plan violates window, limit, ramp or current limits, or most random rigs leave the window. All
        results are still shown and saved.""",
        arguments={"rig": RIG},
        defaults={"objective": "margin"},
        example="tubeopt heat firmware thesis_calcium_silicate --board uno --out results",
    ),
    "heat run": "studies.run_heating",
    "heat calibrate": StudyCommand(
        "heating_calibration",
        "Estimate heat loss and contacts of a rig from a heating log.",
        arguments={"log": ("LOG.csv", LOG)},
        example="tubeopt heat calibrate heating_log --rig thesis_calcium_silicate --out results",
    ),
    "view": "view.view",
    "plan": StudyCommand(
        "plan",
        """Plan a snap-free trajectory around obstacles and within rate limits, and prove it.

        Exit code 0: proved. 3: no trajectory found. 4: a trajectory was found and saved, but its proof did not finish
        within the time limit.""",
        example="tubeopt plan plan_thesis_turn --out results",
        from_file=True,
    ),
    "deploy": StudyCommand(
        "deploy",
        """Lead the tip along a path through a lumen that the arm touches, with contact forces below a limit.

        Exit code 3: the tip did not reach the end of the path; the motion up to there is saved.""",
        example="tubeopt deploy thesis_ctr --walls bent_vessel --out results",
    ),
    "plan-arms": StudyCommand(
        "plan_arms",
        """Plan snap-free trajectories of several robots that do not touch each other, and prove them.

        Exit code 0: proved. 3: no trajectories found. 4: trajectories were found and saved, but not proved.""",
        example="tubeopt plan-arms plan_two_arms --out results",
        from_file=True,
    ),
    "verify": StudyCommand(
        "verify",
        "Check any trajectory for snaps, collisions and excessive speed. Exit code 3: a check failed.",
        arguments={"trajectory": ("TRAJECTORY.csv", TRAJECTORY)},
        example="tubeopt verify results/trajectory.csv --min-margin 0.05",
    ),
    "export": "control.export",
    "serve": "control.serve",
    "doctor": "information.doctor",
    "mold plan": StudyCommand(
        "mold_plan",
        "Design a mold for the tubes of a robot: DXF, SVG, STL, G-code and a set-up sheet.",
        example="tubeopt mold plan thesis_etr --out results",
    ),
    "mold mandrel": StudyCommand(
        "mandrel",
        "Design a mandrel for a helix or another space curve: STL, rotation and feed table, G-code for a 4th axis.",
        example="tubeopt mold mandrel example_pieces --tube 1 --out results",
    ),
    "mold calibrate": StudyCommand(
        "mold_calibration",
        "Estimate spring-back from trials: the fraction of the mold's curvature that tubes lose.",
        arguments={
            "trials": (
                "TRIALS.csv",
                "Trials, one per row: columns mold_radius_mm, obtained_radius_mm and, if known, obtained_error_mm "
                "(standard error).",
            )
        },
        example="tubeopt mold calibrate example_trials --out results",
    ),
    "mold measure": StudyCommand(
        "tube_photo",
        """Measure the radius of a tube in a scan or photo, with its 95 % interval.

        A scan has its scale from its resolution. Take a photo on the sheet of `tubeopt mold sheet`, with all four
        marks in it: they also correct the tilt. With --mold-radius-mm and --out, the result is added to trials.csv for
        `tubeopt mold calibrate`.""",
        arguments={"photo": ("PHOTO", "Scan or photo: PNG, JPEG or TIFF.")},
        example="tubeopt mold measure scan.png --mold-radius-mm 60 --out results",
    ),
    "mold sheet": "sheet.sheet",
    "mold materials": StudyCommand(
        "mold_materials",
        "Rank mold materials for a tube: heat loss, limit temperature, leakage current, and reasons.",
        arguments={"robot": ("[ROBOT.yaml]", "Robot file with the tube; default a tube with the given sizes.")},
        example="tubeopt mold materials thesis_ctr --tube 1",
    ),
    "init robot": "init.robot",
    "init rig": "init.rig",
    "init study": "init.study",
    "robot list": "information.list_robots",
    "robot show": "information.show",
    "list": "information.list_files",
}
"""Words after `tubeopt` -> study command, or module of this package and function, as "studies.run"."""


def flowing(documentation: str) -> str:
    """Join the lines of each paragraph of a docstring; the terminal wraps them."""
    return re.sub(r"(?<!\n)\n(?!\n)", " ", inspect.cleandoc(documentation))

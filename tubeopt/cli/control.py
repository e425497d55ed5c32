"""`tubeopt export` and `serve`: a robot as a C library, or over WebSocket with CRTK commands."""

from __future__ import annotations

import asyncio
import json
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Annotated, Self

from pydantic import Field, model_validator

from ..control.c_binding import servo_of
from ..control.c_library import c_library, save_c_library
from ..control.command import ServoOptions
from ..control.crtk import CrtkRobot
from ..control.server import HOST, RobotServer, ServerOptions, check_installed
from ..files.checked import Entry, Positive
from ..files.field_metadata import Typical
from ..files.fields import keys_from, values
from ..runs.real_robot import check_confidence
from ..runs.robot_keys import Posed, RobotPath, rewording_joints
from ..runs.surroundings_file import Bodies
from ..show.command_report import Served
from ..show.reports import report
from ..validation.floor import servo_floor
from .flags import study_command
from .interruption import handling_interruption
from .output import OF_PICTURES, Output, can_be_saved, present, print_address

# --- floor of the servo -----------------------------------------------------------------------------------------------


FLOORS = ("min_margin", "min_snap_distance")
"""Fields of `ServoOptions` that are floors."""


class Floored(Entry):
    """Floor of a servo, raised for the real robot."""

    robot: RobotPath
    confidence: Positive | None = Field(
        None,
        gt=0.5,
        lt=1,
        description="raise min_snap_distance so that the real robot keeps it at this probability, estimated from the "
        "posterior of its file; default not raised",
        examples=["P"],
    )

    @model_validator(mode="after")
    def _is_known(self) -> Self:
        check_confidence(self.confidence, self.robot)
        if self.confidence is not None and getattr(self, "min_snap_distance_deg", None) is None:
            raise ValueError("gives confidence without min_snap_distance_deg; the margin is no distance to a snap")
        return self

    def raised(self, options: ServoOptions) -> ServoOptions:
        """Options with the floor of the calibrated robot with which the real one keeps theirs."""
        confidence = self.si("confidence")
        if confidence is None:
            return options
        assert options.min_snap_distance is not None
        floor = servo_floor(self.robot, options.min_snap_distance, confidence=confidence)
        return replace(options, min_snap_distance=floor)


# --- C library --------------------------------------------------------------------------------------------------------


@keys_from(c_library, "prefix", "loads")
@keys_from(ServoOptions, *FLOORS)
class ExportEntry(Floored):
    """Robot to export as a C library."""

    c: str = Field(description="directory to write the C library to", examples=["DIR"])


@study_command(
    ExportEntry,
    example="tubeopt export thesis_ctr --c thesis_in_c",
    note="Build and test it: cmake -B build -S thesis_in_c && cmake --build build && ctest --test-dir build",
    without=OF_PICTURES,
)
def export(study: ExportEntry, output: Output, robot: str) -> None:
    """Write a C99 library of the robot: forward kinematics, derivatives, margin, compliance, servo, snap guard.

    It allocates no memory, has no global state, and every call takes bounded time. It supports up to six tubes,
    concentric, eccentric or a bundle. --loads adds loads for concentric robots. The header has the floors of margin and
    snap distance as constants; --confidence raises them for the real robot.
    """
    folder = Path(study.c)
    can_be_saved(output.out)
    can_be_saved(folder)
    options = study.raised(ServoOptions(**values(ServoOptions, study, *FLOORS)))
    more = values(c_library, study, "prefix", "loads")
    library = c_library(study.robot, name=Path(robot).stem, options=options, **more)
    present(report(library), output, written=save_c_library(library, folder))


# --- server -----------------------------------------------------------------------------------------------------------


SERVO = (
    "speed",
    "turn_rate",
    "shift_rate",
    "turn_acceleration",
    "shift_acceleration",
    "min_margin",
    "min_snap_distance",
    "clearance",
    "objective",
)
"""Fields of `ServoOptions` with a flag."""

SERVER = ("port", "period", "publish", "slicer_port")
"""Fields of `ServerOptions` with a flag; the token has its own."""


@keys_from(ServerOptions, *SERVER)
@keys_from(ServoOptions, *SERVO)
class ServeEntry(Posed, Floored):
    """Robot to serve, with its start and its limits."""

    obstacles: Bodies = Field(
        (),
        description="obstacles: a YAML file, or a list as [{centre_mm: [30, 0, 120], radius_mm: 8}]; default none",
        examples=["OBSTACLES.yaml"],
    )

    token: str | None = Field(
        None,
        min_length=1,
        description="password that clients must send; by default a new random one, which is printed",
        examples=["WORD"],
    )
    watchdog_s: Annotated[Positive, Typical(2e-3, 10.0)] = Field(
        Decimal("0.1"), description="time without a command after which the robot stops"
    )


@study_command(
    ServeEntry,
    example="tubeopt serve thesis_ctr --rotations-deg 0,57,115 --translations-mm -50,-30,-20",
    without=("out", *OF_PICTURES),
)
def serve(study: ServeEntry, output: Output) -> None:
    """Serve the robot over WebSocket on this machine, with CRTK commands (servo_cp, move_cp, servo_jp, ...).

    One commander moves the robot, any number of watchers see it, and a guard prevents snaps. All clients need the
    token. The robot stops if commands stop. With --slicer-port 3D Slicer shows and moves it by OpenIGTLink. Ctrl-C ends
    the server (exit code 0). --json prints an object in one line for each event: compiling, serving with address and
    token, commander, held, stopped. It needs the extra `control`.
    """
    robot, how = study.robot, ServerOptions(token=study.token or "", **values(ServerOptions, study, *SERVER))
    check_installed(slicer=how.slicer_port is not None)

    def _tell(event: str, message: str, **more: float) -> None:
        if output.as_json:
            print(json.dumps({"event": event, "words": message} | more), flush=True)
        elif not output.quiet and event in ("compiling", "stopped"):
            print(message, file=sys.stderr, flush=True)

    def _compiling() -> None:
        _tell("compiling", f"compiling {robot.name or 'the robot'} for this machine, unless it was served before")

    options = study.raised(ServoOptions(**values(ServoOptions, study, *SERVO)))
    with rewording_joints(start=("--rotations-deg", "--translations-mm")):
        servo = servo_of(robot, study.joints, obstacles=study.obstacles, options=options, building=_compiling)
    server = RobotServer(CrtkRobot(servo, watchdog=study.si("watchdog_s")), how, tell=_tell)

    def _ready() -> None:
        address = f"ws://{HOST}:{server.port}"
        print_address(Served(robot, address, robot.name or "robot", server.token), output, event="serving")

    # Ctrl-C is the usual end of a server: exit code 0.
    with handling_interruption(), suppress(KeyboardInterrupt):
        asyncio.run(_until_interrupted(server, _ready))
    pace, (took, _) = server.pace, server.pace.quantiles(0.999)
    missed = pace.missed / max(pace.steps + pace.missed, 1)
    _tell(
        "stopped",
        f"stopped after {pace.steps} steps: {missed:.2%} of the periods missed, "
        f"{took * 1e3:.2g} ms of the processor at 99.9 %",
        steps=pace.steps,
        missed_periods=pace.missed,
    )


async def _until_interrupted(server: RobotServer, ready: Callable[[], object]) -> None:
    """Serve until Ctrl-C, handled by the event loop: KeyboardInterrupt could end in a task that nothing awaits."""
    serving = asyncio.create_task(server.serve(ready))
    listens = signal.getsignal(signal.SIGINT) is not signal.SIG_IGN
    if listens and threading.current_thread() is threading.main_thread():
        with suppress(NotImplementedError):  # on Windows it is KeyboardInterrupt
            asyncio.get_running_loop().add_signal_handler(signal.SIGINT, serving.cancel)
    with suppress(asyncio.CancelledError):
        await serving

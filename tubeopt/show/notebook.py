"""Notebook display of results: a table and a picture, and arms in 3-D."""

from __future__ import annotations

import base64
import dataclasses
import io
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rich.console import Console, RenderableType

from ..design.optimize import DesignSolution
from ..display import brief
from ..equilibrium.batch import EquilibriumBatch
from ..equilibrium.result import Equilibrium, Jacobian, Verification
from ..errors import SolveError, import_extra, instance
from ..files.units import TO_MM
from ..inverse import InverseSolution
from ..planning import Proof
from ..robots.file import AnyRobot
from ..robots.tubes import Tube
from ..shaping import Mold
from ..shaping.heating.plan import HeatingPlan
from ..solvers.named_program import ProblemSolution
from ..stability import (
    Branch,
    Certificate,
    Drives,
    EnergyMap,
    Fatigue,
    LoadLimit,
    Snap,
    SnapAssessment,
    SnapInTime,
    StabilityMap,
    WorstCertificate,
    WorstMargin,
)
from ..validation.force import ForceEstimate
from ..workspaces import SnappingLoss, Workspace
from .drives_report import DRIVES, FATIGUE
from .equilibrium_report import TUBE, VERIFICATION
from .formatting import counted, degrees, millimetres
from .heat_report import PLAN
from .inverse_report import SOLUTION
from .plan_report import PROOF
from .quantities import Quantity, described, line, of_field, rows
from .report import Drawing, drawing, two_columns
from .reports import report
from .snap_report import FORCE, IN_TIME, LIMIT, SNAP
from .surfaces import Part, plate_part, plate_radius, robot_parts
from .workspace_report import LOSS

if TYPE_CHECKING:
    import plotly.graph_objects

WIDTH = 110
"""Characters in a line of a table."""

PICTURE_WIDTH = 640
"""Pixels across which a picture is shown at most."""


def shown(answer: Any) -> dict[str, Any]:
    """MIME type -> content of the display of an object, from one drawing."""
    table, draw = _display(answer)
    picture = _drawn(draw)
    page = {"text/html": _html(table(), picture, type(answer).__name__)}
    return page if picture is None else {**page, "image/png": picture}


def png(answer: Any) -> bytes | None:
    """Picture of an object as PNG; None without one."""
    return _drawn(_display(answer)[1])


def _drawn(draw: Drawing | None) -> bytes | None:
    return None if draw is None else draw()._repr_png_()


def _html(table: RenderableType, picture: bytes | None, name: str) -> str:
    """HTML of a table, with an optional picture below."""
    console = Console(record=True, file=io.StringIO(), width=WIDTH, force_jupyter=False)
    # Cropped at the width of a terminal, long rows would lose their end; the page scrolls.
    console.print(table, crop=False)
    frame = '<pre style="line-height:1.25;overflow-x:auto">{code}</pre>'
    html = console.export_html(inline_styles=True, code_format=frame).strip()
    if picture is None:
        return html
    style = f'alt="{name}" style="max-width:{PICTURE_WIDTH}px;width:100%"'
    return f'{html}\n<img {style} src="data:image/png;base64,{base64.b64encode(picture).decode()}">'


def _display(answer: Any) -> tuple[Callable[[], RenderableType], Drawing | None]:
    """Functions that make the table of an object and draw its picture, None without one."""
    name = type(answer).__name__
    try:
        reported = report(answer)
    except TypeError:
        summary = next((SUMMARIES[kind] for kind in type(answer).__mro__ if kind in SUMMARIES), None)
        if summary is None:
            return lambda: two_columns(f"{name} (SI)", _fields(answer)), None
        return lambda: two_columns(name, rows(answer, summary.quantities)), summary.picture(answer)
    if isinstance(answer, AnyRobot):
        return reported.table, _at_home(answer)
    # Names with a suffix are files of other kinds, such as a page, that a notebook cannot show.
    return reported.table, next((draw for picture, draw in reported.pictures().items() if "." not in picture), None)


def _fields(answer: Any) -> list[tuple[str, str]]:
    """Rows of an object without a list of quantities: its fields."""
    shown = ((field.name, getattr(answer, field.name)) for field in dataclasses.fields(answer) if field.repr)
    return [(name, brief(value)) for name, value in shown if value is not None]


def _at_home(robot: Any) -> Drawing | None:
    """Drawing of a robot at home; None if its equilibrium is not found."""
    from ..equilibrium.kinematics import forward_kinematics

    try:
        return drawing("shape.plot_shape", forward_kinematics(robot, np.zeros(robot.n_tubes)))
    except SolveError:
        return None


GHOST_OPACITY = 0.3
DIGITS = 3
"""Decimals of the coordinates, in mm: drawings in a notebook are small."""


def show_in_3d(
    equilibrium: Equilibrium, *, ghosts: Sequence[Equilibrium] = (), height: int = 480
) -> plotly.graph_objects.Figure:
    """Plotly scene of the robot on its plate, which is turned with the mouse.

    Args:
        ghosts: further shapes, drawn translucent.
        height: of the scene, pixels.

    Raises:
        InputError: plotly is not installed.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> pose = tubeopt.forward_kinematics(robot, [0.0, 1.0, 2.0])
        >>> figure = tubeopt.show_in_3d(pose, height=300)
        >>> figure.layout.height
        300
    """
    instance("equilibrium", equilibrium, Equilibrium)
    library = import_extra("plotly.graph_objects", "notebook", "scenes in a notebook")
    parts = [plate_part(plate_radius(equilibrium)), *robot_parts(equilibrium)]
    meshes = [_mesh(library, part, part.opacity) for part in parts]
    meshes += [_mesh(library, part, GHOST_OPACITY) for ghost in ghosts for part in robot_parts(ghost)]
    axes = {f"{axis}axis": {"title": {"text": f"{axis} (mm)"}} for axis in "xyz"}
    scene = {**axes, "aspectmode": "data"}
    name = equilibrium.robot.name or "robot"
    layout = {"scene": scene, "height": height, "margin": {"l": 0, "r": 0, "t": 30, "b": 0}, "title": {"text": name}}
    figure: plotly.graph_objects.Figure = library.Figure(meshes, layout)
    return figure


def _mesh(library: Any, part: Part, opacity: float) -> Any:
    # 1 um and four bytes: a scene is stored in the notebook as text.
    x, y, z = np.round(part.surface.vertices * TO_MM, DIGITS).astype(np.float32).T
    i, j, k = part.surface.faces.T
    colour = f"rgb{part.colour}"
    return library.Mesh3d(x=x, y=y, z=z, i=i, j=j, k=k, color=colour, opacity=opacity, name=part.name, hoverinfo="name")


class Summary(NamedTuple):
    """Display of an object without a report."""

    quantities: Sequence[Quantity[Any]]
    plot: str = ""
    """Function that draws it, as `drawing` takes it; "" for no picture."""
    drawn: Callable[[Any], Any] = lambda answer: answer
    """Object -> the drawn part of it; None for no picture."""

    def picture(self, answer: Any) -> Drawing | None:
        """Drawing of an object; None without a picture."""
        what = self.drawn(answer) if self.plot else None
        return None if what is None else drawing(self.plot, what)


def _counts(what: Any) -> str:
    failed = counted(len(what.failures), "failure", none="no failure")
    return f"{len(what)} configurations, {failed}"


def _least(margins: Any) -> str:
    return f"{np.nanmin(margins):.4f} to {np.nanmax(margins):.4f}"


CERTIFICATE = described(
    Certificate,
    of_field(Certificate, "margin", text=lambda c: f"{c.margin:.6g}, a lower bound of the margin at all rotations"),
    line("so that", lambda c: "no rotations make it snap" if c.snap_free else "nothing is proved"),
    "translations",
    line("limited by", lambda c: None if c.pair is None else f"tubes {c.pair[0] + 1} and {c.pair[1] + 1}"),
)

VERDICT: tuple[Quantity[SnapAssessment], ...] = (
    line("robot", lambda v: v.robot.name or "robot"),
    line("finding", lambda v: str(v.finding)),
    line("certificate", lambda v: f"{v.certificate.margin:.6g}"),
    line("least margin found", lambda v: "0, at a fold" if v.worst is None else f"{v.worst.margin:.4f}"),
    line("searched", lambda v: counted(v.paths, "path")),
)

WORST_MARGIN = described(
    WorstMargin,
    Quantity("margin", "smallest margin found", form=".6g", label="least margin found"),
    line("at", lambda w: degrees(w.equilibrium.rotations, ".6g")),
    "searches",
)

WORST_CERTIFICATE = described(
    WorstCertificate,
    line("least certificate", lambda w: f"{w.certificate.margin:.6g}"),
    line("at translations", lambda w: millimetres(w.certificate.translations, ".6g")),
    line("within", lambda w: f"{millimetres(w.lower, '.6g')} to {millimetres(w.upper, '.6g')}"),
    "evaluations",
)

STABILITY_MAP: tuple[Quantity[StabilityMap], ...] = (
    line("tubes that turn", lambda m: f"{m.tubes[0] + 1} and {m.tubes[1] + 1}"),
    line("points", lambda m: f"{len(m.angles)} x {len(m.angles)}"),
    line("margin", lambda m: _least(m.margin)),
    line("reached after a snap", lambda m: f"{100 * (m.snaps > 0).mean():.1f} % of the map"),
)

ENERGY_MAP: tuple[Quantity[EnergyMap], ...] = (
    line("tubes that turn", lambda m: f"{m.tubes[0] + 1} and {m.tubes[1] + 1}"),
    line("points", lambda m: " x ".join(map(str, m.energy.shape))),
    line("equilibria", lambda m: f"{len(m.equilibria)}, {sum(e.stable for e in m.equilibria)} of them stable"),
)

BRANCH: tuple[Quantity[Branch], ...] = (
    line("points", lambda b: str(len(b.fraction))),
    line("folds", lambda b: counted(len(b.folds), "fold", none="none")),
    line("margin", lambda b: _least(b.margin)),
)

WORKSPACE: tuple[Quantity[Workspace], ...] = (
    line("robot", lambda w: w.robot.name or "robot"),
    line("samples", _counts),
    line("chosen", lambda w: f"{w.method}, seed {w.seed}"),
    line("margin", lambda w: _least(w.table[:, -1])),
    line("tips from", lambda w: millimetres(np.nanmin(w.tip_position, axis=0), ".1f")),
    line("to", lambda w: millimetres(np.nanmax(w.tip_position, axis=0), ".1f")),
)

BATCH: tuple[Quantity[EquilibriumBatch], ...] = (
    line("robot", lambda b: b.robot.name or "robot"),
    line("solved", _counts),
    line("margin", lambda b: _least(b.margin)),
    line("largest error of a tip", lambda b: millimetres(np.nanmax(b.tip_error, keepdims=True), ".1e")),
)

JACOBIAN: tuple[Quantity[Jacobian], ...] = (
    line("by", lambda j: ", ".join(j.wrt)),
    line("position", lambda j: f"{j.position.shape[0]} x {j.position.shape[1]}, m per rad and m per m"),
    line("rotation", lambda j: f"{j.rotation.shape[0]} x {j.rotation.shape[1]}, rad per rad and rad per m"),
)

DESIGN: tuple[Quantity[DesignSolution], ...] = (
    line("robot", lambda s: s.robot.name or "robot"),
    line("status", lambda s: str(s.status)),
    line("certificate", lambda s: f"{s.certificate:.6f}, a lower bound of the margin at all rotations"),
    line("objectives", lambda s: ", ".join(f"{name} {value:.6g} (SI)" for name, value in s.objectives.items())),
    line(
        "dimensions", lambda s: "\n".join(f"{d.name}: {d.before:.6g} to {d.after:.6g} {d.unit}" for d in s.dimensions)
    ),
)

PROBLEM = described(
    ProblemSolution,
    line("status", lambda s: str(s.status)),
    "objective",
    line("values", lambda s: ", ".join(s.values)),
    line("violated", lambda s: ", ".join(str(violation) for violation in s.violations) or None),
    line("solved", lambda s: f"in {s.statistics.seconds:.2f} s, {s.statistics.iterations} iterations"),
)

MOLD: tuple[Quantity[Mold], ...] = (
    line("plate", lambda m: " x ".join(f"{extent:.4g}" for extent in np.multiply(m.size, 1e3)) + " mm"),
    line("grooves", lambda m: ", ".join(f"tube {groove.number}" for groove in m.grooves)),
    line("material", lambda m: m.spec.material.name),
    line("remarks", lambda m: "\n".join(m.remarks) or None),
)


SUMMARIES: Mapping[type, Summary] = {
    Branch: Summary(BRANCH, "maps.plot_branch"),
    Certificate: Summary(CERTIFICATE),
    DesignSolution: Summary(DESIGN, "shape.plot_shape", lambda s: next(iter(s.equilibria), None)),
    Drives: Summary(DRIVES, "drives.plot_drives"),
    EnergyMap: Summary(ENERGY_MAP, "maps.plot_energy_maps", lambda answer: [answer]),
    EquilibriumBatch: Summary(BATCH),
    Fatigue: Summary(FATIGUE, "drives.plot_fatigue"),
    ForceEstimate: Summary(FORCE, "shape.plot_shape", lambda f: f.equilibrium),
    HeatingPlan: Summary(PLAN, "heating.plot_heating"),
    InverseSolution: Summary(SOLUTION, "workspace.plot_inverse", lambda answer: [answer]),
    Jacobian: Summary(JACOBIAN),
    LoadLimit: Summary(LIMIT, "shape.plot_shape", lambda limit: limit.before),
    Mold: Summary(MOLD, "mold.plot_mold"),
    ProblemSolution: Summary(PROBLEM),
    Proof: Summary(PROOF),
    Snap: Summary(SNAP, "path.plot_snap"),
    SnapInTime: Summary(IN_TIME, "snap_in_time.plot_snap_in_time"),
    SnappingLoss: Summary(LOSS),
    StabilityMap: Summary(STABILITY_MAP, "maps.plot_stability_map"),
    Tube: Summary(TUBE),
    SnapAssessment: Summary(VERDICT, "path.plot_snap", lambda v: v.snap),
    Verification: Summary(VERIFICATION),
    Workspace: Summary(WORKSPACE, "workspace.plot_workspace"),
    WorstCertificate: Summary(WORST_CERTIFICATE),
    WorstMargin: Summary(WORST_MARGIN, "shape.plot_shape", lambda w: w.equilibrium),
}

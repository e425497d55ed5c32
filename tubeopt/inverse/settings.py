"""How inverse kinematics is asked in detail, and how hard joint values are searched for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from ..arguments import typed
from ..block.custom import CustomObjective, CustomRequirement
from ..display import Displayed
from ..errors import InputError, positive, whole
from ..files.field_metadata import NOT_NEGATIVE, POSITIVE, OneOf, Range, Typical, check_fields, check_size, unit

OBJECTIVES = ("nearest", "margin", "curvature")
"""What is best: joint values near a reference, the largest margin, the least int |u|^2 ds."""

METHODS = ("auto", "gauss_newton", "nlp")
"""How to solve: the fast path and the nonlinear program where it stalls, or one of them alone."""

TIME_LIMIT = 60.0
"""s, for one target: three times what `tubeopt ik` gives one by default."""


@typed
@dataclass(frozen=True)
class InverseOptions(Displayed):
    """Details of the question and of the search.

    Raises:
        InputError: a value that is not allowed.
    """

    objective: Annotated[
        str | None,
        OneOf(OBJECTIVES),
        "objective: nearest (to the start or reference), margin or curvature; "
        "default nearest with a start or reference, otherwise any answer",
    ] = None
    """Among the answers: "nearest" (to the reference), "margin" (largest), "curvature" (least int |u|^2 ds), or None:
    "nearest" where a start or a reference is given, else any answer."""
    direction_weight: Annotated[
        float | None,
        POSITIVE,
        "factor on half the squared difference of the unit vectors in the cost; by default the direction is exact",
    ] = None
    """None makes the direction a constraint. A number adds half the squared difference of the unit vectors to the
    objective, with that weight.
    """
    clearance: Annotated[
        float, unit("mm"), NOT_NEGATIVE, Typical(1e-5, 0.1), "smallest allowed distance between arm and obstacles"
    ] = 0.0
    """Smallest allowed distance between the surface of the arm and obstacles, m."""
    carriage_gap: float = 0.0
    """Least distance of neighbouring carriages, m."""
    section_length: float = 0.0
    """Smallest length that a tube protrudes from the next outer one, m."""
    method: Annotated[str, OneOf(METHODS), "solver: auto, gauss_newton or nlp"] = "auto"
    """"auto" (the fast path, and the nonlinear program where that stalls), "gauss_newton" or "nlp" alone."""
    starts: Annotated[int, Range(least=1), "largest number of starting configurations"] = 48
    steps: int = 30
    """Maximum number of steps from one start to the target; fewer give up sooner on targets out of reach."""
    distinct: float = 0.05
    """Answers of `all_solutions` differ somewhere along the arm by this share of its length."""
    time_limit: float = TIME_LIMIT
    """Time limit of the whole call for any method, s; computations in progress end early. `math.inf` sets none."""
    extra_cost: CustomObjective | None = None
    """Custom objective that is added to `objective`: an expression of the quantities of the pose, `q.poses[0]`, times
    its weight. Only the fast path supports it."""
    extra_constraints: tuple[CustomRequirement, ...] = ()
    """Custom requirements that every solution satisfies. Only the fast path supports them."""

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("carriage_gap", "section_length"):
            positive(name, getattr(self, name), zero=True)
            check_size(name, getattr(self, name), Typical(1e-6, 0.5), "mm")
        whole("steps", self.steps, 1)
        positive("distinct", self.distinct)
        if self.time_limit != math.inf:
            positive("time_limit", self.time_limit)
        if not isinstance(self.extra_constraints, (list, tuple)):
            raise InputError(
                f"extra_constraints is {self.extra_constraints!r}; it must be a sequence of CustomRequirement"
            )
        object.__setattr__(self, "extra_constraints", tuple(self.extra_constraints))
        if self.method == "nlp" and (self.extra_cost is not None or self.extra_constraints):
            raise InputError(
                "method 'nlp' does not support extra_cost and extra_constraints; use 'auto' or 'gauss_newton'"
            )


DEFAULT_OPTIONS = InverseOptions()

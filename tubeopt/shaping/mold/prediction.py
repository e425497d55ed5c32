"""What comes out of a mold: the tubes that its grooves set, after spring-back."""

from __future__ import annotations

import numpy as np

from ...errors import InputError, instance
from ...robots.tubes import Tube
from .mold import Mold
from .setting import tube_from_mold
from .springback import Springback


def predict_tube(mold: Mold, index: int | None = None, *, springback: Springback | None = None) -> Tube:
    """The tube that comes out of a groove: the reverse of `plan_mold`.

    Args:
        mold: the mold.
        index: of the groove, from 0; needed where there are several.
        springback: another than the mold was planned with.

    Raises:
        InputError: no such groove, several grooves and no index, or a tube tighter than it is thick.

    Examples:
        >>> import tubeopt
        >>> robot = tubeopt.load_robot("configs/robots/thesis_ctr.yaml")
        >>> mold = tubeopt.plan_mold(robot.tubes[0])
        >>> round(tubeopt.predict_tube(mold).curvature, 6)
        10.0
    """
    instance("mold", mold, Mold)
    count = len(mold.grooves)
    if index is not None and not isinstance(index, (int, np.integer)):
        raise InputError(f"index is {index!r}; it must be a whole number")
    if index is None and count > 1:
        raise InputError(f"the mold has {count} grooves; index must say which, 0 to {count - 1}")
    if index is not None and not 0 <= index < count:
        raise InputError(f"index is {index}; it must lie in 0 to {count - 1}")
    groove = mold.grooves[index or 0]
    return tube_from_mold(groove.held, springback or mold.spec.springback)


def predict_tubes(mold: Mold, *, springback: Springback | None = None) -> tuple[Tube, ...]:
    """The tubes that come out of all grooves, as `predict_tube`."""
    return tuple(predict_tube(mold, k, springback=springback) for k in range(len(mold.grooves)))

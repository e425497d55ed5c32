"""Picture of what two robots hold at the same time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...files.units import TO_MM
from ...planning import PairShare
from .style import FAINT, headed, new_figure, picture

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TICKS = 5
"""Places from one tick to the next."""


@picture
def plot_pair_shares(
    shares: tuple[PairShare, PairShare], *, names: tuple[str, str] = ("one", "other"), title: str = ""
) -> Figure:
    """How far two arms are apart with their tips at any two places, before and after; grey where one of them does not
    reach its place, or both places are the same.

    Args:
        shares: of the robots as given, and of the designs.
        names: of the arms.   title: heading; by default the share of pairs of places that is held.
    """
    figure = new_figure(7.2, 3.4)
    panels = figure.subplots(1, 2, sharey=True)
    most = 2 * TO_MM * max(shares[1].clearance, 1e-4)
    image = None
    for panel, one, when in zip(panels, shares, ("as given", "as designed"), strict=True):
        table = np.where(np.eye(len(one.apart), dtype=bool), np.nan, one.apart * TO_MM)
        panel.set_facecolor(FAINT)
        image = panel.imshow(table, vmin=0, vmax=most, cmap="RdBu")
        panel.set(title=f"{when}: {100 * one.share:.0f} % held", xlabel=f"place of the tip of {names[1]}")
        panel.set(xticks=range(0, len(table), TICKS), yticks=range(0, len(table), TICKS))
    panels[0].set_ylabel(f"place of the tip of {names[0]}")
    assert image is not None
    figure.colorbar(image, ax=panels, label="arms apart (mm)", extend="both")
    headed(figure, title or f"{names[0]} and {names[1]} with their tips at two places at the same time")
    return figure

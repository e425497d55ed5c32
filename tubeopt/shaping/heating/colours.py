"""Colours of the oxide on a heated tube, as a thermometer that is read afterwards.

Heat grows a thin oxide on nitinol, and light interferes in it: straw, purple, blue as it gets thicker. How thick it is
depends on temperature, time, surface and air, so that a table holds for one laboratory and one time; each says from
where it is.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
import scipy

from ...display import Displayed
from ...errors import InputError, choice
from ...files.marks import POSITIVE, REQUIRED, check_fields, key, unit
from ...robots.materials import ZERO_CELSIUS
from ...typing import Array

OTHER_TIME = 2.0
"""By which factor the time of a trial may differ from that of a colour in the table."""


@dataclass(frozen=True)
class Colour:
    """Temperatures at which a colour comes.

    Raises:
        InputError: a number is out of its range, or the range is empty.
    """

    name: Annotated[str, REQUIRED, "of the colour"] = ""
    low: Annotated[float, key("low_degC"), POSITIVE, REQUIRED, "least temperature of the tube for it"] = 1.0
    high: Annotated[float, key("high_degC"), POSITIVE, REQUIRED, "greatest"] = 2.0
    time: Annotated[
        float | None, unit("s"), POSITIVE, "for which the tube was as hot; left out where the source does not say"
    ] = None

    def __post_init__(self) -> None:
        check_fields(self, f"colour {self.name!r}")
        if not self.name or not self.low < self.high:
            raise InputError(
                f"colour {self.name!r} goes from {self.low - ZERO_CELSIUS:g} to {self.high - ZERO_CELSIUS:g} degC; it "
                "must have a name, and its least temperature must be below its greatest"
            )


@dataclass(frozen=True)
class ColourTable(Displayed):
    """Colours by temperature.

    Raises:
        InputError: no source, no colours, or two of one name.
    """

    source: Annotated[
        str, REQUIRED, "where the numbers are from: a publication, or trials of one's own with their date"
    ] = ""
    colours: Annotated[tuple[Colour, ...], REQUIRED, "of the oxide"] = field(default_factory=tuple)
    spread: Annotated[
        float, unit("K"), POSITIVE, "standard deviation of the ends of each range: surfaces, air and eyes differ"
    ] = 50.0

    def __post_init__(self) -> None:
        check_fields(self, "the table of colours")
        names = [colour.name for colour in self.colours]
        if not self.source.strip() or not names or len(set(names)) < len(names):
            raise InputError("a table of colours must say its source, and have colours of different names")

    def chance(self, name: str, temperature: Array, duration: float) -> Array:
        """Probability of a colour at temperatures, degC, after `duration` s.

        Raises:
            InputError: no such colour, or the table's time for it is another by more than `OTHER_TIME`.
        """
        choice("colour of a trial", name, [colour.name for colour in self.colours])
        one = next(colour for colour in self.colours if colour.name == name)
        if one.time is not None and not one.time / OTHER_TIME <= duration <= one.time * OTHER_TIME:
            raise InputError(
                f"the table of colours knows {name} after {one.time:g} s; a trial took {duration:g} s, and more than "
                f"{OTHER_TIME:g} times as long or short makes another colour"
            )
        below, above = (
            scipy.stats.norm.cdf((temperature + ZERO_CELSIUS - edge) / self.spread) for edge in (one.low, one.high)
        )
        return np.asarray(below - above)


NITINOL_COLOURS = ColourTable(
    source="a maker of nickel-titanium wire, as a rough correspondence that says no time (www.wgnietai.com, heat "
    "treatment temperature and colour); the thesis found purple and yellow on tubes that were set well within a minute "
    "(section 4.2.3)",
    colours=(
        Colour("light yellow", 473.15, 573.15),
        Colour("yellow", 573.15, 673.15),
        Colour("purple and yellow", 673.15, 823.15),
        Colour("purple", 673.15, 773.15),
        Colour("blue", 773.15, 873.15),
    ),
)
"""Colours of nitinol, wide: to be replaced by a table of one's own trials."""

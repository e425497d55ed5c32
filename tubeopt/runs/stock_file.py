"""Stock lists as YAML: sizes of tubes that can be bought."""

from __future__ import annotations

from os import PathLike
from typing import Literal

from pydantic import Field

from ..design import StockTube
from ..errors import InputError
from ..files.checked import Entry, check_kind
from ..files.fields import Part, asking, values
from ..files.yaml_file import load_yaml
from ..robots.file import MaterialChoice, material_of


@asking(StockTube)
class StockEntry(Part):
    """One size."""

    material: MaterialChoice = "nitinol"

    def build(self) -> StockTube:
        """The size in SI."""
        return StockTube(**values(StockTube, self), material=material_of(self.material))


class StockList(Entry):
    """Sizes of tubes that can be bought, each with its source."""

    kind: Literal["tubes"]
    tubes: list[StockEntry] = Field(min_length=1)


STOCK_KINDS: dict[str, type[StockList]] = {"tubes": StockList}
"""What the key `kind` of a stock list may say."""


def load_stock(path: str | PathLike[str]) -> tuple[StockTube, ...]:
    """The sizes in a stock list; raises InputError for what makes none: one line for every problem."""
    found = check_kind(STOCK_KINDS, load_yaml(path, "tubes"), path)
    sizes = tuple(entry.build() for entry in found.tubes)
    if len({size.name for size in sizes}) < len(sizes):
        raise InputError(f"{path}: a tube name is given twice; every size must have its own name")
    return sizes

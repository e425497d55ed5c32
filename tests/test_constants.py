"""The constants are those of CODATA and of the metre convention, and are written once."""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path

import pytest
import scipy.constants

from tubeopt import constants
from tubeopt.files import units

PACKAGE = Path(constants.__file__).parent
WRITTEN = re.compile(r"(?<![\d.])(9\.81|9\.8|9\.80665|273\.15|5\.67\d*e-0?8)(?![\d.])")
"""Numbers that are constants of nature wherever they stand."""


def test_the_constants_are_those_of_codata() -> None:
    assert scipy.constants.g == constants.GRAVITY
    assert scipy.constants.zero_Celsius == constants.ZERO_CELSIUS
    assert pytest.approx(scipy.constants.Stefan_Boltzmann, rel=1e-9) == constants.STEFAN_BOLTZMANN
    assert Decimal("273.15") == units.ZERO_CELSIUS


def test_no_other_module_writes_a_constant() -> None:
    sources = [path for path in PACKAGE.rglob("*") if path.suffix in {".py", ".c", ".cpp", ".h", ".ino", ".js"}]
    assert len(sources) > 300
    results = {}
    for path in sources:
        lines = path.read_text(encoding="utf-8").splitlines()
        # The size of a figure is no gravity.
        written = [line for line in lines if WRITTEN.search(line) and "new_figure" not in line]
        if written and path.name != "constants.py":
            results[path.relative_to(PACKAGE).as_posix()] = written
    assert not results

"""C texts of constants, tables, CasADi functions and files of this folder."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

HERE = Path(__file__).parent


def c_text(constants: Mapping[str, float], generated: ca.CodeGenerator | str, file: str) -> str:
    """C text of a kernel: constants, generated functions, a file of this folder and the files that it includes."""
    head = defined(constants) + (HERE / "elementary.c").read_text()
    functions = generated if isinstance(generated, str) else generated.dump()
    return f"{head}\n{functions}\n{with_included(HERE / file)}"


def side_by_side(of_one: str, of_each: str) -> str:
    """C text of two generated files: functions of one robot, and functions of robots side by side.

    Their numbers are of the type Real, which has no constants, conditions or truth values of C.
    """
    for pattern, by in (
        (r"=(-?\d[\d.e+-]*);", r"=REAL(\1);"),
        (r" : 0;", " : REAL(0.);"),
        (r"(_default_in\(casadi_int i\) \{\s*switch \(i\) \{\s*default: return) 0;", r"\1 REAL(0.);"),
        (r"=\((\w+<\w+)\);", r"=CHOOSE(\1, 1., 0.);"),
        (r"=\(!(\w+)\);", r"=1.-\1;"),
        (r"=\((\w+)\?(\w+):0\);", r"=CHOOSE(\1 != 0, \2, 0.);"),
    ):
        of_each = re.sub(pattern, by, of_each)
    return with_fresh_macros(of_one, f"#define casadi_real Real\n{of_each}")


def with_fresh_macros(first: str, second: str) -> str:
    """Text of two generated files: macros that the first defines are undefined before the second."""
    between = "".join(f"#undef {name}\n" for name in re.findall(r"#\s*define (\w+)", first))
    return f"{first}\n{between}{second}"


def private(functions: str) -> str:
    """C text of generated functions that cannot be called from outside: the compiler may put them in line."""
    return re.sub(r"^(CASADI_SYMBOL_EXPORT |(?=casadi_real casadi_))", "static ", functions, flags=re.MULTILINE)


def defined(constants: Mapping[str, float]) -> str:
    """C text of constants by name."""
    return "".join(f"#define {name} {value!r}\n" for name, value in constants.items())


def with_included(file: Path) -> str:
    """Text of a C file, with the files that it includes from its folder inserted."""
    text = file.read_text()
    while part := re.search(r'#include "(\w+\.c)"\n', text):
        text = text.replace(part[0], (file.parent / part[1]).read_text())
    return text


def numbers(values: ArrayLike) -> str:
    """C literals of an array by rows, exact to the last bit."""

    def literal(value: float) -> str:
        return repr(value) if np.isfinite(value) else "-INFINITY" if value < 0 else "INFINITY"

    return ", ".join(literal(float(value)) for value in np.ravel(np.asarray(values, dtype=float)))


def static_table(name: str, values: ArrayLike) -> str:
    """C text of one constant array."""
    return f"static const double {name}[] = {{{numbers(values)}}};"


def c_tables(tables: Mapping[str, ArrayLike]) -> str:
    """C text of constant arrays by name."""
    return "".join(f"{static_table(name, table)}\n" for name, table in tables.items())

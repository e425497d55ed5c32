"""What can be broken in a file of tubeopt/: one operator, constant, condition or call of Python, C or C++ at a time."""

from __future__ import annotations

import ast
import random
import re
from fnmatch import fnmatch
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]

AREAS = {
    "physics": ("physics/*.py",),
    "proofs": (
        *(f"planning/{name}.py" for name in (
            "branch", "loaded_branch", "sections", "loaded_sections", "clearance_bound", "arms", "proof",
            "trajectory_trace", "goals", "reach_fraction",
        )),
        *(f"stability/{name}.py" for name in (
            "certificate", "worst", "pair", "deflection", "eccentric_bound", "eccentric_certificate",
            "loaded_certificate", "stroke", "friction_band", "simplex", "verdict",
        )),
    ),
    "guards": ("control/servo.py", "robots/limits.py", "control/c/servo.c", "control/c/robot.c",
               "control/c/differences.c", "control/c/contacts.c", "control/c/seek.c"),
    "firmware": ("shaping/firmware/sketch/heater.cpp", "shaping/firmware/sketch/converter.h"),
    "units": ("files/units.py", "files/fields.py", "files/field_metadata.py", "robots/file.py", "robots/file.py",
              "shaping/heating/plan.py"),
}  # fmt: skip
"""What a fault would make wrong without a word -> its files in tubeopt/."""

SPEED_ONLY = {"maxsize", "cse", "strict", "stacklevel", "dtype", "out", "copy", "overwrite_a", "check_finite"}
"""Keywords that change no answer."""

PAIRS = (("min", "max"), ("fmin", "fmax"), ("mmin", "mmax"), ("minimum", "maximum"), ("argmin", "argmax"),
         ("sin", "cos"), ("floor", "ceil"), ("any", "all"), ("degrees", "radians"), ("horzcat", "vertcat"))  # fmt: skip
SWAPPED = {**dict(PAIRS), **{b: a for a, b in PAIRS}}
DROPPED = {"sqrt", "abs", "fabs", "absolute", "clip", "fabsf", "sqrtf"}
"""Functions that are exchanged for another one, and those of which the first argument is left."""

COMPARED = {"<": ("<=", ">"), "<=": ("<", ">="), ">": (">=", "<"), ">=": (">", "<="), "==": ("!=",), "!=": ("==",),
            "is not": ("is",), "is": ("is not",), "not in": ("in",), "in": ("not in",)}  # fmt: skip
COMPUTED = {"+": "-", "-": "+", "*": "/", "/": "*", "**": "*", "//": "/"}
SIGN = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Pow: "**", ast.FloorDiv: "//"}


class Mutant(NamedTuple):
    """A change of the text of a file: `old` at byte `start` becomes `new`, in `function`, "" in none."""

    file: str
    line: int
    start: int
    old: str
    new: str
    function: str

    def __str__(self) -> str:
        text = (" ".join(part.split())[:60] for part in (self.old, self.new))
        return f"{self.file}:{self.line}  {'  ->  '.join(text)}"


class Python(ast.NodeVisitor):
    """All mutants of a module of Python."""

    def __init__(self, file: str) -> None:
        self.file, self.text = file, (ROOT / "tubeopt" / file).read_bytes()
        self.starts = [0]
        for line in self.text.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))
        self.within: list[str] = []
        self.depth = 0
        self.found: list[Mutant] = []
        self.visit(ast.parse(self.text))

    def ends(self, node: ast.AST) -> tuple[int, int]:
        """Bytes at which a node begins and ends."""
        return (
            self.starts[node.lineno - 1] + node.col_offset,  # type: ignore[attr-defined]
            self.starts[node.end_lineno - 1] + node.end_col_offset,  # type: ignore[attr-defined]
        )

    def said(self, node: ast.AST) -> str:
        """The text of a node."""
        a, b = self.ends(node)
        return self.text[a:b].decode()

    def change(self, span: tuple[int, int], *news: str) -> None:
        """Enter mutants that have other texts from one byte to another."""
        old = self.text[slice(*span)].decode()
        line = self.text[: span[0]].count(b"\n") + 1
        function = ".".join(self.within) if self.depth else ""
        self.found += [Mutant(self.file, line, span[0], old, new, function) for new in news if new != old]

    def visit_FunctionDef(self, node: ast.FunctionDef) -> None:
        if node.name in ("__repr__", "__str__"):
            return
        for part in [*node.args.defaults, *filter(None, node.args.kw_defaults)]:  # no decorator, no type
            self.visit(part)
        self.within.append(node.name)
        self.depth += 1
        for part in node.body:
            self.visit(part)
        self.depth -= 1
        self.within.pop()

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self.within.append(node.name)
        for part in node.body:
            self.visit(part)
        self.within.pop()

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if isinstance(node.annotation, ast.Subscript) and self.said(node.annotation.value) == "Annotated":
            for mark in node.annotation.slice.elts[1:]:  # type: ignore[attr-defined]
                if isinstance(mark, ast.Name) and mark.id.isupper():
                    self.change(self.ends(mark), '""')  # a bound of a field: what is no mark is ignored
                elif isinstance(mark, ast.Call):
                    self.visit(mark)
        if node.value is not None:
            self.visit(node.value)

    def visit_If(self, node: ast.If) -> None:
        if self.said(node.test) == "TYPE_CHECKING":
            return
        self.change(self.ends(node.test), f"not ({self.said(node.test)})", "False")
        self.generic_visit(node)

    def visit_IfExp(self, node: ast.IfExp) -> None:
        self.change(self.ends(node.test), f"not ({self.said(node.test)})")
        self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> None:
        if node.exc is not None:
            self.change(self.ends(node), "pass")  # what it says stays

    def visit_JoinedStr(self, node: ast.JoinedStr) -> None:
        pass

    def visit_Return(self, node: ast.Return) -> None:
        value = node.value
        if isinstance(value, (ast.Compare, ast.BoolOp)) or (
            isinstance(value, ast.UnaryOp) and isinstance(value.op, ast.Not)
        ):
            self.change(self.ends(value), f"not ({self.said(value)})")
        if isinstance(value, ast.Constant) and isinstance(value.value, bool):
            self.change(self.ends(value), str(not value.value))
        self.generic_visit(node)

    def visit_Expr(self, node: ast.Expr) -> None:
        if isinstance(node.value, ast.Constant):
            return
        if isinstance(node.value, ast.Call):
            if re.match(r"(_?log|warn|tell|say|print|.*\b(warn|warning|info|debug)$)", self.said(node.value.func)):
                return
            self.change(self.ends(node), "pass")
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
        if name in SWAPPED:
            end = self.ends(node.func)[1]
            self.change((end - len(name), end), SWAPPED[name])
        if name in DROPPED and node.args:
            self.change(self.ends(node), f"({self.said(node.args[0])})")
        self.visit(node.func)
        for part in node.args:
            self.visit(part)
        for keyword in node.keywords:
            if keyword.arg not in SPEED_ONLY:
                self.visit(keyword.value)

    def visit_Compare(self, node: ast.Compare) -> None:
        for left, right in zip([node.left, *node.comparators], node.comparators, strict=False):
            a, b = self.ends(left)[1], self.ends(right)[0]
            between = re.search(rb"not\s+in|is\s+not|[<>=!]=|<|>|in|is", self.text[a:b])
            if between:
                span = a + between.start(), a + between.end()
                self.change(span, *COMPARED[" ".join(between[0].decode().split())])
        self.generic_visit(node)

    def visit_BinOp(self, node: ast.BinOp) -> None:
        text = (ast.JoinedStr, ast.List, ast.Tuple, ast.Starred)
        texts = [p for p in (node.left, node.right) if isinstance(p, text) or isinstance(getattr(p, "value", 0), str)]
        sign = SIGN.get(type(node.op))
        if sign and not texts:
            b, c = self.ends(node.left)[1], self.ends(node.right)[0]
            at = b + self.text[b:c].index(sign.encode())
            self.change((at, at + len(sign)), COMPUTED[sign])
            left, right = f"({self.said(node.left)})", f"({self.said(node.right)})"
            self.change(self.ends(node), left, *([right] if sign in "+*" else []))
        self.generic_visit(node)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        sign = SIGN.get(type(node.op))
        if sign and not isinstance(node.value, (ast.List, ast.ListComp, ast.JoinedStr)):
            a, b = self.ends(node.target)[1], self.ends(node.value)[0]
            at = a + self.text[a:b].index(sign.encode())
            self.change((at, at + len(sign)), COMPUTED[sign])
        self.generic_visit(node)

    def visit_BoolOp(self, node: ast.BoolOp) -> None:
        word, other = (b"and", "or") if isinstance(node.op, ast.And) else (b"or", "and")
        for left, right in zip(node.values, node.values[1:], strict=False):
            a, b = self.ends(left)[1], self.ends(right)[0]
            at = a + self.text[a:b].index(word)
            self.change((at, at + len(word)), other)
            self.change(self.ends(right), "True" if word == b"and" else "False")
        self.generic_visit(node)

    def visit_UnaryOp(self, node: ast.UnaryOp) -> None:
        if isinstance(node.op, (ast.Not, ast.USub)):
            self.change(self.ends(node), f"({self.said(node.operand)})")
        self.generic_visit(node)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        index = self.said(node.slice)
        if index in ("0", "-1"):
            self.change(self.ends(node.slice), "-1" if index == "0" else "0")
            self.visit(node.value)
        else:
            self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> None:
        self.change(self.ends(node), *numbers(node.value)) if type(node.value) in (int, float) else None


def numbers(value: float) -> tuple[str, ...]:
    """By what a number is replaced."""
    if isinstance(value, int):
        return {0: ("1",), 1: ("0", "2"), 2: ("1", "3")}.get(value, (str(value + 1), str(value - 1), str(2 * value)))
    return (repr(2 * value), repr(value / 2), repr(-value)) if value else ("1.0",)


C_CHANGES: tuple[tuple[str, tuple[str, ...]], ...] = (
    (r"(?<=[\w)\] ])<=(?= )", ("<", ">=")), (r"(?<= )<(?= )", ("<=", ">")), (r"(?<= )>=(?= )", (">", "<=")),
    (r"(?<= )>(?= )", (">=", "<")), (r"(?<= )==(?= )", ("!=",)), (r"(?<= )!=(?= )", ("==",)),
    (r"&&", ("||",)), (r"\|\|", ("&&",)), (r"(?<= )\+(?= )", ("-",)), (r"(?<= )-(?= )", ("+",)),
    (r"(?<= )\*(?= )", ("/",)), (r"(?<= )/(?= )", ("*",)), (r"\+=", ("-=",)), (r"-=", ("+=",)),
    (r"\bf?abs[fl]?(?=\()", ("",)), (r"\bsqrtf?(?=\()", ("",)),
    (r"\bfmax(?=\()", ("fmin",)), (r"\bfmin(?=\()", ("fmax",)),
    (r"\bsin(?=\()", ("cos",)), (r"\bcos(?=\()", ("sin",)), (r"!(?=[\w(])", ("",)),
    (r"\btrue\b", ("false",)), (r"\bfalse\b", ("true",)), (r"(?<=[(,= ])-(?=[\w(])", ("",)),
    (r"(?<=\bif \()(?=.)", ("0 && ", "1 || ")), (r"(?m)^ +\w+\([^;{}]*\);$", (";",)),
    (r"(?m)^ +[\w.\[\]]+ [-+*/]?= [^;{}]*;$", (";",)), (r"\+\+", ("--",)), (r"--", ("++",)), (r" % ", (" / ",)),
    (r"\b[A-Z][A-Z]+_?[A-Z_]*\b(?=[ ;),])", ("(2 * {})", "(1.05f * {})")),
    (r"(?<![\w.\"])\d+\.\d*f?(?!\w)|(?<![\w.\"])\d+e-?\d+(?!\w)", ("2 * {}", "0.5f * {}", "-{}")),
    (r"(?<![\w.\"%])\d+(?![\w.])", ("({} + 1)", "({} - 1)")),
)  # fmt: skip
"""What is changed in C and C++, and into what: names in capitals are limits that a header defines."""


def c_mutants(file: str) -> list[Mutant]:
    """All mutants of a file of C or C++: comments, texts, directives and names of states stay."""
    text = (ROOT / "tubeopt" / file).read_text(encoding="utf-8")
    blank = re.compile(r'/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"|^#[^\n]*', re.DOTALL | re.MULTILINE)
    bare = blank.sub(lambda results: re.sub(r"[^\n]", "\x01", results[0]), text)
    headers = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "tubeopt" / file).parent.glob("*.h"))
    states = set(re.findall(r"[A-Z_]+", " ".join(re.findall(r"enum[^{]*{([^}]*)", headers))))
    results = []
    for pattern, news in C_CHANGES:
        for match in re.finditer(pattern, bare):
            if match[0] in states:
                continue
            old, line = text[match.start() : match.end()], text.count("\n", 0, match.start()) + 1
            start = len(text[: match.start()].encode())
            results += [Mutant(file, line, start, old, new.format(old), "") for new in news if "\x01" not in match[0]]
    return results


def mutants_of(file: str) -> list[Mutant]:
    """All mutants of a file of tubeopt/."""
    return Python(file).found if file.endswith(".py") else c_mutants(file)


def files_of(area: str, only: str) -> list[str]:
    """The files of an area, those that a pattern allows."""
    package = ROOT / "tubeopt"
    every = [path.relative_to(package).as_posix() for glob in AREAS[area] for path in sorted(package.glob(glob))]
    return [file for file in every if fnmatch(file, only)]


def sample(area: str, only: str, count: int, random_: random.Random) -> list[Mutant]:
    """So many mutants of an area, of different places, each place as likely as any other."""
    positions: dict[tuple[str, int, str], list[Mutant]] = {}
    for file in files_of(area, only):
        for mutant in mutants_of(file):
            positions.setdefault((file, mutant.start, mutant.old), []).append(mutant)
    return [
        random_.choice(positions[position])
        for position in random_.sample(sorted(positions), min(count, len(positions)))
    ]

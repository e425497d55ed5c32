"""YAML that holds data and nothing else: strict to read, plain to write, numbers to the last digit."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal, InvalidOperation
from os import PathLike
from typing import Any

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ..errors import InputError
from .checked import models
from .files import read_text, write_text

LONGEST = 10**6
"""Characters of a line that is not broken."""

_TAG = "tag:yaml.org,2002:"
_FLOAT, _SEQUENCE = _TAG + "float", _TAG + "seq"

# YAML 1.1 reads 58e9 and 1e-3 as text; everyone, and YAML 1.2, means a number.
_EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")


def load_yaml(path: str | PathLike[str], under: str = "") -> dict[str, Any]:
    """The mapping in a YAML file, numbers with a point or exponent as `Decimal`.

    Nothing but plain data is constructed: the loader is PyYAML's safe one, made stricter.

    Args:
        under: key below which a list is expected, for the message where the file is a list and nothing else.

    Raises:
        InputError: no such file, not YAML, a key given twice, a tag such as `!!python/object`, or not a mapping.
    """
    data = _parsed(read_text(path), str(path))
    if data is None:
        raise InputError(f"{path}: the file is empty; it must be a mapping of keys to values")
    if not isinstance(data, dict):
        hint = f"; write the line '{under}:' above the list" if under and isinstance(data, list) else ""
        raise InputError(f"{path}: the file contains {_noun(data)}; it must be a mapping of keys to values{hint}")
    return data


def read_flow(text: str) -> Any:
    """What is written on one line as YAML, as "{tip_force_mN: [10, 0, 0]}", read as `load_yaml` reads a file.

    Raises:
        InputError: it is not YAML.
    """
    return _parsed(text, text)


def to_flow(value: Any) -> str:
    """A value on one line, as `read_flow` reads it."""
    text = yaml.dump(
        value, Dumper=_OneLine, sort_keys=False, default_flow_style=True, allow_unicode=True, width=LONGEST
    )
    return text.removesuffix("...\n").strip()


def _parsed(text: str, path: str) -> Any:
    try:
        return yaml.load(text, Loader=_Loader)  # a SafeLoader
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = f" line {mark.line + 1}, column {mark.column + 1}:" if mark else ""
        problem = error.problem or ""
        # PyYAML splits some sentences: "expected a single document", "but found another document".
        if problem.startswith("but "):
            problem = f"{error.context}, {problem}"
        raise InputError(f"{path}:{line} not valid YAML: {problem}") from None
    except (yaml.YAMLError, ValueError) as error:  # characters YAML forbids; impossible dates and huge integers
        raise InputError(f"{path}: not valid YAML: {str(error).splitlines()[0]}") from None
    except RecursionError:
        raise InputError(f"{path}: not valid YAML: nested too deeply") from None


def save_yaml(path: str | PathLike[str], data: Mapping[str, Any], header: str) -> None:
    """Write `data` as YAML below the comment `header`, whole or not at all; raises InputError where that cannot be."""
    write_text(path, to_yaml(data, header))


def to_yaml(data: Mapping[str, Any], header: str) -> str:
    """The text of such a file."""
    comment = "".join(f"# {line}\n" for line in header.splitlines())
    text = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
    if len(text.splitlines()) != text.count("\n"):
        # Some text holds a line break that is not a newline, which YAML would fold into a space: escape it.
        text = yaml.dump(data, Dumper=_Dumper, sort_keys=False, width=120)
    return comment + text


def _noun(data: object) -> str:
    return {list: "a list", str: "text", bool: "true or false"}.get(type(data), "a single value")


class _Loader(yaml.SafeLoader):
    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """The node of a mapping; raises ConstructorError for a key that is given twice."""
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            name = (key.tag, key.value) if isinstance(key, yaml.ScalarNode) else id(key)
            if name in seen:
                raise yaml.constructor.ConstructorError(
                    problem=f"the key {key.value!r} is given twice", problem_mark=key.start_mark
                )
            seen.add(name)
        return node

    def exact_float(self, node: yaml.ScalarNode) -> Decimal:
        try:
            # YAML 1.1 allows 1_000 for 1000.
            return Decimal(str(node.value).replace("_", ""))
        except InvalidOperation:
            return Decimal(self.construct_yaml_float(node))  # .inf and .nan

    def refuse(self, node: yaml.Node) -> None:
        raise yaml.constructor.ConstructorError(
            problem=f"{node.tag.replace(_TAG, '!!')} is not allowed; only numbers, text, lists and mappings are",
            problem_mark=node.start_mark,
        )


class _Dumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True

    def decimal(self, number: Decimal) -> yaml.ScalarNode:
        return self.represent_scalar(_FLOAT, str(number))

    def short_list(self, items: list[Any]) -> yaml.SequenceNode:
        nested = any(isinstance(item, (list, dict)) for item in items)
        return self.represent_sequence(_SEQUENCE, items, flow_style=not nested)


class _OneLine(_Dumper):
    def shortest(self, number: Decimal) -> yaml.Node:
        return self.represent_data(int(number) if number == int(number) else float(number))


_Loader.add_constructor(_FLOAT, _Loader.exact_float)
_Loader.add_constructor(None, _Loader.refuse)
_Dumper.add_representer(Decimal, _Dumper.decimal)
_Dumper.add_representer(list, _Dumper.short_list)
_OneLine.add_representer(Decimal, _OneLine.shortest)
_OneLine.add_representer(list, _OneLine.represent_list)
for _class in (_Loader, _Dumper):
    _class.add_implicit_resolver(_FLOAT, _EXPONENT, list("-+.0123456789"))


# --- files to begin with: what every key is behind it, and below them the keys that may follow, as comments -----------

INDENT = "  "


def commented(model: type[BaseModel], data: Mapping[str, Any], header: str) -> str:
    """The text of a YAML file that holds `data`, whose keys are those of `model`, below the comment `header`."""
    head = "".join(f"# {line}\n" for line in header.splitlines())
    return head + "".join(f"{line}\n" for line in _mapping([model], data))


def _mapping(alternatives: Sequence[type[BaseModel]], data: Mapping[str, Any], *, told: bool = False) -> Iterator[str]:
    """Lines of a mapping; without comments where they were `told` before."""
    # Of several models the one that has all the keys: a load or a robot has several forms.
    fields = next((known for one in alternatives if data.keys() <= (known := _keys(one)).keys()), {})
    for key, value in data.items():
        field = fields.get(key)
        note = "" if told or field is None else _note(field)
        yield from _entry(key, value, note, () if field is None else tuple(models(field.annotation)), told)
    for key, field in fields.items():
        if not told and key not in data and not field.is_required():
            yield f"# {key}:{_default(field)}{_note(field)}"


def _keys(model: type[BaseModel]) -> dict[str, FieldInfo]:
    """What a file calls the fields of a model -> the fields."""
    return {field.alias or name: field for name, field in model.model_fields.items()}


def _entry(key: str, value: Any, note: str, inner: Sequence[type[BaseModel]], told: bool) -> Iterator[str]:
    if isinstance(value, Mapping) and inner:
        yield f"{key}:{note}"
        yield from (INDENT + line for line in _mapping(inner, value, told=told))
    elif isinstance(value, list) and value and isinstance(value[0], Mapping) and inner:
        yield f"{key}:{note}"
        for k, each in enumerate(value):
            first, *rest = _mapping(inner, each, told=told or k > 0)
            yield f"{INDENT}- {first}"
            yield from (2 * INDENT + line for line in rest)
    else:
        yield f"{key}: {to_flow(value)}{note}"


def _note(field: FieldInfo) -> str:
    return f"  # {' '.join(field.description.split())}" if field.description else ""


def _default(field: FieldInfo) -> str:
    """What stands for a key that is left out, where it is a number or a word."""
    value = field.get_default(call_default_factory=True)
    return "" if value is None or isinstance(value, BaseModel | tuple) or value == [] else f" {to_flow(value)}"

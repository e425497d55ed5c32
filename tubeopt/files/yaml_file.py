"""YAML files with plain data only: strict to read, plain to write, with exact numbers."""

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

LINE_WIDTH = 10**6
"""Line length of the emitter that keeps a value on one line."""

_TAG = "tag:yaml.org,2002:"
_FLOAT, _SEQUENCE = _TAG + "float", _TAG + "seq"

# YAML 1.1 reads 58e9 and 1e-3 as text; everyone, and YAML 1.2, means a number.
_EXPONENT = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)[eE][-+]?\d+$")


def load_yaml(path: str | PathLike[str], under: str = "") -> dict[str, Any]:
    """Load the mapping in a YAML file, with `Decimal` for numbers with a point or exponent.

    The loader is PyYAML's safe one with further checks: it constructs plain data only.

    Args:
        under: key of an expected list, for the message if the file is only a list.

    Raises:
        InputError: no such file, not YAML, a repeated key, a tag such as `!!python/object`, or not a mapping.
    """
    data = _parsed(read_text(path), str(path))
    if data is None:
        raise InputError(f"{path}: the file is empty; it must be a mapping of keys to values")
    if not isinstance(data, dict):
        hint = f"; write the line '{under}:' above the list" if under and isinstance(data, list) else ""
        noun = {list: "a list", str: "text", bool: "true or false"}.get(type(data), "a single value")
        raise InputError(f"{path}: the file contains {noun}; it must be a mapping of keys to values{hint}")
    return data


def read_flow(text: str) -> Any:
    """Read YAML on one line, such as "{tip_force_mN: [10, 0, 0]}", as `load_yaml` reads a file.

    Raises:
        InputError: it is not YAML.
    """
    return _parsed(text, text)


def to_flow(value: Any) -> str:
    """Write a value as YAML on one line, for `read_flow`."""
    text = yaml.dump(
        value, Dumper=_OneLine, sort_keys=False, default_flow_style=True, allow_unicode=True, width=LINE_WIDTH
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
    """Write data as YAML below the comment `header`, in one atomic step; raises InputError if that fails."""
    write_text(path, to_yaml(data, header))


def to_yaml(data: Mapping[str, Any], header: str) -> str:
    """Text of a YAML file: the comment `header`, then the data."""
    comment = "".join(f"# {line}\n" for line in header.splitlines())
    text = yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=120)
    if len(text.splitlines()) != text.count("\n"):
        # Some text has a line break that is not a newline. YAML would turn it into a space: escape it.
        text = yaml.dump(data, Dumper=_Dumper, sort_keys=False, width=120)
    return comment + text


class _Loader(yaml.SafeLoader):
    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        """Node of a mapping; raises ConstructorError for a repeated key."""
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        names = set()
        for key, _ in node.value:
            name = (key.tag, key.value) if isinstance(key, yaml.ScalarNode) else id(key)
            if name in names:
                raise yaml.constructor.ConstructorError(
                    problem=f"the key {key.value!r} is given twice", problem_mark=key.start_mark
                )
            names.add(name)
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


# --- template files: a comment for every key, and the optional keys as comments ---------------------------------------

INDENT = "  "


def commented(model: type[BaseModel], data: Mapping[str, Any], header: str) -> str:
    """Text of a YAML file with data of a model, descriptions of the keys, and optional keys as comments."""
    head = "".join(f"# {line}\n" for line in header.splitlines())
    return head + "".join(f"{line}\n" for line in _mapping([model], data))


def _mapping(
    alternatives: Sequence[type[BaseModel]], data: Mapping[str, Any], *, comments: bool = True
) -> Iterator[str]:
    """Lines of a mapping with data of one of several models."""
    # The model that has all keys: a load or a robot has several forms.
    fields: dict[str, FieldInfo] = {}
    for model in alternatives:
        known = {field.alias or name: field for name, field in model.model_fields.items()}
        if data.keys() <= known.keys():
            fields = known
            break
    for key, value in data.items():
        field = fields.get(key)
        note = "" if field is None or not comments else _note(field)
        inner = () if field is None else tuple(models(field.annotation))
        if isinstance(value, Mapping) and inner:
            yield f"{key}:{note}"
            yield from (INDENT + line for line in _mapping(inner, value, comments=comments))
        elif isinstance(value, list) and value and isinstance(value[0], Mapping) and inner:
            yield f"{key}:{note}"
            for k, part in enumerate(value):
                # Only the first part has comments: the others have the same keys.
                first, *following = _mapping(inner, part, comments=comments and k == 0)
                yield f"{INDENT}- {first}"
                yield from (2 * INDENT + line for line in following)
        else:
            yield f"{key}: {to_flow(value)}{note}"
    for key, field in fields.items():
        if comments and key not in data and not field.is_required():
            yield f"# {key}:{_default(field)}{_note(field)}"


def _note(field: FieldInfo) -> str:
    return f"  # {' '.join(field.description.split())}" if field.description else ""


def _default(field: FieldInfo) -> str:
    """Default of an optional key, if it is a number or a word."""
    value = field.get_default(call_default_factory=True)
    return "" if value is None or isinstance(value, BaseModel | tuple) or value == [] else f" {to_flow(value)}"

"""YAML, strictly: what a file says is taken as it stands, or refused in one line that names the file.

It is YAML 1.1 without its traps: every key once, and text; numbers decimal (not octal, hexadecimal, underscored or
sexagesimal); integers of 64 bits; numbers with a point that neither overflow nor vanish or lose digits, as those below
2.3e-308 do; no tags; all of it bounded, also when aliases are expanded.
"""

from __future__ import annotations

import math
import os
import re
import sys
from typing import Any

import yaml

from flatsat_ros.base.errors import FlatsatError, quoted, refusal
from flatsat_ros.base.files import read_text, unreadable, unwritable, write_text

YAML_BYTES = 128 * 1024  # the largest certificate, of a loop with 40 commands in flight, has 100 KB
YAML_VALUES = 10_000  # scalars, lists and mappings, aliases expanded
YAML_DEPTH = 32  # lists and mappings inside each other

_TAG = "tag:yaml.org,2002:"


def read_yaml(path: str | os.PathLike[str], bytes_max: int = YAML_BYTES, *, foreign: bool = False) -> Any:
    """Return the one document of a YAML file as plain mappings, lists, strings, numbers, booleans and None.

    Args:
        path: of the file.
        bytes_max: largest size that is read; larger than YAML_BYTES for files that hold tables as text.
        foreign: it is another program's file, of which not all is read here: a number that is not decimal is text then,
            which is refused where a number is wanted.

    Raises:
        FlatsatError: the file cannot be read, or is not YAML within the limits that stand at the head of this module.
    """
    text = read_text(path, bytes_max)
    try:
        return yaml.load(text, _ForeignLoader if foreign else _Loader)
    except yaml.MarkedYAMLError as error:
        line = "" if error.problem_mark is None else f"line {error.problem_mark.line + 1}: "
        reason = " ".join(part for part in (error.context, error.problem) if part)
        raise unreadable(path, line + reason) from error
    except yaml.YAMLError as error:  # characters that no text has
        raise unreadable(path, error) from error


def write_yaml(path: str | os.PathLike[str], document: dict[str, Any], header: str = "") -> None:
    """Write plain mappings, lists, strings, numbers, booleans and None as YAML, in one step.

    Args:
        path: of the file.
        document: what `read_yaml` will return.
        header: comment lines above it.

    Raises:
        FlatsatError: the file cannot be written, or a value has another type.
    """
    try:
        text = yaml.dump(document, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=120)
    except yaml.YAMLError as error:
        raise unwritable(path, error) from error
    write_text(path, header + text)


def section(name: str, value: object, keys: tuple[str, ...]) -> dict[str, Any]:
    """Return a part of a document, a mapping that has exactly the given keys.

    Args:
        name: of the part, for the error.
        value: what must be one.
        keys: all of them are needed.

    Raises:
        FlatsatError: it is no mapping, a key is missing, or there is another one.
    """
    if not isinstance(value, dict):
        raise refusal(name, value, "", f"a mapping with the keys {', '.join(keys)}")
    unknown = [key for key in value if key not in keys]
    if unknown:
        raise FlatsatError(f"{name}: unknown key {quoted(unknown[0])}; valid keys are {', '.join(keys)}")
    missing = [key for key in keys if key not in value]
    if missing:
        raise FlatsatError(f"{name}: key {missing[0]!r} is missing; needed are {', '.join(keys)}")
    return value


class _Loader(yaml.SafeLoader):
    """The YAML that this package reads. Bounds are kept while nodes are composed, before anything is built of them."""

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._depth = 0
        self._count = 0
        self._sizes: dict[yaml.Node | None, int] = {}  # values below a node that is complete

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        event: Any = self.peek_event()  # type: ignore[no-untyped-call]
        before = self._count
        if isinstance(event, yaml.AliasEvent):
            node = super().compose_node(parent, index)
            if node not in self._sizes:
                raise _refusal(f"alias {quoted(event.anchor)} stands inside what it names", event)
            self._count += self._sizes[node]
        else:
            self._depth += 1
            if self._depth > YAML_DEPTH:
                raise _refusal(f"more than {YAML_DEPTH} lists and mappings inside each other", event)
            if event.tag is not None:
                raise _refusal(f"tag {quoted(event.tag)}: must not be there; put text into quotation marks", event)
            self._count += 1
            node = super().compose_node(parent, index)
            self._depth -= 1
            self._sizes[node] = self._count - before
        if self._count > YAML_VALUES:
            raise _refusal(f"more than {YAML_VALUES} values, aliases expanded", event)
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        node = super().compose_mapping_node(anchor)
        seen = set()
        for key, _ in node.value:
            if key.tag not in (_TAG + "str", _TAG + "merge"):
                raise _refusal(f"key {quoted(key.value)}: must be text", key)
            if key.value in seen:
                raise _refusal(f"key {quoted(key.value)} stands there twice", key)
            seen.add(key.value)
        return node

    def construct_integer(self, node: yaml.ScalarNode) -> int:
        if len(node.value) > 20 or abs(int(node.value)) >= 2**63:
            raise _refusal(f"integer {quoted(node.value)}: must fit 64 bits", node)
        return int(node.value)

    def construct_decimal(self, node: yaml.ScalarNode) -> float:
        value = float(node.value)
        is_zero = not re.search("[1-9]", re.split("[eE]", node.value)[0])
        if not (is_zero or sys.float_info.min <= abs(value) < math.inf):
            raise _refusal(f"number {quoted(node.value)}: must be 0, or from 2.3e-308 to 1.7e+308", node)
        return value

    def construct_not_finite(self, node: yaml.ScalarNode) -> float:
        return float(node.value.replace(".", ""))

    def refuse_number(self, node: yaml.ScalarNode) -> float:
        valid = "must be a plain decimal number, or text in quotation marks"
        raise _refusal(f"number {quoted(node.value)}: {valid}", node)


def _refusal(text: str, place: Any) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=text, problem_mark=place.start_mark)


_KEPT = {_TAG + name for name in ("null", "bool", "merge")}
_Loader.yaml_implicit_resolvers = {
    first: kept
    for first, entries in yaml.SafeLoader.yaml_implicit_resolvers.items()
    if (kept := [entry for entry in entries if entry[0] in _KEPT])
}
_Loader.yaml_constructors = {
    tag: constructor
    for tag, constructor in yaml.SafeLoader.yaml_constructors.items()
    if tag is None or tag.removeprefix(_TAG) in ("null", "bool", "str", "seq", "map")
}
for _name, _pattern, _constructor in (
    ("int", r"[-+]?(?:0|[1-9][0-9]*)", _Loader.construct_integer),
    ("float", r"[-+]?(?:(?:0|[1-9][0-9]*)\.[0-9]*|\.[0-9]+)(?:[eE][-+][0-9]+)?", _Loader.construct_decimal),
    ("not_finite", r"[-+]?\.(?:inf|Inf|INF)|\.(?:nan|NaN|NAN)", _Loader.construct_not_finite),
    ("leading zero", r"[-+]?0[0-9_]+(?:\.[0-9_]*)?(?:[eE][-+]?[0-9]+)?", _Loader.refuse_number),
    ("other base", r"[-+]?0[xXoObB][0-9a-fA-F_]+", _Loader.refuse_number),
    ("sexagesimal", r"[-+]?[0-9][0-9_]*(?::[0-5]?[0-9])+(?:\.[0-9_]*)?", _Loader.refuse_number),
    ("underscored", r"[-+]?(?=\.?[0-9])[0-9.]*_[0-9._]*(?:[eE][-+]?[0-9]+)?", _Loader.refuse_number),
):
    _Loader.add_implicit_resolver(_TAG + _name, re.compile(rf"(?:{_pattern})\Z"), list("-+.0123456789"))
    _Loader.add_constructor(_TAG + _name, _constructor)


class _ForeignLoader(_Loader):
    """The same for files of other programs: takes numbers that are not decimal for text."""


_ForeignLoader.yaml_implicit_resolvers = {
    first: [entry for entry in entries if _Loader.yaml_constructors.get(entry[0]) is not _Loader.refuse_number]
    for first, entries in _Loader.yaml_implicit_resolvers.items()
}


class _Dumper(yaml.SafeDumper):
    """Writes what _Loader reads: text that either would take for a number stands in quotation marks, lines as lines."""

    def represent_text(self, text: str) -> yaml.ScalarNode:
        return self.represent_scalar(_TAG + "str", text, style="|" if "\n" in text else None)


_Dumper.add_representer(str, _Dumper.represent_text)
_Dumper.yaml_implicit_resolvers = {
    first: yaml.SafeDumper.yaml_implicit_resolvers.get(first, []) + _Loader.yaml_implicit_resolvers.get(first, [])
    for first in [*yaml.SafeDumper.yaml_implicit_resolvers, *_Loader.yaml_implicit_resolvers]
}

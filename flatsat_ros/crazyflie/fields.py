"""Dataclasses as YAML mappings and back: exactly their fields, each of its type."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, TypeVar, cast, get_args, get_type_hints

from flatsat_ros.base.errors import FlatsatError, quoted, refusal, require

T = TypeVar("T")


def build(cls: type[T], content: object, where: str) -> T:
    """Build a dataclass from a YAML mapping with exactly its fields; those that have a default may be left out."""
    if not isinstance(content, Mapping):
        raise refusal(where, content, "", "a mapping")
    members = dataclasses.fields(cast(Any, cls))
    names = [field.name for field in members]
    needed = [field.name for field in members if field.default is dataclasses.MISSING]
    unknown, missing = sorted(map(str, set(content) - set(names))), [name for name in needed if name not in content]
    if unknown or missing:
        wrong = f"has unknown keys {quoted(unknown)} and lacks {missing}"
        raise FlatsatError(f"{where} {wrong}: must have the keys {', '.join(names)}")
    hints = get_type_hints(cls)
    values = {name: _convert(hints[name], content[name], f"{where}.{name}") for name in names if name in content}
    try:
        return cls(**values)
    except FlatsatError as error:
        raise FlatsatError(f"{where}.{error}") from error


def _convert(kind: Any, value: object, where: str) -> object:
    """Check one YAML value against a field's type; integers serve as floats, nothing else is coerced."""
    if type(None) in get_args(kind):  # what may be left out has the type X | None; a value has the type X
        kind = get_args(kind)[0]
    if dataclasses.is_dataclass(kind):
        return build(cast("type[object]", kind), value, where)
    if kind in (str, bool, int):
        require(type(value) is kind, where, value, "", f"of type {kind.__name__}")
        return value
    if kind is float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise refusal(where, value, "", "a number (YAML reads 1.0e-3, but not 1e-3, as one)")
        return float(value)
    # the only remaining kind is a tuple of floats
    length = len(kind.__args__)
    if not isinstance(value, list) or len(value) != length:
        raise refusal(where, value, "", f"a list of {length} numbers")
    return tuple(_convert(float, item, f"{where}[{i}]") for i, item in enumerate(value))


def without_empty(value: object) -> object:
    """Return a value without tuples and without entries that are None."""
    if isinstance(value, dict):
        return {key: without_empty(entry) for key, entry in value.items() if entry is not None}
    return list(value) if isinstance(value, tuple) else value

"""What a command line gives that ROS would ignore without a word: for nodes that are not here, of names nobody uses.

Parameters for other nodes alone are refused: drones would fly with defaults. A file that several nodes of this package
share may have none for one of them, which is told; but no name that is nearly that node's. A remapping may be of a
topic that is used later, or be given to several programs of which another uses it: it is told, and refused never.
"""

from __future__ import annotations

import difflib
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import yaml
from rclpy.expand_topic_name import expand_topic_name

from flatsat_ros.base.errors import FlatsatError, nearest_name, one_line, quoted
from flatsat_ros.base.files import located, read_text, unreadable
from flatsat_ros.base.strict_yaml import YAML_BYTES, YAML_DEPTH
from flatsat_ros.nodes.ros.interfaces import NODES

_LIST = " "  # in place of a key, inside a list
_NEAR = 0.7  # how alike a misspelt name is, as `difflib` measures it; "controller" is as much like ours
_SHOWN = 200  # characters of all names of sections together


class Called(NamedTuple):
    """Full names that a node has called topics and services by, before they are remapped."""

    topics: set[str]
    services: set[str]


@dataclass(frozen=True)
class Given:
    """What stands behind --ros-args.

    Attributes:
        sections: of each file of parameters, the names of the nodes that it is for, as they stand there.
        parameters: single ones that name their node, as they were given.
        rules: remappings, as they were given.
    """

    sections: dict[str, list[str]]
    parameters: list[str]
    rules: list[str]

    def require_for(self, node: str, own: str) -> list[str]:
        """Refuse parameters for other nodes alone; return a sentence about each file that was written for such.

        Args:
            node: name of the node that this program is, with its namespace.
            own: its name as the program has it.

        Raises:
            FlatsatError: names the file, what it is for, and which of that is nearest.
        """
        shared = []
        for path, sections in self.sections.items():
            if any(_applies(section, node) for section in sections):
                continue
            found = one_line(f"its sections are {', '.join(sections)}" if sections else "it has no section", _SHOWN)
            names = {section.rpartition("/")[2] for section in sections}
            if not names & set(NODES) or any(_is_nearly(name, {node.rpartition("/")[2], own}) for name in names):
                nearest = one_line(nearest_name(node, map(_rooted, sections)))
                raise located(path, f"{found}: must have one for {node}, or for all nodes: /**{nearest}")
            shared.append(f"{path}: nothing in it is for {node}: {found}")
        for given in self.parameters:
            name = given.partition(":")[0]
            if _rooted(name) != node:
                raise FlatsatError(
                    f"parameter {quoted(given)} is for node /{one_line(name)}: must be for {node}: leave "
                    f"{quoted(name + ':')} away"
                )
        return shared

    def unused(self, called: Called, own: str, node: str, namespace: str) -> Iterator[str]:
        """Yield a sentence about each remapping that has changed nothing.

        Args:
            called: topics and services of the node.
            own: its name as the program has it.
            node: its name, remapped.
            namespace: in which it is, remapped.
        """
        for rule in self.rules:
            match = re.fullmatch(r"(?:(\w+):(?!//))?(?:ros(topic|service)://)?(.+)", rule.partition(":=")[0])
            if match is None:  # nothing that rcl takes
                continue
            for_node, kind, name = match.groups()
            is_name = name in ("__node", "__name")
            meant = own if is_name else node
            if for_node not in (None, meant):
                yield f"remapping {quoted(rule)} changes nothing: it is for node {for_node}, this is {meant}"
            elif not is_name and name != "__ns":
                full = expand_topic_name(name, node, namespace)
                known = {"topic": called.topics, "service": called.services}.get(kind, called.topics | called.services)
                if full not in known:
                    nearest = nearest_name(full, sorted(known))
                    what = kind or "topic or service"
                    yield f"remapping {quoted(rule)} has changed nothing so far: no {what} here is {full}{nearest}"


_NOTHING = Given({}, [], [])
_current = ContextVar("what the command line gives", default=_NOTHING)


def read_given(arguments: Sequence[str]) -> Given:
    """Return what a command line gives a node.

    Raises:
        FlatsatError: a file of parameters is no regular file, too large or no YAML.
    """
    given, taken = Given({}, [], []), False
    for word, value in pairwise(arguments):
        if word in ("--ros-args", "--"):
            taken = word == "--ros-args"
        elif taken and word == "--params-file":
            given.sections[value] = _sections(value)
        elif taken and word in ("-p", "--param") and ":" in value.partition(":=")[0]:
            given.parameters.append(value)
        elif taken and word in ("-r", "--remap"):
            given.rules.append(value)
    return given


@contextmanager
def giving(given: Given) -> Iterator[None]:
    """Let nodes that are made meanwhile find what the command line gives."""
    token = _current.set(given)
    try:
        yield
    finally:
        _current.reset(token)


def given_now() -> Given:
    """Return what the command line gives the node that is being made."""
    return _current.get()


def _sections(path: str | os.PathLike[str]) -> list[str]:
    """Return the names of the nodes that a file of parameters is for: the keys above each ros__parameters.

    What stands below is left to rcl, which takes other YAML than `read_yaml`.
    """
    found: list[str] = []
    keys: list[str] = []  # of the mappings that are open, each the key whose value comes next, if any
    try:
        for event in yaml.parse(read_text(path, YAML_BYTES), yaml.SafeLoader):
            if isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent)):
                keys.append("" if isinstance(event, yaml.MappingStartEvent) else _LIST)
                if len(keys) > YAML_DEPTH:  # the parser would take minutes for thousands
                    raise unreadable(path, f"more than {YAML_DEPTH} lists and mappings inside each other")
                continue
            if isinstance(event, yaml.CollectionEndEvent):
                keys.pop()
            elif isinstance(event, yaml.ScalarEvent) and keys and not keys[-1]:
                keys[-1] = event.value
                if event.value == "ros__parameters":
                    found.append("/".join(keys[:-1]))
                continue
            if keys and keys[-1] != _LIST:
                keys[-1] = ""
    except yaml.YAMLError as error:
        raise unreadable(path, error) from error
    return found


def _rooted(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"


def _is_nearly(name: str, mine: set[str]) -> bool:
    """Tell whether a section may have been meant for this node, rather than for another one of ours or of others.

    Args:
        name: of the section, without its namespace, which is another one if the name is this node's.
        mine: names of this node, without its namespace: as the program has it, and remapped.
    """
    near = difflib.get_close_matches(name, [*mine, *NODES], n=1, cutoff=_NEAR)
    return name in ("*", "**") or not mine.isdisjoint(near)


def _applies(section: str, node: str) -> bool:
    """Tell whether rcl takes a section to be for a node: `*` stands for one part of its name, `**` for any number."""
    pattern = re.escape(_rooted(section)).replace(r"/\*", r"(/\w+)").replace(r"\*", "*")
    return re.fullmatch(pattern, node) is not None

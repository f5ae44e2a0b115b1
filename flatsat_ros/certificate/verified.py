"""Hashes of what was verified on this machine, so that a flight section is proved once and not at every start.

A hash covers the content and the source of the proof, so that neither a changed file nor a changed checker is taken for
what was verified. What is in the folder proves nothing to anybody but the user who owns it.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).resolve().parents[1]
# the rooms that a proof is made of
_ROOMS = ("base", "law", "certificate")


@cache
def _checker() -> bytes:
    """Return the hash of the source of the proof."""
    digest = hashlib.sha256()
    for room in _ROOMS:
        for path in sorted((_PACKAGE / room).glob("*.py")):
            digest.update(path.name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.digest()


def _mark(document: Mapping[str, Any]) -> Path:
    """Return the file that stands for a verified document: $XDG_CACHE_HOME/flatsat_ros/verified/<hash>."""
    content = json.dumps(document, sort_keys=True).encode()
    name = hashlib.sha256(_checker() + content).hexdigest()
    folder = os.environ.get("XDG_CACHE_HOME", "")
    base = Path(folder) if folder.startswith("/") else Path.home() / ".cache"
    return base / "flatsat_ros" / "verified" / name


def is_verified(document: Mapping[str, Any]) -> bool:
    """Tell whether this content was verified here, with this version of the proof."""
    try:
        return _mark(document).is_file()
    except (OSError, RuntimeError):  # no home folder, or one that is closed to us: it is verified again
        return False


def remember(document: Mapping[str, Any]) -> None:
    """Note that a content was verified; where nothing can be written it is verified again the next time."""
    try:
        mark = _mark(document)
        mark.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        mark.touch()
    except (OSError, RuntimeError):
        return

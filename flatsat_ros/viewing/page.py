"""One HTML file that shows a flight: it opens from a disk, without network or server."""

from __future__ import annotations

import base64
import gzip
import json
import math
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from flatsat_ros.viewing.figures import figures_of
from flatsat_ros.viewing.flight import Flight

PAGE = Path(__file__).parent / "page"
VENDOR = PAGE / "vendor"
# in the order in which they need each other
SCRIPTS = ("flight.js", "look.js", "scene.js", "plots.js", "timeline.js", "tables.js", "report.js")


def report(flight: Flight) -> str:
    """Return the page of a flight, self-contained."""
    parts = {
        "style": _read(VENDOR / "uPlot.min.css") + _read(PAGE / "style.css"),
        "flight": base64.b64encode(gzip.compress(encode(flight), compresslevel=6, mtime=0)).decode(),
        "script": "\n".join([_read(VENDOR / "vendor.js"), *(_read(PAGE / name) for name in SCRIPTS)]),
    }
    page = _read(PAGE / "report.html").replace("<title>Flight report", f"<title>{escape(flight.title)}")
    for name, text in parts.items():
        page = page.replace("{{" + name + "}}", text)
    return page


def encode(flight: Flight) -> bytes:
    """Return a flight as the page reads it.

    The length of a header in JSON (uint32), the header, zeros up to a multiple of 4, then for each drone and channel
    its times (s) and its fields, one after the other, as float32; all little-endian.
    """
    arrays = [
        np.ascontiguousarray(channel.samples.T, dtype="<f4").tobytes()
        for track in flight.tracks
        for channel in track.channels.values()
    ]
    header = json.dumps(
        {
            "title": flight.title,
            "duration": flight.duration,
            "notes": list(flight.notes),
            "setup": _plain(dict(flight.setup)),
            "events": [_plain(vars(event)) for event in flight.events],
            "figures": _plain(figures_of(flight)),
            "drones": [
                {
                    "name": track.name,
                    "channels": [
                        {"kind": kind, "fields": channel.fields, "count": len(channel.samples)}
                        for kind, channel in track.channels.items()
                    ],
                }
                for track in flight.tracks
            ],
        },
        allow_nan=False,
    ).encode()
    return b"".join([len(header).to_bytes(4, "little"), header, b"\0" * (-len(header) % 4), *arrays])


def _plain(value: Any) -> Any:
    """Return a value as JSON has it: what is not finite becomes null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name): _plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value


def _read(file: Path) -> str:
    return file.read_text(encoding="utf-8")

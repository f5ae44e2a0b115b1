"""One HTML file that shows a flight: it opens from a disk, without network or server."""

from __future__ import annotations

import base64
import gzip
import json
import math
import re
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from flatsat_ros.base.colours import COLOURS
from flatsat_ros.viewing.figures import figures_of
from flatsat_ros.viewing.flight import Flight

PAGE = Path(__file__).parent / "page"
VENDOR = PAGE / "vendor"
# in the order in which they need each other
_COMMON = ("flight.js", "look.js", "scene.js", "plots.js", "timeline.js")
RECORDED = (*_COMMON, "tables.js", "report.js")
LIVE = (*_COMMON, "live.js", "console.js")
_LARGEST = float(np.finfo(np.float32).max)


def report(flight: Flight) -> str:
    """Return the page of a flight, self-contained."""
    data = base64.b64encode(gzip.compress(encode(flight), compresslevel=6, mtime=0)).decode()
    return _page(
        title=escape(flight.title),
        body=_read(PAGE / "report.html").replace("{{flight}}", data),
        style=_style("style.css"),
        script=_script(RECORDED),
    )


def page_of_console() -> str:
    """Return the page of the console, which is fed by `viewing.server`."""
    return _page(
        title="Console \N{EN DASH} flatsat_ros",
        body=_read(PAGE / "console.html"),
        style=_style("style.css", "console.css"),
        script=_script(LIVE),
        sources="connect-src 'self'; ",
    )


def _page(title: str, body: str, style: str, script: str, sources: str = "") -> str:
    """Return a page of these parts; sources are what its content security policy allows beside the page itself."""
    parts = {"title": title, "body": body, "style": style, "script": script, "sources": sources}
    return re.sub(r"\{\{(\w+)\}\}", lambda place: parts[place[1]], _read(PAGE / "page.html"))


def _style(*names: str) -> str:
    return _read(VENDOR / "uPlot.min.css") + "\n".join(_read(PAGE / name) for name in names)


def _script(names: Sequence[str]) -> str:
    colours = f"const COLOURS = {json.dumps(COLOURS)};"
    return "\n".join([_read(VENDOR / "vendor.js"), colours, *(_read(PAGE / name) for name in names)])


def encode(flight: Flight) -> bytes:
    """Return a flight as the page reads it.

    The length of a header in JSON (uint32), the header, zeros up to a multiple of 4, then for each drone and channel
    its times (s) and its fields, one after the other, as float32; all little-endian. A finite number that float32 does
    not reach is a gap (NaN), and a note says so.
    """
    notes, arrays = list(flight.notes), []
    for track in flight.tracks:
        for kind, channel in track.channels.items():
            samples = channel.samples
            beyond = np.isfinite(samples) & (np.abs(samples) > _LARGEST)
            if beyond.any():
                samples = np.where(beyond, np.nan, samples)
                notes.append(f"{track.name}, {kind}: values not shown that exceed {_LARGEST:.2g}: {beyond.sum()}.")
            arrays.append(np.ascontiguousarray(samples.T, dtype="<f4").tobytes())
    header = json.dumps(
        {
            "title": flight.title,
            "duration": flight.duration,
            "notes": notes,
            "setup": json_value(dict(flight.setup)),
            "events": [json_value(vars(event)) for event in flight.events],
            "figures": json_value(figures_of(flight)),
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


def json_value(value: Any) -> Any:
    """Return a value as JSON has it: what is not finite becomes null."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(name): json_value(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_value(entry) for entry in value]
    return value


def _read(file: Path) -> str:
    return file.read_text(encoding="utf-8")

"""The page of a flight: it has everything in it, text stays text, and what is decoded is what was flown."""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import math
import re
import struct
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from flatsat_ros.flight.assumptions import Assumption
from flatsat_ros.flight.modes import Mode
from flatsat_ros.flight.telemetry import FIELDS
from flatsat_ros.viewing.flight import POSE_FIELDS, Channel, Flight, LoggedEvent, Track
from flatsat_ros.viewing.page import LIVE, PAGE, RECORDED, VENDOR, encode, page_of_console, report

EVIL = "</script><script>alert(1)</script>&<b>"
LARGEST = float(np.finfo(np.float32).max)
seconds = st.integers(0, 10**9).map(float)


def decoded(data: bytes) -> tuple[dict[str, Any], list[dict[str, np.ndarray]]]:
    """Header and, for each drone, the samples (n, 1 + fields) by kind, as the page reads them."""
    (size,) = struct.unpack_from("<I", data)
    header = json.loads(data[4 : 4 + size])
    offset, drones = 4 + size + -size % 4, []
    for drone in header["drones"]:
        channels = {}
        for channel in drone["channels"]:
            count, width = channel["count"], 1 + len(channel["fields"])
            flat = np.frombuffer(data, "<f4", count * width, offset)
            channels[channel["kind"]] = flat.reshape(width, count).T
            offset += flat.nbytes
        drones.append(channels)
    assert offset == len(data)
    return header, drones


@given(
    names=st.lists(st.text(max_size=8), max_size=3),
    rows=st.lists(st.tuples(seconds, *[st.floats()] * 7), max_size=5, unique_by=lambda row: row[0]).map(sorted),
    text=st.text(max_size=20),
    value=st.one_of(st.floats(), st.text(max_size=5), st.booleans(), st.lists(st.floats(), max_size=3)),
)
def test_what_the_page_decodes_is_what_was_flown(
    names: list[str], rows: list[tuple[float, ...]], text: str, value: object
) -> None:
    samples = np.array(rows, dtype=float).reshape(-1, 8)
    tracks = [Track(name, {"pose": Channel(POSE_FIELDS, samples)}) for name in names]
    flight = Flight(text, tracks, [LoggedEvent(1.0, "", "info", text)], {"value": value}, [text])
    header, drones = decoded(encode(flight))
    assert [drone["name"] for drone in header["drones"]] == names
    assert header["title"] == header["events"][0]["text"] == header["notes"][0] == text
    beyond = np.isfinite(samples) & (np.abs(samples) > LARGEST)
    shown = np.where(beyond, np.nan, samples).astype("<f4")
    for channels in drones:
        np.testing.assert_array_equal(channels["pose"], shown)
    told = f", pose: values not shown that exceed 3.4e+38: {beyond.sum()}."
    assert header["notes"][1:] == [name + told for name in names if beyond.any()]
    if isinstance(value, float):
        assert header["setup"]["value"] == (value if math.isfinite(value) else None)


def test_the_page_has_everything_in_it_and_text_stays_text() -> None:
    pose = Channel(POSE_FIELDS, np.array([[0.0, 1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]]))
    page = report(Flight(EVIL, [Track(EVIL, {"pose": pose})], [LoggedEvent(0.0, EVIL, "info", EVIL)], {EVIL: EVIL}))
    assert "{{" not in re.sub(r"<script>.*", "", page, flags=re.DOTALL)
    assert EVIL not in page
    assert "<script>alert" not in page
    assert re.findall(r"(?:src|href)=[\"']?\w+:", page) == []
    embedded = re.search(r'<script id="flight"[^>]*>([^<]*)</script>', page)
    assert embedded
    header, _ = decoded(gzip.decompress(base64.b64decode(embedded[1])))
    assert header["title"] == EVIL
    # nothing may be fetched, even if something tried to
    assert "default-src 'none'" in page


def test_a_title_that_looks_like_a_place_of_the_page_stays_text() -> None:
    assert "<title>{{script}}</title>" in report(Flight("{{script}}", [], [], {}, []))


def test_the_report_may_ask_nobody_and_the_console_its_own_server_alone() -> None:
    allowed = [
        re.search(r"default-src 'none'; (.*?)script-src", page) for page in (report(Flight("", [])), page_of_console())
    ]
    assert [found and found[1] for found in allowed] == ["", "connect-src 'self'; "]


@pytest.mark.parametrize("name", sorted({*RECORDED, *LIVE}))
def test_our_scripts_never_turn_text_into_markup(name: str) -> None:
    text = (PAGE / name).read_text(encoding="utf-8")
    assert re.findall(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|\beval\(|XMLHttp", text) == []


def test_every_script_is_in_the_page() -> None:
    assert {file.name for file in PAGE.glob("*.js")} == {*RECORDED, *LIVE}


def test_the_pages_fields_are_those_of_the_telemetry() -> None:
    text = (PAGE / "live.js").read_text(encoding="utf-8")
    listed = re.search(r"TICK_FIELDS = \[(.*?)\];", text, re.DOTALL)
    assert listed
    assert tuple(re.findall(r'"([^"]+)"', listed[1])) == FIELDS
    numbered = re.search(r"MODES = \[(.*?)\];", (PAGE / "look.js").read_text(encoding="utf-8"))
    assert numbered
    assert re.findall(r'"([^"]+)"', numbered[1]) == [mode.name for mode in Mode]
    doubts = re.search(r"ASSUMPTIONS = \[(.*?)\];", (PAGE / "look.js").read_text(encoding="utf-8"), re.DOTALL)
    assert doubts
    assert len(re.findall(r'"[^"]*"', doubts[1])) == len(Assumption)


def test_the_vendored_libraries_are_those_of_their_checksums() -> None:
    lines = (VENDOR / "SHA256SUMS").read_text(encoding="utf-8").splitlines()
    sums = {name: sum_ for sum_, name in (line.split() for line in lines)}
    assert set(sums) == {"vendor.js", "uPlot.min.css", "LICENSES"}
    for name, expected in sums.items():
        assert hashlib.sha256((VENDOR / name).read_bytes()).hexdigest() == expected

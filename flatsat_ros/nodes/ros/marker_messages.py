"""Shapes to be drawn, and the markers that show them: the file that touches the fields of visualization_msgs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point
from visualization_msgs.msg import Marker, MarkerArray

from flatsat_ros.nodes.ros.messages import NANOSECONDS, stamp_from_nanoseconds

_MARKERS = {
    "sphere": Marker.SPHERE, "cylinder": Marker.CYLINDER, "lines": Marker.LINE_LIST, "text": Marker.TEXT_VIEW_FACING,
}  # fmt: skip


class Shape(NamedTuple):
    """Something to be drawn.

    Attributes:
        group: what kind of thing it is.
        number: of it in its group.
        kind: sphere, cylinder, lines or text.
        place: of its middle, m.
        size: along x, y and z, m; of lines the first is the width, of text the last is the height.
        colour: red, green and blue, 0 to 1.
        opacity: 0 to 1.
        text: what is written.
        points: ends of lines, two for each, m.
    """

    group: str
    number: int
    kind: str
    place: tuple[float, ...]
    size: tuple[float, ...]
    colour: tuple[float, ...]
    opacity: float
    text: str = ""
    points: Sequence[tuple[float, float, float]] = ()


def markers_message(frame: str, nanoseconds: int, lifetime: float, shapes: Iterable[Shape]) -> MarkerArray:
    """Return shapes as markers of a frame, with a stamp, to be shown for a lifetime, s, unless renewed."""
    found = MarkerArray()
    stamp, whole = stamp_from_nanoseconds(nanoseconds), int(lifetime)
    for shape in shapes:
        marker = Marker(ns=shape.group, id=shape.number, type=_MARKERS[shape.kind], action=Marker.ADD, text=shape.text)
        marker.header.frame_id, marker.header.stamp = frame, stamp
        marker.lifetime = Duration(sec=whole, nanosec=int((lifetime - whole) * NANOSECONDS))
        place, size, colour = marker.pose.position, marker.scale, marker.color
        place.x, place.y, place.z = shape.place
        marker.pose.orientation.w = 1.0
        size.x, size.y, size.z = shape.size
        colour.r, colour.g, colour.b = shape.colour
        colour.a = shape.opacity
        marker.points = [Point(x=x, y=y, z=z) for x, y, z in shape.points]
        found.markers.append(marker)
    return found

"""Ways around boxes, for a search to begin with: short polylines whose corners stay clear of them.

Candidates for corners are the nodes of a grid whose lines pass along all faces, at the distance that is to be kept, and
half-way between these, so that no opening is too narrow to be seen. Of the shortest way along the grid, corners that
are not needed are left out.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from flatsat_ros.base.arrays import FloatArray

_CLEAR = 1e-3  # m, beyond the distance that is kept
_LINES_MAX = 60  # per axis, about


def around(
    start: FloatArray, goal: FloatArray, boxes: FloatArray, distance: float, lower: FloatArray, upper: FloatArray
) -> FloatArray | None:
    """Return a way (P, 3) from start to goal that keeps its distance from all boxes, or None if none is found.

    Args:
        start: (3,) m.
        goal: (3,) m.
        boxes: (K, 2, 3) m, lower and upper corners.
        distance: m, along each axis.
        lower: (3,) m, corner of the room.
        upper: (3,) m, the other one.
    """
    grown = boxes + (distance + _CLEAR) * np.array([[-1.0], [1.0]])
    if _clear(start, goal, grown):
        return np.array([start, goal])
    axes = [_lines([start[k], goal[k]], grown[:, :, k].ravel(), lower[k], upper[k]) for k in range(3)]
    shape = tuple(len(axis) for axis in axes)
    places = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    number = np.arange(places[..., 0].size).reshape(shape)
    heads, tails, lengths = [], [], []
    for axis in range(3):
        tail, head = np.delete(number, -1, axis=axis).ravel(), np.delete(number, 0, axis=axis).ravel()
        ends = places.reshape(-1, 3)[tail], places.reshape(-1, 3)[head]
        middle = (ends[0] + ends[1]) / 2.0
        inside = (middle[:, np.newaxis] > grown[:, 0]) & (middle[:, np.newaxis] < grown[:, 1])
        free = ~np.any(np.all(inside, axis=2), axis=1)
        tails.append(tail[free])
        heads.append(head[free])
        lengths.append(np.linalg.norm(ends[1] - ends[0], axis=1)[free])
    links = (np.concatenate(lengths), (np.concatenate(tails), np.concatenate(heads)))
    graph = coo_matrix(links, shape=(number.size, number.size)).tocsr()
    source, target = (
        int(number[tuple(int(np.searchsorted(axis, place[k])) for k, axis in enumerate(axes))])
        for place in (start, goal)
    )
    _, before = dijkstra(graph, directed=False, indices=source, return_predecessors=True)
    if before[target] < 0:
        return None
    chain = [target]
    while chain[-1] != source:
        chain.append(int(before[chain[-1]]))
    return _straightened(places.reshape(-1, 3)[chain[::-1]], grown)


def along(way: FloatArray, shares: FloatArray) -> FloatArray:
    """Return the places (S, 3) at shares (S,) of the length of a way (P, 3)."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    return np.stack([np.interp(shares * lengths[-1], lengths, way[:, axis]) for axis in range(3)], axis=1)


def _lines(ends: Sequence[float], faces: FloatArray, low: float, high: float) -> FloatArray:
    """Return where the grid has lines along one axis, m."""
    marks = np.unique(np.concatenate([faces[(faces > low) & (faces < high)], [low, high]]))
    between = (marks[1:] + marks[:-1]) / 2.0
    if len(marks) > _LINES_MAX // 2:
        between = between[:0]
    return np.unique(np.concatenate([ends, marks, between]))


def _straightened(way: FloatArray, grown: FloatArray) -> FloatArray:
    """Return the way without the corners that can be left out."""
    kept = [0]
    while kept[-1] < len(way) - 1:
        here = kept[-1]
        far = range(len(way) - 1, here + 1, -1)
        kept.append(next((there for there in far if _clear(way[here], way[there], grown)), here + 1))
    return np.asarray(way[kept])


def _clear(start: FloatArray, goal: FloatArray, grown: FloatArray) -> bool:
    """Return whether a straight way meets no box: there is no time at which it is inside along all axes."""
    step = goal - start
    still = np.abs(step) < 1e-12
    within = (start > grown[:, 0]) & (start < grown[:, 1])
    with np.errstate(divide="ignore", invalid="ignore"):
        first, last = (grown[:, 0] - start) / step, (grown[:, 1] - start) / step
    enters = np.where(still, np.where(within, -np.inf, np.inf), np.minimum(first, last)).max(axis=1)
    leaves = np.where(still, np.inf, np.maximum(first, last)).min(axis=1)
    return bool(((enters >= np.minimum(leaves, 1.0)) | (leaves <= 0.0)).all())

"""The normalised field against an oracle by other means, its laws, and that nothing of how it is computed shows.

`NUMBA_DISABLE_JIT=1 pytest tests/kernels/test_shepard.py` runs interpreted what is not skipped with a reason.
"""

from __future__ import annotations

import numba
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kernels.oracle import Floats, Mesh, eight_hexahedra, icosahedron, one_tetrahedron
from kernels.shepard_oracle import Net, extremes, graded, jittered, mixed, net_of, oriented, shepard, tetrahedra
from scaffold_stages._kernels.shepard import LANES, Bins, Segments, bin_segments, extremes_along, field_at, field_on_blocks

C, EXPONENT, SUPPORT = 0.02, 4, 1.3
MESHES = {
    "eight_hexahedra": eight_hexahedra,
    "icosahedron": icosahedron,
    "graded": graded,
    "mixed": mixed,
    "jittered": lambda: jittered(tetrahedra((2, 2, 1))),
}


def segments_of(net: Net, c: float = C, exponent: int = EXPONENT, support: float = SUPPORT) -> Segments:
    """The net in units of its mean size, about its centre."""
    unit = float(net.sizes.mean())
    centre = (np.minimum(net.starts, net.ends).min(axis=0) + np.maximum(net.starts, net.ends).max(axis=0)) / 2
    return Segments(
        starts=np.ascontiguousarray(((net.starts - centre) / unit).T),
        steps=np.ascontiguousarray(((net.ends - net.starts) / unit).T),
        shapes=(c * net.sizes / unit) ** 2,
        reaches=(support * net.sizes / unit) ** 2,
        struts=net.struts,
        power=exponent // 2,
        centre=centre,
        unit=unit,
    )


def boxes_over(segments: Segments, margin: float = 0.5, size: float = 0.5) -> Bins:
    ends = np.concatenate([segments.starts, segments.starts + segments.steps], axis=1)
    low = ends.min(axis=1) - margin
    shape = np.ceil((ends.max(axis=1) + margin - low) / size).astype(int)
    return bin_segments(segments, low, np.full(3, size), (shape[0], shape[1], shape[2]))


def at(net: Net, points: Floats, segments: Segments | None = None) -> Floats:
    """s at points (m, 3) in the net's own units."""
    segments = segments or segments_of(net)
    return field_at(segments, boxes_over(segments, 2.0), (points - segments.centre) / segments.unit)


def on_grid(segments: Segments, counts: tuple[int, int, int], rows: tuple[int, int] = (4, 4)) -> tuple[Floats, Floats, int]:
    """The field on a grid that overlaps the net by a little, its points (n, 3) in the net's units, and the half-reached."""
    ends = np.concatenate([segments.starts, segments.starts + segments.steps], axis=1)
    low, high = ends.min(axis=1) - 0.2, ends.max(axis=1) + 0.2
    step = float((high - low).max() / (max(counts) - 1))
    origin = (low + high) / 2 - step * (np.array(counts) - 1) / 2
    samples = (*rows, LANES)
    blocks = tuple(-(-count // size) for count, size in zip(counts, samples, strict=True))
    bins = bin_segments(segments, origin - step / 2, step * np.array(samples), blocks)
    values = np.full(counts, np.nan, np.float32)
    everywhere = np.ones(counts, bool)
    half_reached = field_on_blocks(segments, bins, origin, step, np.arange(np.prod(blocks)), everywhere, values)
    places = origin + step * np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
    return values, segments.centre + segments.unit * places.reshape(-1, 3), half_reached

"""The accessors of glTF: rows of numbers of any type in a buffer, spread, sparse or normalised."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats, Ints
from scaffold_geometry.files.text import AGAIN
from scaffold_pipeline.errors import StageError

_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MOST = 2**31
"""Most rows of an accessor without bytes; more would only fill the memory."""


class Accessors:
    """The accessors of one file; their sizes are checked against the available bytes."""

    def __init__(self, gltf: dict[str, Any], buffers: list[bytes], name: str) -> None:
        self._accessors: list[dict[str, Any]] = gltf.get("accessors", [])
        self._views: list[dict[str, Any]] = gltf.get("bufferViews", [])
        self._buffers, self._name = buffers, name

    def values(self, number: int) -> Floats:
        """Return the rows of accessor `number` as real numbers, (count, width); normalised integers are scaled."""
        raw = self._rows(number)
        values = raw.astype(np.float64)
        if self._accessors[number].get("normalized") and raw.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(raw.dtype).max, -1.0)
        return values

    def is_coded(self, number: int) -> bool:
        """Return whether accessor `number` has integers, which are not lengths by themselves."""
        accessor = self._accessors[number]
        return bool(np.dtype(_COMPONENTS[accessor["componentType"]]).kind in "iu" and not accessor.get("normalized"))

    def indices(self, number: int) -> Ints:
        """Return the integers of accessor `number`, (count,)."""
        raw = self._rows(number)
        if raw.dtype.kind not in "iu" or raw.shape[1] != 1:
            raise StageError(f"{self._name}: corners of faces must be single whole numbers; {AGAIN}")
        return raw[:, 0].astype(np.int64)

    def _rows(self, number: int) -> NDArray[Any]:
        if number < 0:
            raise IndexError(number)
        accessor = self._accessors[number]
        kind, width, count = (
            np.dtype(_COMPONENTS[accessor["componentType"]]),
            _WIDTHS[accessor["type"]],
            accessor["count"],
        )
        if "bufferView" in accessor:
            rows = self._view(accessor["bufferView"], accessor.get("byteOffset", 0), kind, width, count)
        elif not 0 <= count * width < _MOST:
            raise StageError(f"{self._name}: announces {count} rows without any numbers; {AGAIN}")
        else:
            rows = np.zeros((count, width), kind)
        return self._with_sparse(rows, accessor["sparse"]) if "sparse" in accessor else rows

    def _with_sparse(self, rows: NDArray[Any], sparse: dict[str, Any]) -> NDArray[Any]:
        """Return rows with the replacements of a sparse accessor."""
        at, new, count = sparse["indices"], sparse["values"], sparse["count"]
        kind = np.dtype(_COMPONENTS[at["componentType"]])
        places = self._view(at["bufferView"], at.get("byteOffset", 0), kind, 1, count)[:, 0].astype(np.int64)
        if len(places) and not 0 <= places.min() <= places.max() < len(rows):
            raise StageError(f"{self._name}: replaces row {places.max()} of {len(rows)}; {AGAIN}")
        replaced = rows.copy()
        replaced[places] = self._view(new["bufferView"], new.get("byteOffset", 0), rows.dtype, rows.shape[1], count)
        return replaced

    def _view(self, number: int, offset: int, kind: np.dtype[Any], width: int, count: int) -> NDArray[Any]:
        """Return `count` rows of `width` numbers that begin at `offset` of buffer view `number`."""
        if number < 0:
            raise IndexError(number)
        view = self._views[number]
        packed = [key for key in view.get("extensions", {}) if "meshopt" in key]
        buffer = self._buffers[view["buffer"]]
        start, stride = view.get("byteOffset", 0), view.get("byteStride") or kind.itemsize * width
        end = start + view["byteLength"]
        if packed and end > len(buffer):
            raise StageError(
                f"{self._name}: a mesh is compressed by {packed[0]}, not supported; export it as plain triangles"
            )
        needed = offset + stride * (count - 1) + kind.itemsize * width if count else 0
        if min(start, offset, count) < 0 or stride < kind.itemsize * width or start + needed > min(end, len(buffer)):
            raise StageError(
                f"{self._name}: announces {count} rows of {kind.itemsize * width} bytes, but "
                f"{max(min(end, len(buffer)) - start - offset, 0)} bytes are there; {AGAIN}"
            )
        if not count:
            return np.empty((0, width), kind)
        return np.ndarray((count, width), kind, buffer, start + offset, (stride, kind.itemsize))

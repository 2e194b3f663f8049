"""Meshes of lib3mf as arrays."""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Singles


def mesh_arrays(mesh: Any) -> tuple[Singles, NDArray[np.uint32]]:  # noqa: ANN401 - lib3mf ships no types
    """Return the vertices (n, 3) and faces (m, 3) of lib3mf's mesh, filled by its C functions.

    Its Python functions create an object for every vertex and triangle, gigabytes for a fine solid.
    """
    import lib3mf

    wrapper = lib3mf.get_wrapper()
    vertices = np.empty((mesh.GetVertexCount(), 3), np.float32)
    faces = np.empty((mesh.GetTriangleCount(), 3), np.uint32)
    for function, values, item in (
        (wrapper.lib.lib3mf_meshobject_getvertices, vertices, lib3mf.Position),
        (wrapper.lib.lib3mf_meshobject_gettriangleindices, faces, lib3mf.Triangle),
    ):
        if len(values):
            size, pointer = ctypes.c_uint64(len(values)), values.ctypes.data_as(ctypes.POINTER(item))
            wrapper.checkError(mesh, function(mesh._handle, size, ctypes.c_uint64(), pointer))  # noqa: SLF001 - see above
    return vertices, faces

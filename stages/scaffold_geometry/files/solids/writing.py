"""Write a solid to a verified file: rounded once, written, read back by other programs and compared."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scaffold_geometry.files.solids.checks import FileVerifier
from scaffold_geometry.files.solids.formats import FileFormat
from scaffold_geometry.files.solids.model import Mesh, Model, mesh_of_corners
from scaffold_geometry.surfaces.merge_corners import to_single
from scaffold_pipeline.artifacts import Solid
from scaffold_pipeline.errors import StageError, warn


def round_to_float32(solid: Solid) -> Mesh:
    """Return the mesh for all files, in float32, with equal vertices merged; warns if rounding moves vertices."""
    single = to_single(solid.vertices)
    moved = np.abs(single - solid.vertices)
    if moved.any():
        warn(
            f"solid: {int(moved.any(axis=1).sum())} of {len(moved)} vertices are not exact in float32; in the files "
            f"they are moved by up to {moved.max():.2g} mm"
        )
    return mesh_of_corners(single[solid.faces])


def write_verified(path: Path, file_format: FileFormat, model: Model, verifier: FileVerifier) -> float:
    """Write a file, read it with each of the format's readers, and return its volume, mm^3.

    Parameters
    ----------
    path
        The file to write.
    file_format
        Its writer, and the readers of two or more programs, as in `formats.FORMATS`.
    model
        The content of the file: the mesh of `round_to_float32`, a title, a colour.
    verifier
        The checks of each mesh read. One verifier for all files of a solid searches for self-intersections once.

    Raises
    ------
    StageError
        A reader fails, or the mesh is not closed, manifold, outward, free of self-intersections and equal to the
        model's to the bit, or has another volume, other pieces or closed pores; the error names the file.
    """
    try:
        file_format.write(path, model)
        return [verifier.volume_of(read(path), reader) for reader, read in file_format.readers.items()][-1]
    except StageError as error:
        raise StageError(f"{path.name}: {error}; no file was kept") from error

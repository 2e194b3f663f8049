"""A solid to a file that is known to hold it: rounded once, written, read back by others and compared."""

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
    """Return the mesh as all files hold it, float32 and merged by equal coordinates; a warning where that moves it."""
    single = to_single(solid.vertices)
    moved = np.abs(single - solid.vertices)
    if moved.any():
        warn(
            f"solid: {int(moved.any(axis=1).sum())} of {len(moved)} vertices are not exact in float32; in the files "
            f"they lie up to {moved.max():.2g} mm off"
        )
    return mesh_of_corners(single[solid.faces])


def write_verified(path: Path, file_format: FileFormat, model: Model, verifier: FileVerifier) -> float:
    """Write a file, have each of the format's readers read it, and return the volume that it holds, mm^3.

    Parameters
    ----------
    path
        The file to write.
    file_format
        How it is written, and the two programs or more that read it back. `formats.FORMATS` has ours.
    model
        What goes into the file: the mesh of `round_to_float32`, a title, a colour.
    verifier
        What each reading is compared with. One verifier for all files of a solid looks for self-intersections once.

    Raises
    ------
    StageError
        With the file's name, where a reader fails, or what it read is not closed, manifold, outward, free of
        self-intersections and to the bit the model's mesh, or has another volume, other pieces or closed pores.
    """
    try:
        file_format.write(path, model)
        return [verifier.volume_of(read(path), reader) for reader, read in file_format.readers.items()][-1]
    except StageError as error:
        raise StageError(f"{path.name}: {error}; no file was kept") from error

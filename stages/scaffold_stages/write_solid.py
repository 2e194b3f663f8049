"""Stage `write_solid`: write the solid to files for printing and viewing, each read back and checked, and a picture.

Files get their names after all checks have passed; until then they are in a temporary folder in `out`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from scaffold_geometry.drawing.renders import draw_in_child, draw_surface
from scaffold_geometry.files.solids.checks import FileVerifier, expect_solid
from scaffold_geometry.files.solids.formats import FORMATS
from scaffold_geometry.files.solids.model import Mesh, Model, mesh_of_corners
from scaffold_geometry.files.solids.pore_space import PoreSpace, pore_space
from scaffold_geometry.files.solids.writing import round_to_float32, write_verified
from scaffold_geometry.surfaces.merge_corners import to_single
from scaffold_pipeline.artifacts import Drawing, Fact, OuterShape, Solid, WrittenFiles
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.runs.store import hash_file
from scaffold_pipeline.stages.contract import EachOnce, Params, Title, stage

COARSE_STEP = 1e-3
"""Distance of neighbouring float32 numbers, mm, above which a warning is given: from 8.2 m on."""

Format = Literal["stl", "3mf", "obj", "ply", "glb"]


class WriteSolidParams(Params):
    """Parameters of `write_solid`."""

    formats: Annotated[tuple[Format, ...], EachOnce] = Field(default=("stl", "3mf"), min_length=1)
    """The files to write, each once: `solid.stl`, `.3mf`, `.obj`, `.ply`, `.glb`; mm, but a GLB's scene in m, y up."""

    name: Title = "scaffold"
    """Title in the 3MF and GLB files."""

    colour: str = Field(default="#E3DAC9", pattern="^#[0-9A-Fa-f]{6}$")
    """Colour in the 3MF and GLB files, "#RRGGBB", in quotes as # starts a comment in YAML; by default that of bone."""

    preview: bool = True
    """Whether to draw `preview.png`."""

    void: bool = False
    """Whether to write the pore space too, `void.stl` and so on in the same formats, for casting or flow."""


DRAWINGS = (Drawing("preview.png", "Solid", "Of the solid in the files.", "lead"),)


@stage(
    writes="written",
    version=5,
    drawings=DRAWINGS,
)
def write_solid(
    solid: Solid,
    outer: OuterShape | None = None,
    *,
    params: WriteSolidParams,
    out: Path,
    config_hash: str | None = None,
) -> WrittenFiles:
    """Write the solid as STL, 3MF, OBJ, PLY or GLB, each file read back by two programs and checked, and draw it.

    Optionally also the pore space within `outer`, in the same formats. Position and axes are kept, and coordinates are
    mm in float32, the same in all files. The 3MF file has the configuration's hash, `config_hash`, as metadata; OBJ,
    PLY and GLB have it in a comment. Raises `StageError` if the mesh in a file is not closed, manifold, outward, free
    of self-intersections and equal to the solid to the bit, or has another volume, other pieces or closed pores; no
    file is then kept. Warns if the picture cannot be drawn.
    """
    if params.void and outer is None:
        raise StageError(
            "void: needs the outer shape, but no earlier stage writes to slot 'outer'; name its slot with "
            "`from: {outer: NAME}`, or set void off"
        )
    mesh = round_to_float32(solid)
    model = Model(mesh, params.name, params.colour.upper(), config_hash)
    facts: dict[str, Fact] = {"coordinate_step": _coordinate_step(mesh)}
    with TemporaryDirectory(dir=out, prefix=".partial-") as name:
        folder = Path(name)
        facts |= _write_surface("solid", solid, model, params.formats, folder)
        if params.void and outer:
            facts |= _write_void(pore_space(outer, solid), model, params.formats, folder)
        for path in sorted(folder.iterdir()):
            path.replace(out / path.name)
    arrays = {"vertices": mesh.vertices, "faces": mesh.faces.astype(np.int32)}
    drawn = params.preview and draw_in_child(draw_surface, arrays, out / "preview.png")
    facts["preview"] = drawn or "not asked for"
    return WrittenFiles(facts)


def _write_surface(name: str, body: Solid, model: Model, formats: tuple[Format, ...], folder: Path) -> dict[str, Fact]:
    """Write a body in each format as the file `name`; return facts of the files."""
    verifier = FileVerifier(model.mesh, expect_solid(body))
    facts: dict[str, Fact] = {}
    for kind in formats:
        path = folder / f"{name}.{kind}"
        volume = write_verified(path, FORMATS[kind], model, verifier)
        facts |= _facts_of_file(path, kind, model.mesh, volume)
    return facts


def _write_void(space: PoreSpace, model: Model, formats: tuple[Format, ...], folder: Path) -> dict[str, Fact]:
    """Write the pore space in each format; return facts of the files."""
    mesh = mesh_of_corners(to_single(space.body.vertices)[space.body.faces])
    of_void = replace(model, mesh=mesh, title=f"{model.title}, pore space")
    facts = _write_surface("void", space.body, of_void, formats, folder)
    return {
        "void_volume_mm3": space.body.volume,
        "void_pieces": expect_solid(space.body).pieces,
        "void_inset_mm": space.inset,
        **{f"void_{name}": fact for name, fact in facts.items()},
    }


def _coordinate_step(mesh: Mesh) -> float:
    """Return the distance of neighbouring float32 numbers at the farthest vertex, mm; warns if it is coarse."""
    farthest = np.abs(mesh.vertices).max()
    step = float(np.spacing(farthest))
    if step > COARSE_STEP:
        warn(
            f"the solid reaches {farthest:.0f} mm from the origin, where the files' float32 coordinates are {step:.2g} "
            "mm apart; move the outer shape nearer to the origin for finer ones"
        )
    return step


def _facts_of_file(path: Path, kind: Format, mesh: Mesh, volume: float) -> dict[str, Fact]:
    return {
        f"{kind}_bytes": path.stat().st_size,
        f"{kind}_sha256": hash_file(path),
        f"{kind}_volume_mm3": volume,
        f"{kind}_triangles": len(mesh.faces),
        f"{kind}_read_by": ", ".join([*FORMATS[kind].readers, "manifold3d"]),
    }

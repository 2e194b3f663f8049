"""What pages are made of, small: a view, measures and a run directory, as the tests of pages use them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from scaffold_pipeline.artifacts import Declared, Drawing, Gate, Metric
from scaffold_pipeline.runs.store import hash_file

DECLARED = Declared(
    metrics=(
        Metric("porosity", "", "Porosity", "Share that is pore.", "Porosity", shown_in=("headline", "caption")),
        Metric("volume_mm3", "mm\u00b3", "Volume of the solid", "What has to be printed.", "Porosity"),
        Metric("strut_thickness_mean", "mm", "Strut thickness, mean", "The greatest ball.", "Struts"),
        Metric("tortuosity_{axis}", "", "Tortuosity along {axis}", "How winding pores are.", "Transport"),
    ),
    gates=tuple(
        ("mesh", gate)
        for gate in (
            Gate("manifold", "The surface is closed, with two triangles at each edge.", "gate_manifold"),
            Gate("one_piece", "The solid is one piece.", "gate_one_piece"),
            Gate("interrupted", "Struts are whole.", "gate_interrupted"),
            Gate("of_a_plug_in", "", "gate_of_a_plug_in"),
            Gate("porosity", "The porosity is the one asked for.", "gate_porosity"),
            Gate("min_strut", "The thinnest strut is as thick as asked for.", "min_strut"),
            Gate("min_throat", "The narrowest throat is as wide as asked for.", "min_throat"),
        )
    ),
    drawings=(
        Drawing("preview.png", "Solid", "", "lead"),
        Drawing("view.npz", "3-D view", "", "view"),
        Drawing("section_{axis}.svg", "Section across {axis}", "The solid is filled.", "section"),
    ),
)
"""What the stages of the record of a test are taken to declare."""

OCTAHEDRON = np.concatenate([np.eye(3), -np.eye(3)])
FACES = [(0, 1, 2), (1, 3, 2), (3, 4, 2), (4, 0, 2), (1, 0, 5), (3, 1, 5), (4, 3, 5), (0, 4, 5)]
MEASURES: dict[str, Any] = {
    "histograms": [
        {
            "name": "struts",
            "title": "Strut thickness",
            "unit": "mm",
            "edges": [0.1, 0.2, 0.3, 0.5],
            "shares": [0.25, 0.5, 0.25],
        }
    ],
    "curves": [
        {
            "name": "a",
            "title": "Accessible pores",
            "x_title": "diameter, mm",
            "y_title": "share",
            "x": [0.0, 1.0, 2.0],
            "y": [1.0, 0.8, 0.0],
        }
    ],
    "findings": [
        {"rule": "thin_strut", "message": "a strut of 0.1 mm", "places": [[0.5, 0.25, 1.0]]},
        {"rule": "overhang", "message": "one place", "places": [[-1.0, 0.0, 0.0]]},
        {"rule": "escape_hole", "message": "none is needed", "places": []},
    ],
}


def view_file(triangles: int = 8, **arrays: Sequence[Any]) -> bytes:
    """Return `view.npz` of an octahedron 6 mm wide in one of 8 mm, thicker towards its top."""
    parts = {
        "vertices": (3.0 * OCTAHEDRON).astype(np.float32),
        "faces": np.array(FACES, np.int32),
        "thickness": (OCTAHEDRON[:, 2] + 2.0).astype(np.float32),
        "outer_vertices": (4.0 * OCTAHEDRON).astype(np.float32),
        "outer_faces": np.array(FACES, np.int32),
        **{name: np.array(values) for name, values in arrays.items()},
    }
    stream = BytesIO()
    np.savez_compressed(stream, allow_pickle=False, triangles=np.int64(triangles), **parts)
    return stream.getvalue()


def write_run(
    folder: Path, record: Mapping[str, Any], metrics: Mapping[str, Any], measures: Mapping[str, Any] = MEASURES
) -> None:
    """Write a run directory with all that a page can show."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "metrics.json").write_text(json.dumps(metrics))
    (folder / "measures.json").write_text(json.dumps(measures))
    (folder / "config.yaml").write_text("name: heel\nstages: []\n")
    (folder / "view.npz").write_bytes(view_file(5_000_000))
    (folder / "section_x.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="8mm" height="8mm" viewBox="0 0 8 8">'
        '<circle cx="4" cy="4" r="3"/></svg>'
    )
    Image.new("RGB", (40, 40), (200, 40, 40)).save(folder / "preview.png")
    names = [path.name for path in sorted(folder.iterdir())]
    files = {name: {"sha256": hash_file(folder / name), "bytes": (folder / name).stat().st_size} for name in names}
    (folder / "run.json").write_text(json.dumps({**record, "files": files}))

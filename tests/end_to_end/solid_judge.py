"""Judge a run directory from outside the project: `solid_judge.py RUN_DIR POROSITY`, exit code 1 with the faults.

Reads the written files back with trimesh and manifold3d; nothing of this project is imported.
"""

import json
import sys
from pathlib import Path

import manifold3d
import numpy as np
import trimesh

TOLERANCE = 0.005


def faults_of(path: Path, outer_volume: float, porosity: float) -> list[str]:
    """Return what keeps the solid in `path` from being printable at its porosity."""
    mesh = trimesh.load_mesh(path, process=True)
    if path.suffix == ".glb":
        mesh.apply_scale(1000.0)  # trimesh applies the scene's matrix, to metres
    mesh.merge_vertices()
    faults = []
    if not (mesh.is_watertight and mesh.is_winding_consistent):
        faults.append("not closed and consistently wound")
    body = manifold3d.Manifold(manifold3d.Mesh64(np.array(mesh.vertices, "f8"), np.array(mesh.faces, "u8")))
    if body.status().name != "NoError" or len(body.decompose()) != 1:
        faults.append(f"manifold3d: {body.status().name}, {len(body.decompose())} pieces")
    got = 1.0 - mesh.volume / outer_volume
    if abs(got - porosity) > TOLERANCE:
        faults.append(f"porosity {got:.4f} instead of {porosity}")
    return faults


def main(folder: Path, porosity: float) -> int:
    """Print and count the faults of every solid in a run directory."""
    metrics = json.loads((folder / "metrics.json").read_text())
    files = sorted(folder.glob("solid.*"))
    faults = [f"{path}: {fault}" for path in files for fault in faults_of(path, metrics["outer_volume_mm3"], porosity)]
    faults += [] if files else [f"{folder}: holds no solid"]
    faults += [] if metrics["quality"] == "pass" else [f"{folder}: quality {metrics['quality']}"]
    print("\n".join(faults) or f"{folder}: {len(files)} files, manifold, in one piece, porosity {porosity}")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), float(sys.argv[2])))

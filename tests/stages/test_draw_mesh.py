from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from geometry.drawing.test_renders import can_draw
from scaffold_geometry.drawing import renders
from scaffold_pipeline.artifacts import PlanarMesh, VolumeMesh
from scaffold_pipeline.errors import PipelineWarning, StageError
from scaffold_stages.draw_mesh import DrawMeshParams, draw_mesh
from shapes import tetrahedra

SQUARE = PlanarMesh(np.array([[0, 0, 0], [5, 0, 0], [5, 5, 0], [0, 5, 0]], float), quadrangles=np.array([[0, 1, 2, 3]]))


def pixels(mesh: VolumeMesh | PlanarMesh, out: Path, *, channels: bool) -> np.ndarray:
    """Return the picture of a mesh, its foot with the scale bar left out."""
    if not can_draw():
        pytest.skip("VTK cannot draw off-screen here: on Debian it needs libegl1 and libgl1-mesa-dri")
    assert draw_mesh(mesh, params=DrawMeshParams(channels=channels), out=out).facts == {"mesh_picture": "mesh.png"}
    image = Image.open(BytesIO((out / "mesh.png").read_bytes())).convert("RGB")
    return np.asarray(image).astype(int)[:-100]


@pytest.mark.parametrize("mesh", [tetrahedra((1, 1, 1), edge=5.0), SQUARE], ids=["tetrahedra", "planar"])
def test_struts_are_drawn_in_brown_and_channels_on_request_in_blue(mesh: VolumeMesh | PlanarMesh, tmp_path: Path):
    bare, full = (pixels(mesh, tmp_path, channels=channels) for channels in (False, True))
    is_brown, is_blue = ((image[..., 0] - image[..., 2]) * sign > 20 for image, sign in ((bare, 1), (full, -1)))
    assert 0.005 < is_brown.mean() < 0.3
    assert is_blue.sum() > 500
    assert not ((bare[..., 2] - bare[..., 0]) > 20).any()


def test_a_picture_that_cannot_be_drawn_is_a_warning(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def die(*_: object, **__: object) -> None:
        raise StageError("was ended by SIGSEGV")

    monkeypatch.setattr(renders, "call_in_child", die)
    with pytest.warns(PipelineWarning, match=r"no mesh\.png was drawn: .*SIGSEGV.*libegl1"):
        draw_mesh(SQUARE, params=DrawMeshParams(), out=tmp_path)
    assert not list(tmp_path.iterdir())

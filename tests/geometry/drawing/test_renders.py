from __future__ import annotations

import subprocess
import sys
from functools import cache
from io import BytesIO
from itertools import product

import numpy as np
import pytest
from PIL import Image

from scaffold_geometry.drawing.renders import draw_surface, fit_view, round_length
from scaffold_pipeline.processes.isolation import call_in_child

WINDOW = "vtkEGLRenderWindow" if sys.platform == "linux" else ""
PROBE = """
import os, sys
if sys.argv[1]:
    os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = sys.argv[1]
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(64, 64))
plotter.add_mesh(pyvista.Sphere())
plotter.screenshot(None, return_img=True)
"""
CORNERS = np.array(list(product((0.0, 1.0), repeat=3)))
CUBE = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]),
        *([2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),
    ]
)


@cache
def can_draw() -> bool:
    probe = [sys.executable, "-c", PROBE, WINDOW]
    return subprocess.run(probe, check=False, capture_output=True, timeout=120).returncode == 0


@cache
def draw(offset: float = 0.0) -> bytes:
    """Return the picture of a cube of 10 mm."""
    if not can_draw():
        pytest.skip("VTK cannot draw off-screen here: on Debian it needs libegl1 and libgl1-mesa-dri")
    arrays = {"vertices": 10.0 * CORNERS + offset, "faces": CUBE}
    return call_in_child(draw_surface, arrays, {"window": WINDOW}, seconds=120, about="a test")["png"].tobytes()


def pixels(png: bytes) -> np.ndarray:
    return np.asarray(Image.open(BytesIO(png)).convert("RGB")).astype(int)


def test_a_cube_fills_the_picture_on_white():
    image = pixels(draw())
    ink = np.argwhere((image < 250).any(axis=2))

    assert (image[:20] == 255).all()
    assert 0.2 < (image < 250).any(axis=2).mean() < 0.8
    assert np.ptp(ink[:, 1]) > 0.7 * image.shape[1]


def test_faces_to_and_from_the_light_differ_and_are_bone_coloured():
    image = pixels(draw())
    colours = image[100:-120][(image[100:-120] < 250).any(axis=2)]

    assert np.ptp(colours.sum(axis=1)) > 60
    assert (colours[:, 0] >= colours[:, 2]).mean() > 0.95


def test_the_scale_bar_has_its_length():
    image, view = pixels(draw()), fit_view(10.0 * CORNERS)
    bar = (image[view.height - 27] == (51, 55, 61)).all(axis=1).sum()

    assert image.shape == (view.height, view.width, 3)
    assert bar * view.mm_per_pixel == pytest.approx(2.0, abs=view.mm_per_pixel)


def test_a_surface_far_from_the_origin_looks_the_same():
    near, far = (pixels(draw(offset)) for offset in (0.0, 1e5))

    assert np.abs(near - far).mean() < 0.5


@pytest.mark.parametrize("size", [(1.0, 1.0, 1.0), (400.0, 30.0, 30.0), (30.0, 400.0, 30.0), (5.0, 5.0, 90.0)])
def test_all_of_a_surface_is_in_view_whatever_its_shape(size: tuple[float, float, float]):
    vertices = CORNERS * size + 7.0
    view = fit_view(vertices)
    across, upward, _ = np.abs((vertices - view.centre) @ view.axes.T).max(axis=0) / view.mm_per_pixel

    assert np.allclose(view.axes @ view.axes.T, np.eye(3))
    assert np.linalg.det(view.axes) == pytest.approx(1.0)
    assert across <= view.width / 2
    assert upward <= (view.height - 64) / 2
    assert max(across / view.width, upward / (view.height - 64)) > 0.45
    assert max(view.width, view.height) <= 1200


def test_a_round_length_is_the_next_below():
    assert [round_length(most) for most in (0.3, 1.0, 7.9, 49.0, 50.0, 1e-3)] == [0.2, 1.0, 5.0, 20.0, 50.0, 1e-3]

"""Pictures of surfaces and meshes, drawn off-screen in a child process: a missing GL library crashes the process."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scaffold_geometry.arrays import Floats
from scaffold_pipeline.errors import StageError, warn
from scaffold_pipeline.processes.isolation import call_in_child

if TYPE_CHECKING:
    import pyvista

Image: TypeAlias = NDArray[np.uint8]

RENDER_SECONDS = 300.0
"""Time for a picture; one of 8 million triangles takes half a minute on two busy cores, without a GPU."""

_WINDOWS = ("vtkEGLRenderWindow", "vtkOSOpenGLRenderWindow") if sys.platform == "linux" else ("",)

_BONE = "#f2e8d5"
_STRUT, _CHANNEL = "#b08d57", "#2f6f9f"
_STRUT_WIDTH, _CHANNEL_WIDTH = 10.0, 6.0  # pixels before shrinking
_INK = (51, 55, 61)
_WIDTH, _HEIGHT, _LEAST_SIDE = 1200, 960, 640  # pixels, without the foot with the scale bar
_FOOT, _MARGIN = 64, 24
_BAR_HEIGHT = 6
_OVERSAMPLING = 2  # a pixel is the mean of 2 x 2: VTK's own antialiasing takes three times as long here
_SMOOTH_UP_TO = 2_000_000  # triangles; smaller ones are about a pixel and need no smooth shading
_SHARP = 20.0  # degrees; with more, the rim of a pore at a shallow angle looks like a scratch across a flat face
_SHADOW_REACH = 0.04  # diagonals; radius of ambient occlusion
_BAR_SHARE = 0.22


@dataclass(frozen=True)
class View:
    """The camera: picture size in pixels, mm per pixel, and the axes (right, up, towards the eye)."""

    width: int
    height: int
    mm_per_pixel: float
    axes: Floats
    centre: Floats


def draw_in_child(draw: Callable[..., dict[str, NDArray[Any]]], arrays: dict[str, NDArray[Any]], path: Path) -> str:
    """Write the PNG that `draw` makes from `arrays` to `path`; return the file's name, or the reason why there is none.

    A picture that cannot be drawn is a `PipelineWarning`: all other results are complete without it.
    """
    reasons = []
    for window in _WINDOWS:
        try:
            picture = call_in_child(draw, arrays, {"window": window}, seconds=RENDER_SECONDS, about=window or "VTK")
        except StageError as error:
            reasons.append(str(error))
            continue
        path.write_bytes(picture["png"].tobytes())
        return path.name
    reason = "; ".join(reasons)
    warn(
        f"no {path.name} was drawn: {reason}; off-screen drawing needs, on Debian, libegl1 and libgl1-mesa-dri; "
        "all other files are complete"
    )
    return f"none: {reason}"


def draw_surface(
    vertices: NDArray[np.floating], faces: NDArray[np.integer], window: str = ""
) -> dict[str, NDArray[Any]]:
    """Return a PNG of a surface, `vertices` (n, 3) mm, `faces` (m, 3), as bytes: `png`, (k,) uint8.

    A three-quarter view in parallel projection, with a scale bar. `window` is the class of VTK's window; it has effect
    only in a process that has not imported VTK yet.
    """
    view = fit_view(vertices)
    return _render(vertices, view, lambda plotter: _add_surface(plotter, vertices - view.centre, faces), window)


def draw_segments(struts: Floats, channels: Floats, window: str = "") -> dict[str, NDArray[Any]]:
    """Return a PNG of struts (k, 2, 3) and, thinner and blue, channels (h, 2, 3), mm, in the form of `draw_surface`."""
    ends = np.concatenate([struts, channels]).reshape(-1, 3)
    view = fit_view(ends)

    def add(plotter: pyvista.Plotter) -> None:
        _add_lines(plotter, struts - view.centre, _STRUT, _STRUT_WIDTH)
        _add_lines(plotter, channels - view.centre, _CHANNEL, _CHANNEL_WIDTH)

    return _render(ends, view, add, window)


def fit_view(vertices: NDArray[np.floating]) -> View:
    """Return the view that fills the picture with `vertices` (n, 3), seen from the front, the side and above."""
    width_x, width_y, _ = np.ptp(vertices, axis=0)
    eye = np.array([0.55, -0.75, 0.37]) if width_x >= width_y else np.array([0.75, -0.55, 0.37])
    eye /= np.linalg.norm(eye)
    right = np.cross([0.0, 0.0, 1.0], eye)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(eye, right), eye])
    projected = vertices @ axes.T
    low, high = projected.min(axis=0), projected.max(axis=0)
    across, upward = np.maximum((high - low)[:2], np.finfo(np.float32).tiny)
    mm_per_pixel = max(across / (_WIDTH - 2 * _MARGIN), upward / (_HEIGHT - 2 * _MARGIN))
    width = max(_LEAST_SIDE, round(across / mm_per_pixel) + 2 * _MARGIN)
    height = max(_LEAST_SIDE, round(upward / mm_per_pixel) + 2 * _MARGIN) + _FOOT
    return View(width, height, mm_per_pixel, axes, (low + high) / 2.0 @ axes)


def round_length(most: float) -> float:
    """Return the greatest number of ..., 1, 2, 5, 10, 20, ... up to `most` > 0.

    >>> [round_length(length) for length in (0.3, 1.0, 7.9, 49.0)]
    [0.2, 1.0, 5.0, 20.0]
    """
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= most * (1.0 + 1e-9)))


def _render(
    points: NDArray[np.floating], view: View, add: Callable[[pyvista.Plotter], None], window: str
) -> dict[str, NDArray[Any]]:
    """Return a PNG of the objects that `add` adds to a plotter, all inside the bounding box of `points` (n, 3)."""
    if window:
        os.environ["VTK_DEFAULT_OPENGL_WINDOW"] = window
    import pyvista as pv

    size, extent = (_OVERSAMPLING * view.width, _OVERSAMPLING * view.height), np.ptp(points, axis=0)
    length = float(np.linalg.norm(extent))
    plotter = pv.Plotter(off_screen=True, window_size=size, lighting="none")
    plotter.set_background("white")
    add(plotter)
    _light(plotter, length)
    _aim(plotter, view, length)
    _label(plotter, view, extent)
    image = _downsample(plotter.screenshot(None, return_img=True)[:, :, :3])
    plotter.close()
    bar = round_length(_BAR_SHARE * view.width * view.mm_per_pixel)
    top = view.height - _MARGIN - _BAR_HEIGHT
    image[top : top + _BAR_HEIGHT, _MARGIN : _MARGIN + round(bar / view.mm_per_pixel)] = _INK
    return {"png": to_png(image)}


def _add_surface(plotter: pyvista.Plotter, centred: Floats, faces: NDArray[np.integer]) -> None:
    import pyvista as pv

    mesh = pv.PolyData.from_regular_faces(centred.astype(np.float32), np.asarray(faces))
    is_smooth = len(faces) <= _SMOOTH_UP_TO
    if is_smooth:
        mesh = mesh.compute_normals(
            cell_normals=False,
            split_vertices=True,
            feature_angle=_SHARP,
            consistent_normals=False,
            auto_orient_normals=False,
        )
    shine = {"ambient": 0.38, "diffuse": 0.72, "specular": 0.1, "specular_power": 20}
    plotter.add_mesh(mesh, color=_BONE, smooth_shading=is_smooth, split_sharp_edges=False, **shine)


def _add_lines(plotter: pyvista.Plotter, segments: Floats, colour: str, width: float) -> None:
    import pyvista as pv

    if len(segments):
        lines = pv.line_segments_from_points(segments.reshape(-1, 3))
        plotter.add_mesh(lines, color=colour, line_width=width, render_lines_as_tubes=True)


def _light(plotter: pyvista.Plotter, length: float) -> None:
    import pyvista as pv

    for position, intensity in (((-0.6, 0.9, 1.0), 0.9), ((1.0, 0.1, 0.6), 0.25)):
        plotter.add_light(pv.Light(light_type="camera light", position=position, intensity=intensity))
    plotter.enable_ssao(radius=_SHADOW_REACH * length, bias=3e-3 * length, kernel_size=16, blur=True)


def _aim(plotter: pyvista.Plotter, view: View, length: float) -> None:
    """Aim the camera so that the middle of the surface, at the origin, is in the middle of the part above the foot."""
    _, up, eye = view.axes
    focus = -up * (_FOOT / 2.0) * view.mm_per_pixel
    plotter.enable_parallel_projection()
    plotter.camera.focal_point = focus
    plotter.camera.position = focus + 2.0 * length * eye
    plotter.camera.up = up
    plotter.camera.parallel_scale = view.height * view.mm_per_pixel / 2.0
    plotter.camera.clipping_range = (length, 3.0 * length)


def _label(plotter: pyvista.Plotter, view: View, size: Floats) -> None:
    bar = round_length(_BAR_SHARE * view.width * view.mm_per_pixel)
    extent = " \u00d7 ".join(f"{length:.3g}" for length in size)
    for text, x, align in ((f"{bar:g} mm", _MARGIN, "left"), (f"{extent} mm", view.width - _MARGIN, "right")):
        actor = plotter.add_text(
            text, position=(_OVERSAMPLING * x, _OVERSAMPLING * (_MARGIN + 14)), font_size=20, color=_INK
        )
        actor.prop.justification_horizontal = align


def _downsample(image: Image) -> Image:
    height, width = image.shape[0] // _OVERSAMPLING, image.shape[1] // _OVERSAMPLING
    tiles = image.reshape(height, _OVERSAMPLING, width, _OVERSAMPLING, 3)
    mean: Floats = tiles.mean(axis=(1, 3))
    return mean.round().astype(np.uint8)


def to_png(image: Image) -> Image:
    """Return the bytes of a PNG file of `image`, (height, width, 3)."""
    import pyvista as pv
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOImage import vtkPNGWriter

    grid = pv.ImageData(dimensions=(image.shape[1], image.shape[0], 1))
    grid.point_data["colour"] = image[::-1].reshape(-1, 3)
    writer = vtkPNGWriter()
    writer.SetInputData(grid)
    writer.WriteToMemoryOn()
    writer.Write()
    return np.array(vtk_to_numpy(writer.GetResult()), dtype=np.uint8)

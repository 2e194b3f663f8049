"""The normalised field against an oracle by other means, its laws, and that nothing of how it is computed shows.

`NUMBA_DISABLE_JIT=1 pytest tests/geometry/fields/test_shepard.py` runs interpreted what is not skipped with a reason.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geometry.fields.oracle import Floats, Ints, eight_hexahedra, icosahedron, one_tetrahedron
from geometry.fields.shepard_oracle import Net, extremes, graded, jittered, mixed, net_of, shepard, tetrahedra
from scaffold_geometry.fields import certificate, shepard_grid
from scaffold_geometry.fields import shepard as shepard_module
from scaffold_geometry.fields.certificate import Rings, extremes_of
from scaffold_geometry.fields.shepard import Bins, Segments, bin_segments, field_at
from scaffold_geometry.fields.shepard_grid import TILE, field_on_tiles
from scaffold_pipeline.errors import StageError

C, EXPONENT, SUPPORT = 0.02, 4, 1.3
MESHES = {
    "eight_hexahedra": eight_hexahedra,
    "icosahedron": icosahedron,
    "graded": graded,
    "mixed": mixed,
    "jittered": lambda: jittered(tetrahedra((2, 2, 1))),
}


def segments_of(net: Net, c: float = C, exponent: int = EXPONENT, support: float = SUPPORT) -> Segments:
    """The net in units of its mean size, about its centre."""
    unit = float(net.sizes.mean())
    centre = (np.minimum(net.starts, net.ends).min(axis=0) + np.maximum(net.starts, net.ends).max(axis=0)) / 2
    return Segments(
        starts=np.ascontiguousarray(((net.starts - centre) / unit).T),
        steps=np.ascontiguousarray(((net.ends - net.starts) / unit).T),
        shapes=(c * net.sizes / unit) ** 2,
        reaches=(support * net.sizes / unit) ** 2,
        struts=net.struts,
        power=exponent // 2,
        centre=centre,
        unit=unit,
    )


def boxes_over(segments: Segments, margin: float = 0.5, size: float = 0.5) -> Bins:
    ends = np.concatenate([segments.starts, segments.starts + segments.steps], axis=1)
    low = ends.min(axis=1) - margin
    shape = np.ceil((ends.max(axis=1) + margin - low) / size).astype(int)
    return bin_segments(segments, low, np.full(3, size), (shape[0], shape[1], shape[2]))


def at(net: Net, points: Floats, segments: Segments | None = None) -> Floats:
    """s at points (m, 3) in the net's own units."""
    segments = segments or segments_of(net)
    return field_at(segments, boxes_over(segments, 2.0), (points - segments.centre) / segments.unit)


def on_grid(
    segments: Segments, counts: tuple[int, int, int], tiles: tuple[int, int, int] = (1, 1, 1)
) -> tuple[Floats, Floats, int]:
    """The field on a grid a little larger than the net, its points (n, 3) in the net's units, and the half-reached.

    Segments are listed for boxes of so many `tiles`.
    """
    ends = np.concatenate([segments.starts, segments.starts + segments.steps], axis=1)
    low, high = ends.min(axis=1) - 0.2, ends.max(axis=1) + 0.2
    step = float((high - low).max() / (max(counts) - 1))
    origin = (low + high) / 2 - step * (np.array(counts) - 1) / 2
    samples = TILE * np.array(tiles)
    nx, ny, nz = (-(-count // size) for count, size in zip(counts, samples.tolist(), strict=True))
    bins = bin_segments(segments, origin - step / 2, step * samples, (nx, ny, nz))
    values = np.full(counts, np.nan, np.float32)
    everywhere = np.ones(counts, bool)
    half_reached = field_on_tiles(segments, bins, origin, step, all_tiles(counts), everywhere, values)
    places = origin + step * np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1)
    return values, segments.centre + segments.unit * places.reshape(-1, 3), half_reached


def all_tiles(counts: tuple[int, ...]) -> Ints:
    return np.arange(np.prod([-(-count // TILE) for count in counts]))


compiled_only = pytest.mark.skipif(bool(numba.config.DISABLE_JIT), reason="too many pairs to be summed interpreted")


@compiled_only
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("exponent", [2, 4, 6, 8])
def test_the_field_equals_the_oracle(name: str, exponent: int):
    net = net_of(MESHES[name]())
    segments = segments_of(net, exponent=exponent)
    values, points, _ = on_grid(segments, (9, 7, 19))
    expected = shepard(net, points, C, exponent, SUPPORT)
    np.testing.assert_allclose(values.ravel(), expected, rtol=0, atol=1e-5)
    np.testing.assert_allclose(at(net, points, segments), expected, rtol=0, atol=1e-12)


def test_the_field_of_one_cell_equals_the_oracle():
    net = net_of(one_tetrahedron())
    values, points, _ = on_grid(segments_of(net), (3, 2, 3))
    np.testing.assert_allclose(values.ravel(), shepard(net, points, C, EXPONENT, SUPPORT), rtol=0, atol=1e-5)
    np.testing.assert_allclose(at(net, points), shepard(net, points, C, EXPONENT, SUPPORT), rtol=0, atol=1e-12)


@compiled_only
def test_vertices_as_segments_of_no_length_equal_the_oracle():
    net = net_of(MESHES["jittered"](), solid="vertices")
    values, points, _ = on_grid(segments_of(net), (9, 7, 19))
    np.testing.assert_allclose(values.ravel(), shepard(net, points, C, EXPONENT, SUPPORT), rtol=0, atol=1e-5)
    np.testing.assert_allclose(at(net, points), shepard(net, points, C, EXPONENT, SUPPORT), rtol=0, atol=1e-12)


@compiled_only
@pytest.mark.parametrize("name", ["graded", "jittered"])
def test_how_segments_are_listed_and_tiles_are_shared_out_changes_no_bit(name: str):
    segments, counts = segments_of(net_of(MESHES[name]())), (17, 35, 61)
    whole, _, half_reached = on_grid(segments, counts)
    for tiles in [(1, 1, 2), (2, 1, 1), (1, 3, 4), (2, 3, 4)]:
        values, _, count = on_grid(segments, counts, tiles)
        np.testing.assert_array_equal(values, whole)
        assert count == half_reached


@compiled_only
def test_a_part_of_the_tiles_is_filled_alone():
    segments, counts = segments_of(net_of(MESHES["jittered"]())), (17, 18, 37)
    whole, _, _ = on_grid(segments, counts)
    ends = np.concatenate([segments.starts, segments.starts + segments.steps], axis=1)
    low, high = ends.min(axis=1) - 0.2, ends.max(axis=1) + 0.2
    step = float((high - low).max() / (max(counts) - 1))
    origin = (low + high) / 2 - step * (np.array(counts) - 1) / 2
    bins = bin_segments(segments, origin - step / 2, np.full(3, TILE * step), (2, 2, 3))
    values = np.full(counts, 7.0, np.float32)
    inside = np.zeros(counts, bool)
    assert field_on_tiles(segments, bins, origin, step, np.array([2, 7]), inside, values) == 0
    filled = np.zeros(counts, bool)
    filled[:TILE, :TILE, 2 * TILE :] = filled[TILE:, :TILE, TILE : 2 * TILE] = True
    np.testing.assert_array_equal(values[filled], whole[filled])
    assert (values[~filled] == 7.0).all()


@compiled_only
def test_reach_ends_where_the_sums_do():
    """A brick that is skipped would have added nothing: with none skipped, no bit changes."""
    segments, counts = segments_of(net_of(MESHES["graded"]())), (17, 35, 61)
    skipping, _, _ = on_grid(segments, counts)
    table = shepard_grid._table
    try:
        shepard_grid._table = lambda *grid: np.where(np.arange(16) == 15, 1e3, table(*grid))
        np.testing.assert_array_equal(on_grid(segments, counts)[0], skipping)
    finally:
        shepard_grid._table = table


@compiled_only
def test_the_size_of_boxes_and_the_company_of_a_point_change_no_bit():
    net = net_of(MESHES["jittered"]())
    segments = segments_of(net)
    points = np.random.default_rng(2).uniform(-1.0, 1.0, (50, 3))
    small, large = (field_at(segments, boxes_over(segments, 0.5, size), points) for size in (0.2, 3.0))
    np.testing.assert_array_equal(small, large)
    alone = [field_at(segments, boxes_over(segments), point[None])[0] for point in points]
    np.testing.assert_array_equal(small, alone)


@compiled_only
@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="one thread is all there is")
def test_threads_and_repetition_change_no_bit():
    net = net_of(MESHES["graded"]())
    segments = segments_of(net)
    threads = numba.get_num_threads()
    results = []
    try:
        for count in (1, 2, 2, 1):
            numba.set_num_threads(count)
            values, points, _ = on_grid(segments, (17, 18, 37))
            results.append((values, at(net, points[::7], segments)))
    finally:
        numba.set_num_threads(threads)
    for values, precise in results[1:]:
        np.testing.assert_array_equal(values, results[0][0])
        np.testing.assert_array_equal(precise, results[0][1])


@compiled_only
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize(("c", "exponent", "support"), [(1e-6, 8, 0.8), (0.02, 4, 1.3), (1.0, 2, 3.0)])
def test_values_lie_between_minus_one_and_one(name: str, c: float, exponent: int, support: float):
    values, _, _ = on_grid(segments_of(net_of(MESHES[name]()), c, exponent, support), (13, 13, 25))
    assert -1.0 <= values.min() < values.max() <= 1.0


def test_a_shape_parameter_that_would_leave_single_precision_is_raised(monkeypatch: pytest.MonkeyPatch):
    segments = segments_of(net_of(eight_hexahedra()), c=1e-7, exponent=8)
    assert set(on_skeleton(segments).ravel().round(6)) == {-1.0, 1.0}
    monkeypatch.setattr(shepard_grid, "LEAST_SHAPE", 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        assert np.isnan(on_skeleton(segments)).any()


def on_skeleton(segments: Segments) -> Floats:
    """The field at the corners, edge middles, face centres and cell centres of the eight hexahedra."""
    bins = bin_segments(segments, np.full(3, -1.25), np.full(3, TILE * 0.5), (1, 1, 1))
    values = np.empty((5, 5, 5), np.float32)
    field_on_tiles(segments, bins, np.full(3, -1.0), 0.5, np.array([0]), np.ones_like(values, bool), values)
    return values


@compiled_only
@pytest.mark.parametrize("name", ["graded", "jittered", "mixed"])
def test_rotation_translation_and_units_change_nothing(name: str):
    net = net_of(MESHES[name]())
    low, high = net.starts.min(axis=0) - 0.5, net.starts.max(axis=0) + 0.5
    points = np.random.default_rng(3).uniform(low, high, (200, 3))
    expected = at(net, points)
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    motions = {
        "rotated": lambda x: x @ turn.T,
        "moved by 20 m": lambda x: x + np.array([20_000.0, -7_000.0, 20_000.0]),
        "in micrometres": lambda x: 1e3 * x,
        "in metres": lambda x: 1e-3 * x,
    }
    for motion, move in motions.items():
        scale = float(np.linalg.norm(move(points[1]) - move(points[0])) / np.linalg.norm(points[1] - points[0]))
        moved = Net(move(net.starts), move(net.ends), net.values, scale * net.sizes)
        np.testing.assert_allclose(at(moved, move(points)), expected, rtol=0, atol=1e-8, err_msg=motion)


@compiled_only
def test_single_precision_does_not_lose_a_shape_far_from_the_origin():
    net = net_of(MESHES["jittered"]())
    far = Net(net.starts + 20_000.0, net.ends + 20_000.0, net.values, net.sizes)
    one, other = (on_grid(segments_of(of), (9, 9, 17))[0] for of in (net, far))
    np.testing.assert_allclose(other, one, rtol=0, atol=1e-6)


def strut_and_channel() -> Segments:
    """A strut along z at x = 0 with support 1.3 and a channel beside it at x = 1 with support 0.65."""
    return Segments(
        starts=np.array([(0.0, 1.0), (0.0, 0.0), (0.0, 0.0)]),
        steps=np.array([(0.0, 0.0), (0.0, 0.0), (1.0, 1.0)]),
        shapes=np.array([0.02, 0.01]) ** 2,
        reaches=np.array([1.3, 0.65]) ** 2,
        struts=1,
        power=2,
        centre=np.zeros(3),
        unit=1.0,
    )


def along_x(segments: Segments, *xs: float) -> Floats:
    points = np.column_stack([xs, np.zeros(len(xs)), np.full(len(xs), 0.5)])
    return field_at(segments, boxes_over(segments, 4.0), points)


def test_the_support_is_compact_as_defined():
    segments = strut_and_channel()
    solid = (0.5**2 + 0.02**2) ** -2 * (1 - (0.5 / 1.3) ** 2) ** 2
    void = (0.5**2 + 0.01**2) ** -2 * (1 - (0.5 / 0.65) ** 2) ** 2
    assert along_x(segments, 0.5)[0] == pytest.approx((solid - void) / (solid + void), abs=1e-14)
    only_solid, both, only_void = (-1.299, 0.0, 0.349), (0.351, 0.9, 1.299), (1.301, 1.649)
    np.testing.assert_array_equal(along_x(segments, *only_solid), 1.0)
    np.testing.assert_array_equal(along_x(segments, *only_void), -1.0)
    assert (np.abs(along_x(segments, *both)) < 1.0).all()


def test_the_field_is_continuous_across_the_edge_of_a_support():
    segments = strut_and_channel()
    for edge, beyond in ((0.35, 1.0), (1.3, -1.0)):
        towards = np.sign(0.8 - edge) * np.geomspace(1e-2, 1e-6, 5)
        steps = np.abs(along_x(segments, *(edge + towards)) - beyond)
        assert steps[0] < 1e-3
        np.testing.assert_allclose(steps[1:] / steps[:-1], 0.01, rtol=0.2)  # the taper has a double zero


def test_a_point_that_nothing_reaches_is_void():
    np.testing.assert_array_equal(along_x(strut_and_channel(), -1.301, 1.651, 3.0, -3.0), -1.0)


def test_samples_inside_that_one_sign_alone_reaches_are_counted():
    segments = strut_and_channel()
    xs = np.arange(-2.0, 2.5, 0.5)
    bins = bin_segments(segments, np.array([-2.25, -0.25, 0.25]), np.full(3, TILE * 0.5), (1, 1, 1))
    values = np.empty((9, 1, 1), np.float32)
    arguments = (segments, bins, np.array([-2.0, 0.0, 0.5]), 0.5, np.arange(1))
    reached = [field_on_tiles(*arguments, (xs == x)[:, None, None], values) == 0 for x in xs]
    assert xs[reached].tolist() == [0.5, 1.0]
    assert values.ravel()[[0, 1, 2, 4, 7, 8]].tolist() == [-1.0, -1.0, 1.0, 1.0, -1.0, -1.0]
    assert field_on_tiles(*arguments, np.ones((9, 1, 1), bool), values) == 7


def test_segments_of_next_to_no_length_are_points():
    tiny = strut_and_channel()
    tiny.steps[:] = 1e-25
    points = replace(tiny, steps=np.zeros((3, 2)))
    slanted = replace(tiny, steps=np.array([(1e-25, 0.0), (0.0, 1e-22), (1.0, 1.0)]))
    for segments, plain in ((tiny, points), (slanted, strut_and_channel())):
        values, _, half_reached = on_grid(segments, (5, 4, 6))
        expected, _, expected_count = on_grid(plain, (5, 4, 6))
        np.testing.assert_allclose(values, expected, rtol=0, atol=5e-6)  # frames of their own
        assert half_reached == expected_count
        np.testing.assert_allclose(along_x(segments, -0.3, 0.4, 0.7), along_x(plain, -0.3, 0.4, 0.7), atol=1e-12)


@compiled_only
def test_symmetric_meshes_give_symmetric_fields():
    for make in (eight_hexahedra, icosahedron):
        net = net_of(make())
        values, points, _ = on_grid(segments_of(net), (17, 17, 17))
        precise = at(net, points).reshape(values.shape)
        for mirrored in (np.flip(precise, 0), np.flip(precise, 1), np.flip(precise, 2), precise.transpose(1, 2, 0)):
            np.testing.assert_allclose(mirrored, precise, rtol=0, atol=1e-12)
        for mirrored in (np.flip(values, 0), np.flip(values, 1), np.flip(values, 2), values.transpose(1, 2, 0)):
            np.testing.assert_allclose(mirrored, values, rtol=0, atol=4e-6)


@compiled_only
@pytest.mark.parametrize("name", MESHES)
def test_the_certificate_is_the_extreme_of_a_fine_sampling(name: str):
    net = net_of(MESHES[name]())
    greatest, least = extremes(net, C, EXPONENT, SUPPORT, 65)
    found_greatest, found_least = certified(net)
    assert (found_greatest >= greatest - 1e-4).all()
    assert (found_least <= least + 1e-3).all()
    assert found_greatest.max() == pytest.approx(greatest.max(), abs=1e-4)
    assert found_least.min() == pytest.approx(least.min(), abs=1e-4)


@compiled_only
def test_the_certificate_does_not_depend_on_how_many_segments_are_sampled_at_once(monkeypatch: pytest.MonkeyPatch):
    net = net_of(MESHES["jittered"]())
    whole = certified(net)
    monkeypatch.setattr(certificate, "_AT_ONCE", 7)
    for one, other in zip(whole, certified(net), strict=True):
        np.testing.assert_array_equal(one, other)


def certified(net: Net, c: float = C, exponent: int = EXPONENT) -> tuple[Floats, Floats]:
    """The greatest s on each channel and the least on each strut."""
    segments = segments_of(net, c, exponent)
    starts, ends, n = segments.starts.T, (segments.starts + segments.steps).T, net.struts
    bins = boxes_over(segments)
    at = partial(field_at, segments, bins)
    rings = Rings((0.5,), (0.01,))
    return extremes_of(at, starts[n:], ends[n:], rings, 1)[0], extremes_of(at, starts[:n], ends[:n], rings, -1)[0]


@compiled_only
@pytest.mark.parametrize("exponent", [4, 6, 8])
def test_the_window_opens_to_all_values_as_c_falls(exponent: int):
    net = net_of(jittered(tetrahedra((2, 2, 1))))
    windows = [
        (greatest.max(), least.min())
        for greatest, least in (certified(net, c, exponent) for c in (0.1, 0.03, 0.01, 1e-3))
    ]
    assert (np.diff([window[0] for window in windows]) < 0.0).all()
    assert (np.diff([window[1] for window in windows]) > 0.0).all()
    assert windows[0][0] - windows[0][1] > -1.95
    assert windows[-1] == pytest.approx((-1.0, 1.0), abs=1e-4)


@compiled_only
def test_what_lies_outside_the_boxes_is_void_and_moves_nothing_else():
    segments = segments_of(net_of(jittered(tetrahedra((1, 1, 1)))))
    bins = boxes_over(segments)
    inside = segments.starts.T + segments.steps.T / 2.0
    beyond = np.array([[1e3, 0.0, 0.0], [0.0, -1e3, 0.0], [0.0, 0.0, 1e18]])
    values = field_at(segments, bins, np.concatenate([beyond, inside, -beyond]))
    np.testing.assert_array_equal(values[3:-3], field_at(segments, bins, inside))
    assert (values[[0, 1, 2, -3, -2, -1]] == -1.0).all()


def test_lists_beyond_the_memory_are_refused(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(shepard_module, "available_memory", lambda: 3)
    with pytest.raises(StageError, match="lower support"):
        boxes_over(strut_and_channel())


INTERPRETED = """
import sys
import numpy as np
from scaffold_geometry.fields import shepard
from scaffold_geometry.fields.shepard_grid import TILE, field_on_tiles

given = np.load(sys.argv[1])
names = ("starts", "steps", "shapes", "reaches")
segments = shepard.Segments(*(given[name] for name in names), 6, 2, np.zeros(3), 1.0)
bins = shepard.bin_segments(segments, np.full(3, -1.0), np.full(3, TILE * 0.5), (1, 1, 1))
values = np.empty((4, 4, 4), np.float32)
inside = np.ones(values.shape, bool)
count = field_on_tiles(segments, bins, np.full(3, -0.75), 0.5, np.arange(1), inside, values)
np.savez(sys.argv[2], values=values, count=count, at=shepard.field_at(segments, bins, given["points"]))
"""


@compiled_only
def test_interpreted_kernels_give_the_same_field(tmp_path: Path):
    segments = segments_of(net_of(one_tetrahedron()))
    arrays = {name: getattr(segments, name) for name in ("starts", "steps", "shapes", "reaches")}
    np.savez(tmp_path / "in.npz", points=np.random.default_rng(4).uniform(-1.0, 1.0, (20, 3)), **arrays)
    answers = []
    for interpreted in ("0", "1"):
        command = [sys.executable, "-c", INTERPRETED, tmp_path / "in.npz", tmp_path / "out.npz"]
        subprocess.run(command, check=True, env={**os.environ, "NUMBA_DISABLE_JIT": interpreted}, timeout=120)
        answers.append(dict(np.load(tmp_path / "out.npz")))
    compiled, plain = answers
    np.testing.assert_allclose(plain["values"], compiled["values"], rtol=0, atol=5e-6)
    np.testing.assert_allclose(plain["at"], compiled["at"], rtol=0, atol=1e-12)
    assert plain["count"] == compiled["count"]

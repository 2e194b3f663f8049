"""How fast the field is, as ratios measured in one run: `python tests/benchmarks/field.py`.

Prints a table. Nothing here is asserted: a shared machine's seconds are no test. `--small` leaves out the 512^3 grid;
`--bone FILE --units m` is an anatomical surface that takes the place of a block where the mesh is to be a real one.
"""

import argparse
import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from geometry.fields.oracle import icosahedron
from scaffold_geometry.fields import interpolant, shepard
from scaffold_geometry.fields.sampling import voxels_over
from scaffold_geometry.fields.shepard_grid import TILE, field_on_tiles
from scaffold_geometry.fields.skeleton import skeleton_of
from scaffold_pipeline.artifacts import OuterShape, VolumeMesh
from scaffold_pipeline.processes.memory import PeakMemory
from scaffold_stages.arbf_field import _NORMALISED_C, ArbfFieldParams, _normalised_field, arbf_field
from scaffold_stages.load_surface import LoadSurfaceParams, load_surface
from scaffold_stages.tetrahedralise import TetrahedraliseParams, tetrahedralise
from shapes import box, tetrahedra

EDGE = 16  # voxels to a mesh edge
CORES = sorted({1, numba.config.NUMBA_NUM_THREADS})

CPP = r"""
#include <algorithm>
#include <cmath>
extern "C" void rows(const float* __restrict s, long segments, const float* __restrict xs, const float* __restrict ys,
                     const float* __restrict zs, long nx, long ny, long nz, float* __restrict out) {
    for (long i = 0; i < nx; ++i) for (long j = 0; j < ny; ++j) {
        float* __restrict row = out + (i * ny + j) * nz;
        for (long e = 0; e < segments; ++e) {
            const float *p = s + 9 * e, wx = xs[i] - p[0], wy = ys[j] - p[1], along = wx * p[3] + wy * p[4];
            for (long k = 0; k < nz; ++k) {
                float wz = zs[k] - p[2];
                float t = std::min(std::max((along + wz * p[5]) * p[6], 0.0f), 1.0f);
                float ex = wx - t * p[3], ey = wy - t * p[4], ez = wz - t * p[5], r2 = ex * ex + ey * ey + ez * ez;
                float taper = std::max(0.0f, 1.0f - r2 * p[8]), q = 1.0f / (r2 + p[7]);
                row[k] += q * q * taper * taper;
            }
        }
    }
}
#ifdef __AVX512F__
typedef float Vector __attribute__((vector_size(64)));
#else
typedef float Vector __attribute__((vector_size(32)));
#endif
extern "C" long operations(long n, float factor, float term, float* values) {
    Vector products[8], sums[8];  // each from a value of its own, or the compiler would make one of all
    for (int k = 0; k < 8; ++k) products[k] = Vector{} + values[k], sums[k] = Vector{} + values[8 + k];
    for (long i = 0; i < n; ++i) for (int k = 0; k < 8; ++k) {
        products[k] = products[k] * factor + term;
        sums[k] = term - sums[k];
    }
    for (int k = 0; k < 8; ++k) values[k] = products[k][0] + sums[k][0];
    return n * 16 * (sizeof(Vector) / sizeof(float));
}
extern "C" void exact(const double* points, long n, const double* starts, const double* ends, const double* weights,
                      long elements, double c, double* out) {
    for (long i = 0; i < n; ++i) {
        double sum = 0.0;
        for (long e = 0; e < elements; ++e) {
            double d[3], w[3], length = 0.0, along = 0.0, squared = 0.0;
            for (int a = 0; a < 3; ++a) {
                d[a] = ends[3 * e + a] - starts[3 * e + a];
                w[a] = points[3 * i + a] - starts[3 * e + a];
                length += d[a] * d[a];
                along += w[a] * d[a];
            }
            double t = length > 0.0 ? std::min(std::max(along / length, 0.0), 1.0) : 0.0;
            for (int a = 0; a < 3; ++a) squared += (w[a] - t * d[a]) * (w[a] - t * d[a]);
            double r = std::sqrt(squared);
            sum += weights[e] / std::sqrt(r * r + c * c);
        }
        out[i] = sum;
    }
}
"""


def main():
    """Measure everything and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--small", action="store_true")
    parser.add_argument("--bone", type=Path)
    parser.add_argument("--units", default="mm")
    given = parser.parse_args()
    print("| what | value |\n|---|---|")
    for name, value in chain(
        kernel_rows(), exact_rows(), sparse_rows(given.bone, given.units), growth_rows(small=given.small)
    ):
        print(f"| {name} | {value} |", flush=True)


def seconds_of(work, repeats=3):
    """Return the least time of a call, after one that compiles."""
    work()
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return min(times)


def on_cores(cores, work):
    """Return what a call gives while so many threads are used."""
    numba.set_num_threads(cores)
    try:
        return work()
    finally:
        numba.set_num_threads(CORES[-1])


def kernel_rows():
    """Yield the point-to-segment kernel against numpy and C++, every voxel with every segment."""
    segments, side = random_segments(2000), 64
    axis = np.linspace(-0.5, 0.5, side)
    pairs = side**3 * 2000
    ours = {cores: on_cores(cores, lambda: pairs / every_pair(segments, axis) / 1e9) for cores in CORES}
    points = np.stack(np.meshgrid(axis[::2], axis[::2], axis[::2], indexing="ij"), axis=-1).reshape(-1, 3)
    broadcast = len(points) * 2000 / seconds_of(lambda: by_broadcasting(segments, points)) / 1e9
    for cores, rate in ours.items():
        yield f"kernel, {cores} cores, G pairs/s", f"{rate:.2f}"
        yield f"kernel, {cores} cores / numpy broadcasting", f"{rate / broadcast:.0f}"
    compiled = library()
    if compiled is not None:
        table = cpp_table(segments)
        x = axis.astype(np.float32)
        out = np.zeros((side, side, side), np.float32)
        cpp = pairs / seconds_of(lambda: compiled.rows(at(table), 2000, at(x), at(x), at(x), side, side, side, at(out)))
        yield "kernel, 1 core / C++ -O3 -march=native -ffast-math", f"{ours[1] / (cpp / 1e9):.2f}"
        peak = operations_per_second(compiled) / 1e9
        yield "additions and multiply-adds, as many of each, that 1 core can do, G/s", f"{peak:.0f}"
        yield "the kernel's 17 operations a pair / these, 1 core", f"{17 * ours[1] / peak:.2f}"
        yield "operations that 1 core has for a pair at 300 times numpy", f"{peak / broadcast / 300:.1f}"
    yield f"kernel, {CORES[-1]} cores / 1 core", f"{ours[CORES[-1]] / ours[1]:.2f}"


def operations_per_second(compiled):
    """Return how many float32 operations a core does in vectors that never leave its registers.

    Half are additions, half multiply-adds: processors have units for each.
    """
    times, values = 20_000_000, np.linspace(0.1, 1.0, 16, dtype=np.float32)
    done = compiled.operations(times, 0.5, 0.7, at(values))
    return done / seconds_of(lambda: compiled.operations(times, 0.5, 0.7, at(values)))


def random_segments(count):
    """Return segments about the origin that reach everything."""
    rng = np.random.default_rng(0)
    shapes, reaches = np.full(count, 4e-4), np.full(count, 100.0)
    starts, steps = rng.uniform(-0.5, 0.5, (3, count)), rng.normal(0.0, 0.1, (3, count))
    return shepard.Segments(starts, steps, shapes, reaches, count // 4, 2, np.zeros(3), 1.0)


def every_pair(segments, axis):
    """Return the seconds that a cube of samples takes where every sample meets every segment."""
    values, step = np.empty((len(axis),) * 3, np.float32), axis[1] - axis[0]
    tiles = -(-len(axis) // TILE)
    count = segments.starts.shape[1]
    members, offsets = np.arange(count, dtype=np.int32), np.array([0, count])
    bins = shepard.Bins(offsets, members, np.full(3, axis[0] - step / 2), np.full(3, step * tiles * TILE), (1, 1, 1))
    inside = np.zeros(values.shape, bool)
    active = np.arange(tiles**3)
    return seconds_of(lambda: field_on_tiles(segments, bins, np.full(3, axis[0]), step, active, inside, values))


def cpp_table(segments):
    """Return what the C++ loop reads of each segment, (n, 9)."""
    columns = (1.0 / (segments.steps**2).sum(axis=0), segments.shapes, 1.0 / segments.reaches)
    return np.ascontiguousarray(np.stack([*segments.starts, *segments.steps, *columns], axis=1), np.float32)


def by_broadcasting(segments, points):
    """Return the sum of the weights at points, in numpy."""
    starts, steps = segments.starts.T.astype(np.float32), segments.steps.T.astype(np.float32)
    w = points.astype(np.float32)[:, None] - starts
    t = np.clip((w * steps).sum(axis=2) / (steps**2).sum(axis=1), 0.0, 1.0)
    squared = ((w - t[:, :, None] * steps) ** 2).sum(axis=2)
    taper = np.maximum(0.0, 1.0 - squared / segments.reaches.astype(np.float32))
    return ((squared + segments.shapes.astype(np.float32)) ** -2 * taper**2).sum(axis=1)


def library():
    """Return the C++ loops as a library, or None where there is no compiler."""
    if shutil.which("g++") is None:
        return None
    folder = Path(tempfile.mkdtemp(prefix="field-benchmark-"))
    (folder / "loops.cpp").write_text(CPP)
    flags = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC"]
    subprocess.run(["g++", *flags, "loops.cpp", "-o", "loops.so"], cwd=folder, check=True)
    plain = ["-O2", "-shared", "-fPIC"]
    subprocess.run(["g++", *plain, "loops.cpp", "-o", "plain.so"], cwd=folder, check=True)
    fast, exact = ctypes.CDLL(folder / "loops.so"), ctypes.CDLL(folder / "plain.so")
    address, count = ctypes.c_void_p, ctypes.c_long
    fast.rows.argtypes = [address, count, address, address, address, count, count, count, address]
    exact.exact.argtypes = [address, count, address, address, address, count, ctypes.c_double, address]
    fast.operations.argtypes, fast.operations.restype = [count, ctypes.c_float, ctypes.c_float, address], count
    fast.exact = exact.exact
    return fast


def at(values):
    """Return the address of an array."""
    return values.ctypes.data


def exact_rows():
    """Yield the exact field of the icosahedron on 128^3 against plain loops over float64 pairs."""
    vertices, cells = icosahedron()
    skeleton = skeleton_of(vertices, cells)
    elements = interpolant.elements_of(skeleton)
    matrix = interpolant.assemble(elements, "inverse_multiquadric", "endpoint-to-segment", 0.1)
    weights = interpolant.solve(matrix, interpolant.values_of(skeleton)).weights
    axis = np.linspace(-1.0, 1.0, 128)
    values, near = np.empty((128,) * 3, np.float32), np.ones((128,) * 3, bool)
    given = (elements, weights, "inverse_multiquadric", 0.1, values)
    ours = {
        cores: on_cores(cores, lambda: seconds_of(lambda: interpolant.evaluate_on_grid((axis,) * 3, near, *given)))
        for cores in CORES
    }
    for cores, seconds in ours.items():
        yield (
            f"exact, icosahedron at 128^3, {cores} cores, G pairs/s",
            f"{values.size * len(weights) / seconds / 1e9:.2f}",
        )
    compiled = library()
    if compiled is not None:
        starts = np.concatenate([elements.points, elements.starts])
        ends = np.concatenate([elements.points, elements.ends])
        points = np.stack(np.meshgrid(axis, axis, axis[::8], indexing="ij"), axis=-1).reshape(-1, 3)
        part, out = np.ascontiguousarray(points), np.empty(len(points))
        arrays = (at(part), len(part), at(starts), at(ends), at(weights), len(weights), 0.1, at(out))
        plain = 8 * seconds_of(lambda: compiled.exact(*arrays))
        for cores, seconds in ours.items():
            yield f"exact, {cores} cores / plain C++ loops over float64 pairs, 1 core", f"{plain / seconds:.1f}"


def block_mesh(cubes):
    """Return a block of cubes of six tetrahedra each, inner vertices jittered, `EDGE` voxels to a cube."""
    mesh = tetrahedra((cubes, cubes, cubes), edge=float(EDGE))
    rng = np.random.default_rng(0)
    inner = ((mesh.vertices > 0.0) & (mesh.vertices < cubes * EDGE)).all(axis=1)
    moved = mesh.vertices + inner[:, None] * rng.uniform(-0.15, 0.15, mesh.vertices.shape) * EDGE
    return VolumeMesh(moved, mesh.tetrahedra), OuterShape(*box((0.0, 0.0, 0.0), (float(cubes * EDGE),) * 3))


def real_mesh(file, units):
    """Return an anatomical surface and the mesh of about ten thousand cells that the pipeline makes of it."""
    outer = load_surface(params=LoadSurfaceParams(path=file, units=units))
    return tetrahedralise(outer, params=TetrahedraliseParams(cells=10_000)), outer


def sparse_rows(bone, units):
    """Yield what the compact support saves, 256 voxels along the long side: against every segment at every voxel."""
    mesh, outer = real_mesh(bone, units) if bone else block_mesh(12)
    params = ArbfFieldParams(voxel_size=float(np.ptp(outer.bounds, axis=0).max()) / 256)
    field, voxels, shape = ready_field(mesh, outer, params)
    segments = shepard.segments_of(skeleton_of(mesh.vertices, mesh.cells), c=0.01, support=1.0, exponent=4)
    everywhere = replace(segments, reaches=np.full_like(segments.reaches, 1e6))
    axis = (np.arange(2 * TILE) - TILE) * voxels.spacing / segments.unit
    for cores in CORES:
        every = on_cores(cores, lambda: every_pair(everywhere, axis)) / len(axis) ** 3 * np.prod(shape)
        ours = on_cores(cores, lambda: seconds_of(lambda: field.on_voxels(voxels)))
        stage = on_cores(cores, lambda: seconds_of(lambda: arbf_field(mesh, outer, params=params), 1))
        label = f"{len(mesh.tetrahedra)} cells, {'x'.join(map(str, shape))}, {cores} cores: every element at each voxel"
        yield f"{label} / the field", f"{every / ours:.0f} ({every:.0f} s / {ours:.2f} s)"
        yield f"{label} / the stage, certificate and all", f"{every / stage:.0f}"


def ready_field(mesh, outer, params):
    """Return the field of a mesh, ready to be summed on the voxels of a shape, these, and their numbers."""
    voxels = voxels_over(outer, params)
    return (
        _normalised_field(skeleton_of(mesh.vertices, mesh.cells), params, _NORMALISED_C, None),
        voxels,
        voxels.inside.shape,
    )


def growth_rows(*, small):
    """Yield the time per voxel and the peak memory as mesh and grid grow together, 16 voxels to an edge."""
    seconds = {}
    for cubes in (8, 15) if small else (8, 15, 32):
        mesh, outer = block_mesh(cubes)
        arbf_field(mesh, outer, params=ArbfFieldParams(voxel_size=8.0))
        for cores in CORES:
            with PeakMemory() as memory:
                seconds[cubes, cores] = on_cores(cores, partial(seconds_of_field, mesh, outer))
            label = f"{len(mesh.tetrahedra)} cells, {cubes * EDGE}^3 voxels, {cores} cores"
            peak = f"{memory.peak / 2**30:.2f} GiB"
            yield f"{label}: seconds, certificate and all; peak memory", f"{seconds[cubes, cores]:.1f}; {peak}"
        yield f"{label} / 1 core", f"{seconds[cubes, 1] / seconds[cubes, cores]:.2f}"
        yield (
            f"time per voxel, {cubes * EDGE}^3 / {8 * EDGE}^3, {cores} cores",
            f"{seconds[cubes, cores] / cubes**3 / (seconds[8, cores] / 8**3):.2f}",
        )


def seconds_of_field(mesh, outer):
    """Return the seconds that the stage takes at a voxel of 1 mm."""
    started = time.perf_counter()
    arbf_field(mesh, outer, params=ArbfFieldParams(voxel_size=1.0))
    return time.perf_counter() - started


if __name__ == "__main__":
    main()

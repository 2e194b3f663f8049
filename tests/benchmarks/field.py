"""How fast the field is, as ratios measured in one run: `python tests/benchmarks/field.py [--small]`.

Prints a table. Nothing here is asserted: a shared machine's seconds are no test. `--small` leaves out the 512^3 grid.
"""

import ctypes
import shutil
import subprocess
import sys
import tempfile
import time
from itertools import chain
from pathlib import Path

import numba
import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from kernels.oracle import icosahedron
from scaffold_pipeline.artifacts import OuterShape, VolumeMesh
from scaffold_pipeline.memory import PeakMemory
from scaffold_stages._kernels import interpolant, shepard
from scaffold_stages._kernels.skeleton import skeleton_of
from scaffold_stages.arbf_field import ArbfFieldParams, arbf_field
from shapes import box, tetrahedra

ROWS, EDGE = 16, 16  # samples of a block along x and y; voxels to a mesh edge
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


def main(*, small):
    """Measure everything and print the table."""
    print("| what | value |\n|---|---|")
    for name, value in chain(kernel_rows(), exact_rows(), sparse_rows(), growth_rows(small=small)):
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


def kernel_rows():
    """Yield the point-to-segment kernel against numpy and C++, every voxel with every segment."""
    segments, side = random_segments(2000), 64
    axis = np.linspace(-0.5, 0.5, side)
    pairs = side**3 * 2000
    everything = in_every_block(segments, side, axis)
    ours = {cores: pairs / timed_blocks(segments, everything, axis, cores) / 1e9 for cores in CORES}
    points = np.stack(np.meshgrid(axis[:16], axis[:16], axis[:16], indexing="ij"), axis=-1).reshape(-1, 3)
    broadcast = len(points) * 2000 / seconds_of(lambda: by_broadcasting(segments, points)) / 1e9
    for cores, rate in ours.items():
        yield f"kernel, {cores} cores, G pairs/s", f"{rate:.2f}"
        yield f"kernel, {cores} cores / numpy broadcasting", f"{rate / broadcast:.0f}"
    compiled = library()
    if compiled is not None:
        table = np.ascontiguousarray(shepard._table(segments)[:, :9], np.float32)
        x = axis.astype(np.float32)
        out = np.zeros((side, side, side), np.float32)
        cpp = pairs / seconds_of(lambda: compiled.rows(at(table), 2000, at(x), at(x), at(x), side, side, side, at(out)))
        yield "kernel, 1 core / C++ -O3 -march=native -ffast-math", f"{ours[1] / (cpp / 1e9):.2f}"
    yield f"kernel, {CORES[-1]} cores / 1 core", f"{ours[CORES[-1]] / ours[1]:.2f}"


def random_segments(count):
    """Return segments about the origin that reach everything."""
    rng = np.random.default_rng(0)
    shapes, reaches = np.full(count, 4e-4), np.full(count, 100.0)
    starts, steps = rng.uniform(-0.5, 0.5, (3, count)), rng.normal(0.0, 0.1, (3, count))
    return shepard.Segments(starts, steps, shapes, reaches, count // 4, 2, np.zeros(3), 1.0)


def in_every_block(segments, side, axis):
    """Return bins in which every block lists every segment."""
    step = axis[1] - axis[0]
    samples = np.array([ROWS, ROWS, shepard.LANES])
    blocks = tuple(int(count) for count in -(-side // samples))
    total = int(np.prod(blocks))
    members = np.tile(np.arange(segments.starts.shape[1], dtype=np.int32), total)
    offsets = np.arange(total + 1) * segments.starts.shape[1]
    return shepard.Bins(offsets, members, np.full(3, axis[0] - step / 2), step * samples, blocks)


def timed_blocks(segments, bins, axis, cores, active=None):
    """Return the seconds that the blocks take on so many cores."""
    values = np.empty((len(axis),) * 3, np.float32)
    inside = np.zeros(values.shape, bool)
    active = np.arange(len(bins.offsets) - 1) if active is None else active
    origin, step = np.full(3, axis[0]), axis[1] - axis[0]
    numba.set_num_threads(cores)
    try:
        return seconds_of(lambda: shepard.field_on_blocks(segments, bins, origin, step, active, inside, values))
    finally:
        numba.set_num_threads(CORES[-1])


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
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    x, y, z = (np.ascontiguousarray(column) for column in points.T)
    ours = seconds_of(lambda: interpolant.evaluate(x, y, z, elements, weights, "inverse_multiquadric", 0.1))
    yield "exact, icosahedron at 128^3, G pairs/s", f"{len(points) * len(weights) / ours / 1e9:.2f}"
    compiled = library()
    if compiled is not None:
        starts = np.concatenate([elements.points, elements.starts])
        ends = np.concatenate([elements.points, elements.ends])
        part, out = np.ascontiguousarray(points[::8]), np.empty(len(points[::8]))
        plain = 8 * seconds_of(
            lambda: compiled.exact(at(part), len(part), at(starts), at(ends), at(weights), len(weights), 0.1, at(out)),
            1,
        )
        yield "exact / plain C++ loops over float64 pairs, 1 core", f"{plain / ours:.1f}"


def block_mesh(cubes):
    """Return a block of cubes of six tetrahedra each, inner vertices jittered, `EDGE` voxels to a cube."""
    mesh = tetrahedra((cubes, cubes, cubes), edge=float(EDGE))
    rng = np.random.default_rng(0)
    inner = ((mesh.vertices > 0.0) & (mesh.vertices < cubes * EDGE)).all(axis=1)
    moved = mesh.vertices + inner[:, None] * rng.uniform(-0.15, 0.15, mesh.vertices.shape) * EDGE
    return VolumeMesh(moved, mesh.tetrahedra), OuterShape(*box((0.0, 0.0, 0.0), (float(cubes * EDGE),) * 3))


def sparse_rows():
    """Yield what the compact support saves at 256 voxels: the same kernel with every segment in every block."""
    mesh, outer = block_mesh(16)
    params = ArbfFieldParams(voxel_size=1.0)
    whole = seconds_of(lambda: arbf_field(mesh, outer, params=params), 1)
    segments = shepard.segments_of(skeleton_of(mesh.vertices, mesh.cells), c=0.01, support=1.0, exponent=4)
    axis = (np.arange(64) - 32.0) / segments.unit
    bins = in_every_block(segments, 64, axis)
    few = np.arange(2)
    brute = timed_blocks(segments, bins, axis, CORES[-1], few) / (len(few) * ROWS * ROWS * shepard.LANES) * 256**3
    yield (
        f"{len(mesh.tetrahedra)} tetrahedra, 256^3: all segments at every voxel / ours, certificate included",
        f"{brute / whole:.0f}",
    )


def growth_rows(*, small):
    """Yield the time per voxel and the peak memory as mesh and grid grow together."""
    per_voxel = {}
    for cubes in (8, 15) if small else (8, 15, 32):
        mesh, outer = block_mesh(cubes)
        arbf_field(mesh, outer, params=ArbfFieldParams(voxel_size=8.0))
        started = time.perf_counter()
        with PeakMemory() as memory:
            field = arbf_field(mesh, outer, params=ArbfFieldParams(voxel_size=1.0))
        seconds = time.perf_counter() - started
        side = cubes * EDGE
        per_voxel[side] = seconds / side**3
        label = f"{len(mesh.tetrahedra)} tetrahedra, {side}^3 voxels"
        yield f"{label}: seconds, {CORES[-1]} cores, certificate included", f"{seconds:.1f}"
        yield (
            f"{label}: peak memory / field",
            f"{memory.peak / field.values.nbytes:.1f} ({memory.peak / 2**30:.2f} GiB)",
        )
    sides = sorted(per_voxel)
    for side in sides[1:]:
        yield f"time per voxel, {side}^3 / {sides[0]}^3", f"{per_voxel[side] / per_voxel[sides[0]]:.2f}"


if __name__ == "__main__":
    main(small="--small" in sys.argv)

"""Diffusion through pores whose effective diffusivity is known, and a dense solution to compare with."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.ndimage import label

from scaffold_geometry.fields.tpms import gyroid
from scaffold_geometry.measures import conduction
from scaffold_geometry.measures.conduction import flow_through, links_between
from scaffold_geometry.measures.transport import diffusion_through, transport
from scaffold_geometry.voxels.image import OUTSIDE, PORE, STRUT, VoxelImage


def image_of(pores: np.ndarray, spacing: float = 0.5) -> VoxelImage:
    """Return pores and struts in a box, a layer of outside about it."""
    phases = np.pad(np.where(pores, PORE, STRUT).astype(np.uint8), 1, constant_values=OUTSIDE)
    return VoxelImage(phases, np.array([1.0, 2.0, 3.0]), spacing)


def gyroid_pores(voxels: int, cells: int = 1, level: float = 0.45) -> np.ndarray:
    phase = 2.0 * np.pi * cells * (np.arange(voxels) + 0.5) / voxels
    return gyroid(phase[:, None, None], phase[:, None], phase) < level


def spheres(voxels: int, share: float) -> np.ndarray:
    """Return the pores about one ball of the given share in the middle of a cube."""
    x = (np.arange(voxels) + 0.5) / voxels - 0.5
    return x[:, None, None] ** 2 + x[:, None] ** 2 + x**2 > (share / (4.0 / 3.0 * np.pi)) ** (2.0 / 3.0)


def test_an_empty_box_diffuses_like_the_free_medium():
    for axis in diffusion_through(np.ones((4, 6, 8), bool)):
        assert axis.relative_diffusivity == pytest.approx(1.0, abs=1e-9)
        assert axis.tortuosity == pytest.approx(1.0, abs=1e-9)
        assert axis.voxel_error == pytest.approx(0.0, abs=1e-9)


def test_straight_channels_have_tortuosity_1_and_nothing_passes_across_them():
    pores = np.zeros((8, 8, 12), bool)
    pores[2:4, 2:6] = True
    pores[6:8, 0:4] = True
    x, y, z = diffusion_through(pores)
    assert z.relative_diffusivity == pytest.approx(0.25, abs=1e-9)
    assert z.tortuosity == pytest.approx(1.0, abs=1e-9)
    assert (x.relative_diffusivity, x.tortuosity, x.percolating_porosity) == (0.0, None, 0.0)
    assert y.relative_diffusivity == 0.0


def test_a_wall_across_the_channels_stops_all():
    pores = np.ones((6, 6, 6), bool)
    pores[3] = False
    x, y, _ = diffusion_through(pores)
    assert x.relative_diffusivity == 0.0
    assert x.tortuosity is None
    assert y.relative_diffusivity == pytest.approx(5 / 6)


def test_voxels_that_touch_by_an_edge_alone_let_nothing_through():
    i, j, k = np.indices((6, 6, 6))
    assert all(axis.relative_diffusivity == 0.0 for axis in diffusion_through((i + j + k) % 2 == 0))


def test_dead_ends_count_to_the_tortuosity_but_closed_pores_do_not():
    channel = np.zeros((8, 8, 8), bool)
    channel[:, 0:2, 0:2] = True
    closed, dead_end = channel.copy(), channel.copy()
    closed[4:6, 4:6, 4:6] = True
    dead_end[4:6, 0:6, 0:2] = True
    plain, with_closed, with_dead_end = (diffusion_through(pores)[0] for pores in (channel, closed, dead_end))
    assert with_closed.tortuosity == plain.tortuosity == pytest.approx(1.0)
    assert with_dead_end.percolating_porosity > plain.percolating_porosity
    assert with_dead_end.tortuosity > 1.1


def test_a_slit_between_two_halves_resists_as_the_resistances_in_series_do():
    links = links_between(np.ones((4, 2, 2), bool), 1)
    links[0][2] = 0.25
    # 1/2 + 1 + 4 + 1 + 1/2, over 4 columns
    assert flow_through(np.ones((4, 2, 2), bool), links, 0) == pytest.approx(4 / 7.0, rel=1e-9)


@pytest.mark.parametrize("share", [0.02, 0.1])
def test_dilute_spheres_follow_maxwell(share: float):
    # J. C. Maxwell, A Treatise on Electricity and Magnetism (1873), art. 314, for balls that conduct nothing; a cube
    # about each, with walls along which nothing flows across, is Rayleigh's cubic array, of the same first orders
    maxwell = 2.0 * (1.0 - share) / (2.0 + share)
    x, y, z = diffusion_through(spheres(24, share))
    assert x.relative_diffusivity == pytest.approx(y.relative_diffusivity, rel=1e-9)
    assert x.relative_diffusivity == pytest.approx(z.relative_diffusivity, rel=1e-9)
    error = x.relative_diffusivity - maxwell
    assert -0.015 < error < 0.0
    assert abs(error - x.voxel_error) < 0.4 * abs(error)


def test_the_axes_of_a_cubic_structure_are_alike():
    x, y, z = (axis.relative_diffusivity for axis in diffusion_through(gyroid_pores(24)))
    assert y == pytest.approx(x, rel=1e-8)
    assert z == pytest.approx(x, rel=1e-8)


def test_turning_the_pores_turns_the_results():
    pores = gyroid_pores(24)
    pores[:, :, 4:7] = True
    results = diffusion_through(pores)
    turned = diffusion_through(np.moveaxis(pores, 2, 0))
    for one, other in zip(turned, (results[2], results[0], results[1]), strict=True):
        assert one.relative_diffusivity == pytest.approx(other.relative_diffusivity, rel=1e-8)
    assert results[0].relative_diffusivity != pytest.approx(results[2].relative_diffusivity, rel=0.01)


def test_the_error_told_is_that_to_the_limit_of_small_voxels():
    limit = 0.4778  # of one cell between faces at which the concentrations are held: 0.4776 from 96 and 192 voxels
    for voxels in (16, 24):
        result = diffusion_through(gyroid_pores(voxels))[0]
        assert 0.45 < result.voxel_error / (result.relative_diffusivity - limit) < 1.2


def test_blocks_of_voxels_change_little():
    pores = gyroid_pores(24)
    fine, blocks = (diffusion_through(pores, factor)[0] for factor in (1, 2))
    assert blocks.relative_diffusivity == pytest.approx(fine.relative_diffusivity, rel=0.03)
    assert blocks.percolating_porosity == fine.percolating_porosity


def dense_flow(links: tuple[np.ndarray, np.ndarray, np.ndarray], shape: tuple[int, int, int]) -> float:
    """Return the flow along x by a dense Laplacian, link by link: an oracle for tiny grids."""
    numbers, matrix, right = np.arange(np.prod(shape)).reshape(shape), np.zeros(2 * [np.prod(shape)]), np.zeros(shape)
    for axis, link in enumerate(links):
        for at in product(*map(range, link.shape)):
            before, conductance = tuple(np.subtract(at, np.eye(3, dtype=int)[axis])), link[at]
            ends = [numbers[place] for place in (before, at) if 0 <= place[axis] < shape[axis]]
            if len(ends) == 1 and axis > 0:
                continue
            matrix[ends, ends] += conductance
            if len(ends) == 2:
                matrix[ends, ends[::-1]] -= conductance
            elif at[0] == 0:
                right[at] += conductance
    potentials = np.linalg.solve(matrix, right.ravel()).reshape(shape)
    return float((links[0][0] * (1.0 - potentials[0])).sum())


def test_the_flow_is_that_of_a_dense_solution_whatever_the_conductances():
    rng = np.random.default_rng(3)
    shape = (5, 4, 3)
    links = tuple(rng.uniform(0.05, 1.0, np.add(shape, np.eye(3, dtype=int)[axis])) for axis in range(3))
    assert flow_through(np.ones(shape, bool), links, 0) == pytest.approx(dense_flow(links, shape), rel=1e-9)


def test_turned_conductances_give_the_same_flow_along_the_turned_axis():
    rng = np.random.default_rng(4)
    shape = (5, 4, 3)
    links = tuple(rng.uniform(0.05, 1.0, np.add(shape, np.eye(3, dtype=int)[axis])) for axis in range(3))
    turned = tuple(np.moveaxis(links[axis], 0, 2) for axis in (1, 2, 0))
    along = flow_through(np.ones(shape, bool), links, 0)
    assert flow_through(np.ones((4, 3, 5), bool), turned, 2) == pytest.approx(along, rel=1e-9)


def test_the_box_in_the_image_is_measured_and_told():
    result = transport(image_of(np.ones((4, 6, 9), bool)))
    np.testing.assert_allclose(result.bounds, [[1.25, 2.25, 3.25], [3.25, 5.25, 7.25]])
    assert result.box_share == pytest.approx(8 / 9)
    assert result.voxel_size == 0.5
    assert result.x.relative_diffusivity == pytest.approx(1.0)


def test_too_many_voxels_are_joined_to_blocks():
    image = image_of(np.ones((8, 8, 8), bool))
    assert transport(image, most_cells=512).voxel_size == 0.5
    assert transport(image, most_cells=511).voxel_size == 1.0
    assert transport(image, most_cells=1).voxel_size == 2.0  # two blocks must fit along each side


def test_a_shape_a_voxel_thin_has_no_transport():
    assert transport(image_of(np.ones((1, 9, 9), bool))) is None
    assert transport(VoxelImage(np.zeros((3, 3, 3), np.uint8), np.zeros(3), 1.0)) is None


def test_the_result_is_the_same_to_the_bit_whatever_numpy_draws():
    pores = gyroid_pores(24)
    state = np.random.get_state()  # noqa: NPY002 - the global generator is what a library would draw from
    results = []
    for seed in (1, 2):
        np.random.seed(seed)  # noqa: NPY002
        results.append(diffusion_through(pores))
    np.random.set_state(state)  # noqa: NPY002
    assert results[0] == results[1]


def test_equations_that_do_not_converge_are_an_error(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(conduction, "_MOST_STEPS", 1)
    with pytest.raises(conduction.StageError, match="not solved in 1 steps; use larger voxels"):
        diffusion_through(gyroid_pores(24))


def test_tortuosity_is_porespys_where_concentrations_are_held_in_the_outermost_voxels():
    """PoreSpy 3.2's `tortuosity_fd` gave the number; it needs OpenPNM and with that MKL, too much for these tests."""
    pieces, _ = label(gyroid_pores(40))
    pores = pieces == np.bincount(pieces[pieces > 0]).argmax()
    x, y, z = links_between(pores, 1)
    flow = flow_through(pores[1:-1], (x[1:-1], y[1:-1], z[1:-1]), 0)
    assert pores.sum() / len(pores) / (flow * (len(pores) - 1)) == pytest.approx(1.40442156, abs=1e-7)

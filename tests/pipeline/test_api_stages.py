"""The front door: each installed stage as a function of its slots and parameters."""

from __future__ import annotations

import inspect
import pickle
import pydoc
from pathlib import Path

import numpy as np
import pytest

import scaffold_pipeline as sp
from scaffold_pipeline import stages
from scaffold_pipeline.stages.functions import stage_function
from scaffold_pipeline.stages.registry import stage_names


@pytest.fixture
def points(project):  # noqa: ARG001 - the fake plug-in is installed
    return stages.make_points(count=3)


def test_every_installed_stage_is_a_function_a_plug_ins_too(project):  # noqa: ARG001
    assert dir(stages) == stage_names()
    assert {"make_points", "tetrahedralise"} < set(dir(stages))
    assert all(callable(getattr(stages, name)) for name in dir(stages) if name != "broken_stage")
    assert stages.make_points is sp.stages.make_points


def test_a_chain_of_calls_makes_what_a_config_with_the_seed_makes(points):
    moved = stages.scatter_points(points, amount=0.3, seed=7)
    asked = {"seed": 7, "stages": [{"use": "make_points", "count": 3}, {"use": "scatter_points", "amount": 0.3}]}
    assert np.array_equal(moved.places, sp.run(asked)["points"].places)
    assert not np.array_equal(moved.places, stages.scatter_points(points, amount=0.3).places)
    assert np.array_equal(
        stages.scatter_points(points).places, stages.scatter_points(points=points, seed=np.int64(0)).places
    )


def test_blas_has_one_thread_as_in_a_run(points):
    solved = stages.solve_points(points, seed=7)
    asked = {"seed": 7, "stages": [{"use": "make_points"}, {"use": "solve_points"}]}
    assert np.array_equal(solved.places, sp.run(asked)["points"].places)


@pytest.mark.parametrize(
    ("arguments", "keywords", "message"),
    [
        ((), {}, "scatter_points: points: is required, as a Points"),
        ((None,), {}, "scatter_points: points: is required, as a Points"),
        ((3,), {}, "scatter_points: points: must be a Points, got an int"),
        ((sp.Metrics({}),), {}, "scatter_points: points: must be a Points, got a Metrics"),
        (
            (1, 2),
            {"points": 1},
            (
                "scatter_points: points: is given both by position and by name\nscatter_points: points: must "
                "be a Points, got an int\nscatter_points: takes 1 by position (points), got 2; give parameters "
                "by name"
            ),
        ),
        (("P",), {"amont": 0.1}, "scatter_points: unknown parameter 'amont'; did you mean 'amount'?"),
        (("P",), {"sed": 1}, "scatter_points: unknown parameter 'sed'; did you mean 'seed'?"),
        (("P",), {"out": "here"}, "scatter_points: unknown parameter 'out'; the stage writes no files"),
        (("P",), {"amount": 0.7}, "scatter_points: amount: must be less than 0.5, got 0.7"),
        (("P",), {"amount": np.nan}, "scatter_points: amount: must be a finite number, got nan"),
        (
            ("P",),
            {"amount": "wide"},
            "scatter_points: amount: must be a valid number, unable to parse string as a number, got 'wide'",
        ),
        (("P",), {"seed": -1}, "scatter_points: seed: must be a whole number from 0 to 2^63 - 1, got -1"),
        (("P",), {"seed": True}, "scatter_points: seed: must be a whole number from 0 to 2^63 - 1, got True"),
        (("P",), {"params": 1}, "scatter_points: unknown parameter 'params'; known: amount, points, seed"),
    ],
)
def test_what_cannot_be_called_is_one_line_a_fault(points, arguments, keywords, message):
    given = tuple(points if value == "P" else value for value in arguments)
    with pytest.raises(sp.ConfigError) as error:
        stages.scatter_points(*given, **keywords)
    assert str(error.value) == message


def test_a_stage_that_is_not_random_has_no_seed(project):  # noqa: ARG001
    with pytest.raises(sp.ConfigError, match=r"^make_points: unknown parameter 'seed'; the stage is not random$"):
        stages.make_points(seed=1)


def test_an_unknown_stage_is_an_attribute_error_with_the_nearest(project):  # noqa: ARG001
    with pytest.raises(AttributeError, match="no stage is called 'jiter'; did you mean 'jitter'"):
        stages.jiter  # noqa: B018
    assert not hasattr(stages, "__wrapped__")


def test_a_broken_plug_in_is_named_when_it_is_used(install):
    install("broken", "raise RuntimeError('no licence')", "grow")
    assert "grow" in dir(stages)
    with pytest.raises(sp.PipelineError, match=r"broken cannot be loaded .*no licence"):
        stages.grow  # noqa: B018


def test_a_slot_that_may_be_absent_may_be_left_out(points):
    assert stages.count_points(points).values["drawn"] is False
    assert stages.count_points(points, stages.draw_points(points)).values["drawn"] is True
    assert stages.count_points(points, None).values["drawn"] is False


def test_a_parameter_that_follows_another_stages_has_its_own_default(points):
    with pytest.warns(sp.PipelineWarning, match="^grow_points: the points reach beyond 100 mm$"):
        stages.grow_points(points, factor=100.0)


def test_a_warning_is_one_of_the_line_that_calls(points):
    with pytest.warns(sp.PipelineWarning) as told:
        stages.grow_points(points, factor=100.0)
    assert [Path(each.filename).name for each in told] == [Path(__file__).name]


def test_files_are_written_to_the_folder_that_is_given(points, project):
    with pytest.raises(sp.ConfigError, match=r"^write_points: out: is required, the folder to write to$"):
        stages.write_points(points)
    with pytest.raises(sp.ConfigError, match=r"^write_points: out: must be the path of a folder, got 3$"):
        stages.write_points(points, out=3)
    stages.write_points(points, names=("a.txt",), out="deep/here")
    assert [path.name for path in (project.folder / "deep" / "here").iterdir()] == ["a.txt"]
    assert (project.folder / "deep" / "here" / "a.txt").read_text().startswith("None\n")  # no config to be named


def test_what_fails_begins_with_the_stages_name_and_leaves_no_file(project):
    with pytest.raises(sp.StageError, match=r"^fail: the points are too few, 4; give more$"):
        stages.fail(how="stage_error", out="here")
    with pytest.raises(sp.StageError, match=r"^fail: ran out of memory; use larger voxels or cells$"):
        stages.fail(how="memory", out="here")
    with pytest.raises(ValueError, match="two\nlines"):
        stages.fail(how="error", out="here")
    assert list((project.folder / "here").iterdir()) == []


def test_signature_and_help_show_slots_parameters_units_and_defaults(project):  # noqa: ARG001
    signature = inspect.signature(stages.scatter_points)
    assert list(signature.parameters) == ["points", "amount", "seed"]
    assert signature.parameters["amount"].default == 0.1
    assert "'mm'" in str(signature.parameters["amount"])
    assert "required" not in str(inspect.signature(stages.fail))
    assert list(inspect.signature(stages.arbf_field).parameters)[-1] == "executor"
    told = pydoc.plain(pydoc.render_doc(stages.scatter_points))
    assert "Move points at random." in told
    assert "amount : number in mm, default 0.1\n        Greatest distance that a point moves." in told
    assert "seed : default 0" in told
    assert "Returns\n    -------\n    Points" in told
    assert "limit : number in mm, default 100.0; in a config, as count_points.limit" in stages.grow_points.__doc__


def test_a_function_is_the_same_each_time_and_can_be_pickled(project):  # noqa: ARG001
    assert pickle.loads(pickle.dumps(stages.make_points)) is stages.make_points  # noqa: S301 - our own
    assert stages.make_points.__name__ == "make_points"


def test_two_arguments_of_one_name_are_a_fault_of_the_stage(install):
    install(
        "clash",
        """
        from scaffold_pipeline.artifacts import SurfaceMesh
        from scaffold_pipeline.stages.contract import Params, stage

        class ClashParams(Params):
            outer: int = 1

        @stage(writes="outer", version=1)
        def clash(outer: SurfaceMesh, *, params: ClashParams) -> SurfaceMesh:
            return outer
        """,
        "clash",
    )
    with pytest.raises(sp.PipelineError, match=r"^stage 'clash': outer would be two arguments; rename one$"):
        stage_function("clash")


def test_the_typed_route_stays():
    from scaffold_stages.make_mesh import MakeMeshParams, make_mesh

    assert make_mesh(params=MakeMeshParams(shape="rod")).volume == pytest.approx(4.0)


def test_a_mesh_of_a_library_is_told_the_way_in():
    outer = stages.make_shape(shape="box", facet=20.0)
    with pytest.raises(sp.ConfigError, match=r"got a Trimesh; make one by OuterShape.from_trimesh"):
        stages.tetrahedralise(outer.to_trimesh(), edge_length=6.0)
    with pytest.raises(sp.ConfigError, match=r"got a PolyData; make one by OuterShape.from_pyvista"):
        stages.tetrahedralise(outer.to_pyvista(), edge_length=6.0)
    with pytest.raises(sp.ConfigError, match=r"^tetrahedralise: edge_length: must be greater than 0, got -1$"):
        stages.tetrahedralise(outer, edge_length=-1)
    with pytest.raises(sp.ConfigError, match=f"^load_surface: path: no such file: {Path('absent.stl').resolve()}"):
        stages.load_surface(path="absent.stl", units="mm")

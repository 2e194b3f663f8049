from __future__ import annotations

from collections.abc import Callable

import pytest

from pipeline.workplace import Project
from scaffold_pipeline.errors import ConfigError, StageDefinitionError
from scaffold_pipeline.stages.registry import load_stage, stage_names

Install = Callable[..., None]

STAGE = """
    from scaffold_pipeline.stages.contract import Params, stage
    from scaffold_pipeline.artifacts import Metrics

    class Nothing(Params):
        pass

    @stage(writes="{slot}", version=1)
    def {name}(*, params: Nothing) -> Metrics:
        "Do nothing."
        return Metrics({{}})
    """


@pytest.mark.usefixtures("project")
def test_stages_of_an_installed_plug_in_are_found_beside_our_own():
    assert {"make_points", "broken_stage", "load_surface"} <= set(stage_names())
    assert load_stage("make_points").writes == "points"


@pytest.mark.usefixtures("project")
def test_an_unknown_stage_suggests_the_nearest():
    with pytest.raises(LookupError, match=r"no stage is called 'make_point'; did you mean 'make_points'\?"):
        load_stage("make_point")


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("import no_such_library", "ModuleNotFoundError: No module named 'no_such_library'"),
        ("1 / 0", "ZeroDivisionError"),
        ("raise SystemExit(3)", "SystemExit: 3"),
        ("x = (", "SyntaxError"),
        ("", "AttributeError"),
        ("odd = 3", "stage 'odd': 3 is not a function decorated with @stage"),
        ("def odd(): ...", "is not a function decorated with @stage"),
    ],
)
def test_a_plug_in_that_cannot_be_loaded_is_named_when_it_is_used(
    project: Project, install: Install, text: str, reason: str
):
    install("odd_package", text, "odd")
    entry = "odd = odd_package:odd\n"
    site = project.folder / "site-odd_package" / "odd_package-1.0.dist-info" / "entry_points.txt"
    assert entry in site.read_text()
    with pytest.raises(StageDefinitionError, match="stage 'odd'") as caught:
        load_stage("odd")
    assert reason in str(caught.value)
    with pytest.raises(ConfigError, match=r"config.yaml:1:11: stages.0 \(odd\): stage 'odd'"):
        project.plan("stages: [{use: odd}]")
    assert project.plan("stages: [{use: make_points}]")


@pytest.mark.usefixtures("project")
def test_one_stage_of_two_packages_is_refused_when_it_is_used(install: Install):
    install("first_package", STAGE.format(name="twin", slot="a"), "twin")
    assert load_stage("twin").writes == "a"
    install("second_package", STAGE.format(name="twin", slot="b"), "twin")
    with pytest.raises(
        StageDefinitionError,
        match=r"stage 'twin' is defined by more than one package: first_package:twin \(first_package\), "
        r"second_package:twin \(second_package\); uninstall one",
    ):
        load_stage("twin")


@pytest.mark.usefixtures("project")
def test_one_package_seen_twice_on_the_path_is_one(install: Install):
    install("only_package", STAGE.format(name="lone", slot="a"), "lone")
    install("only_package", STAGE.format(name="lone", slot="a"), "lone")
    assert load_stage("lone").writes == "a"

from __future__ import annotations

import pytest

from pipeline.workplace import Project
from scaffold_pipeline.errors import ConfigError


def faults_of(project: Project, text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        project.plan(text)
    return str(caught.value).splitlines()


@pytest.mark.parametrize(
    ("stages", "fault"),
    [
        (
            "[{use: scatter_points}]",
            "reads slot 'points', which no stage before it writes; add one of: cast_points, make_points, read_points",
        ),
        (
            "[{use: scatter_points}, {use: make_points}]",
            "reads slot 'points', which stages.1 (make_points) writes only later; move that stage up",
        ),
        (
            "[{use: scatter_points, from: {points: dots}}, {use: make_points}]",
            "reads slot 'dots', which no stage before it writes; add one of: -",
        ),
    ],
)
def test_a_slot_read_before_it_is_written_is_a_fault(project: Project, stages: str, fault: str):
    first, *_ = faults_of(project, f"stages: {stages}")
    assert first.endswith(f"stages.0 (scatter_points): {fault}")
    assert first.startswith("config.yaml:1:")


def test_an_unknown_stage_is_not_also_blamed_for_the_slots_it_would_write(project: Project):
    (fault,) = faults_of(project, "stages: [{use: make_pionts}, {use: scatter_points}]")
    assert "no stage is called 'make_pionts'" in fault


def test_faults_of_the_plan_are_found_beside_faults_of_parameters(project: Project):
    faults = faults_of(project, "stages:\n  - use: draw_points\n  - use: make_points\n    count: 0\n")
    assert [fault.partition(": stages.")[0] for fault in faults] == ["config.yaml:2:5", "config.yaml:4:5"]


def test_a_slot_written_twice_is_a_fault(project: Project):
    (fault,) = faults_of(project, "stages:\n  - use: make_points\n  - use: make_points\n")
    assert fault == (
        "config.yaml:3:5: stages.1 (make_points): writes slot 'points', which stages.0 (make_points) writes too; "
        "rename it with `as: NAME`"
    )


def test_a_slot_renamed_to_one_that_is_written_is_a_fault_at_its_name(project: Project):
    (fault,) = faults_of(project, "stages:\n  - use: make_points\n    as: dots\n  - use: make_points\n    as: dots\n")
    assert fault.startswith("config.yaml:5:5: stages.1 (make_points): writes slot 'dots'")


def test_a_slot_of_the_wrong_type_is_a_fault_at_its_source(project: Project):
    (fault,) = faults_of(
        project,
        """
        stages:
          - use: make_points
          - use: draw_points
          - use: grow_points
            as: grown
            from:
              points: picture
        """,
    )
    assert fault == (
        "config.yaml:7:7: stages.2 (grow_points): reads slot 'picture' as Points, "
        "but stages.1 (draw_points) writes a Picture; leave this stage out"
    )


def test_a_renamed_slot_is_read_from_where_it_was_written(project: Project):
    plan = project.plan(
        """
        stages:
          - use: make_points
          - use: make_points
            as: others
            count: 9
          - use: scatter_points
            as: moved
            from: {points: others}
          - use: count_points
        """,
    )
    assert plan.labels == ["make_points", "others", "moved", "count_points"]
    assert [dict(step.sources) for step in plan.steps] == [{}, {}, {"points": "others"}, {"points": "points"}]


def test_an_optional_slot_is_read_only_where_it_was_written_before(project: Project):
    late = project.plan("stages: [{use: make_points}, {use: count_points}, {use: draw_points}]")
    early = project.plan("stages: [{use: make_points}, {use: draw_points}, {use: count_points}]")
    assert dict(late.steps[1].sources) == {"points": "points"}
    assert dict(early.steps[2].sources) == {"points": "points", "picture": "picture"}


def test_an_optional_slot_asked_for_by_name_must_be_there(project: Project):
    (fault,) = faults_of(project, "stages: [{use: make_points}, {use: count_points, from: {picture: sketch}}]")
    assert "reads slot 'sketch', which no stage before it writes" in fault


@pytest.mark.parametrize(
    ("own", "limit"),
    [("", 7.0), (", limit: 3.0", 3.0), (", limit: 100.0", 100.0)],
    ids=["left out", "given", "default"],
)
def test_a_parameter_left_out_follows_that_of_another_stage(project: Project, own: str, limit: float):
    stages = f"[{{use: make_points}}, {{use: grow_points{own}}}, {{use: count_points, limit: 7.0}}]"
    plan = project.plan(f"stages: {stages}")
    assert plan.steps[1].params.model_dump()["limit"] == limit


def test_a_parameter_that_could_follow_keeps_its_default_without_that_stage(project: Project):
    plan = project.plan("stages: [{use: make_points}, {use: grow_points}]")
    assert plan.steps[1].params.model_dump()["limit"] == 100.0


def test_a_seed_is_the_same_for_a_label_whatever_stands_around(project: Project):
    alone = project.plan("seed: 7\nstages: [{use: make_points}, {use: scatter_points}]")
    among = project.plan(
        "seed: 7\nstages: [{use: make_points}, {use: grow_points}, {use: scatter_points}, {use: scatter_points}]",
    )
    other = project.plan("seed: 8\nstages: [{use: make_points}, {use: scatter_points}]")
    assert alone.steps[1].seed(alone.seed) == among.steps[2].seed(among.seed)
    seeds = {
        alone.steps[1].seed(alone.seed),
        among.steps[3].seed(among.seed),
        other.steps[1].seed(other.seed),
    }
    assert len(seeds) == 3
    assert alone.steps[0].seed(alone.seed) is None


def test_labels_are_unique_and_tell_repeated_stages_apart(project: Project):
    plan = project.plan("stages: [{use: make_points}, {use: grow_points}, {use: grow_points}, {use: grow_points}]")
    assert plan.labels == ["make_points", "grow_points", "grow_points.2", "grow_points.3"]


def test_the_resolved_config_says_the_same(project: Project):
    text = """
        stages:
          - use: make_points
            as: dots
          - use: grow_points
            from: {points: dots}
          - use: count_points
            limit: 7.0
        """
    plan = project.plan(text)
    assert plan.resolved()["stages"][1] == {
        "use": "grow_points",
        "from": {"points": "dots"},
        "factor": 2.0,
        "limit": 7.0,
    }


@pytest.mark.parametrize(
    ("label", "near"), [("grow_point", "did you mean 'grow_points'?"), ("x", "known: grow_points")]
)
def test_an_unknown_label_is_refused_with_the_nearest(project: Project, label: str, near: str):
    plan = project.plan("stages: [{use: make_points}, {use: grow_points}]")
    assert plan.require_label("grow_points", "until") == "grow_points"
    with pytest.raises(ConfigError, match=f"--until {label}: the config has no stage '{label}'; {near[:-1]}"):
        plan.require_label(label, "until")

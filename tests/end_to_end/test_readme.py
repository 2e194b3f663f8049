"""What the README says is what the code does."""

from pathlib import Path

from scaffold_pipeline.cli.app import app
from scaffold_pipeline.stages.catalogue import markdown_table, metrics_table

README = (Path(__file__).parents[2] / "README.md").read_text()


def block(mark):
    """Return the code block that follows a mark, as `.ci/run` reads it."""
    return README.partition(f"<!-- {mark} -->")[2].partition("```bash\n")[2].partition("```")[0].strip()


def test_the_stage_table_is_the_one_that_the_code_prints():
    table = README.partition("`scaffold-pipeline stages --markdown` -->")[2].partition("<!-- end of stages -->")[0]
    assert table.strip() == markdown_table()


def test_the_table_of_what_is_measured_is_the_one_that_the_code_prints():
    table = README.partition("`scaffold-pipeline stages --metrics` -->")[2].partition("<!-- end of metrics -->")[0]
    assert table.strip() == metrics_table()


def test_the_two_commands_are_where_the_check_looks_for_them():
    assert block("main").endswith("scaffold-pipeline run configs/femoral_head.yaml")
    assert block("tests").endswith("&& pytest")


def test_every_command_is_in_the_readme():
    commands = [name for name in app if not name.startswith("-")]
    assert "run" in commands
    assert [name for name in commands if f"| `{name}" not in README] == []

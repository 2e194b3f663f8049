"""The command `scaffold-pipeline`: it turns arguments into calls.

A module that only one command needs is imported inside that command, so that `--help` is fast.
"""

from __future__ import annotations

import sys
import traceback
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, CycloptsError, Parameter

from scaffold_pipeline import __version__
from scaffold_pipeline.cli.options import (
    FAILED,
    GATE_FAILED,
    INTERRUPTED,
    USAGE,
    CacheFolder,
    Json,
    Quiet,
    Settings,
    answer,
    select_cache,
)
from scaffold_pipeline.cli.provenance import crate, report, verify
from scaffold_pipeline.cli.streams import keep_streams_open
from scaffold_pipeline.cli.study import cache, study
from scaffold_pipeline.errors import lines_and_code
from scaffold_pipeline.processes.threads import use_one_blas_thread

if TYPE_CHECKING:
    from scaffold_pipeline.artifacts import Fact
    from scaffold_pipeline.config.plan import Plan

_DEBUG = "--debug"

app = App(
    name="scaffold-pipeline",
    help="From an anatomical surface to a printable porous scaffold.",
    help_epilogue=(
        "Exit codes: 0 ok; 1 a stage failed; 2 configuration or usage; 3 a quality gate failed; 130 interrupted. "
        "Every command takes --debug: print a traceback with an error."
    ),
    version=__version__,
    default_parameter=Parameter(negative=()),
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)


@app.command
def run(  # noqa: PLR0913 - one argument an option
    config: Path,
    *,
    out: Path | None = None,
    settings: Settings = [],  # noqa: B006 - never modified
    until: str | None = None,
    force: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    dry_run: Annotated[bool, Parameter(name=["--dry-run", "-n"])] = False,
    cache_folder: CacheFolder = None,
    scheduler: str | None = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Run one config; stages whose inputs and parameters are unchanged are not run again.

    Parameters
    ----------
    config
        The config, a YAML file.
    out
        Run directory; runs/NAME by default.
    until
        Stop after this stage; the run directory's files are not changed.
    force
        Run all stages again, or only those named; put it after CONFIG.
    dry_run
        Print what would run, without running it.
    scheduler
        Address of a Dask scheduler; its workers compute large fields in slabs, this machine everything else.
    """
    from scaffold_pipeline.cli.console import watch
    from scaffold_pipeline.report.publish import publish, run_metrics
    from scaffold_pipeline.runs import runner
    from scaffold_pipeline.studies.cluster import cluster_executor

    plan = _plan(config, settings)
    folder = out or Path("runs", plan.name)
    forced = [plan.require_label(name, "force") for name in force] if force else plan.labels if force == [] else []
    last = plan.labels.index(plan.require_label(until, "until")) if until else len(plan.labels) - 1
    shared = select_cache(cache_folder)
    if dry_run:
        labels, unchanged = plan.labels[: last + 1], runner.unchanged_labels(plan, folder, forced, shared)
        reused = [label for label in labels if label in unchanged]
        lines = [f"{label}: {'unchanged' if label in reused else 'to run'}" for label in labels]
        return answer({"stages": labels, "unchanged": reused}, "\n".join(lines), as_json=as_json)
    with cluster_executor(scheduler) as others, runner.locked(folder), watch(quiet=quiet or as_json) as progress:
        result = runner.execute(
            plan, folder, until=until, force=forced, progress=progress, cache=shared, executor=others
        )
        if result.is_complete:
            publish(plan, result, folder)
    if shared is not None:
        shared.prune()
    if not result.is_complete:
        return answer({"out": str(folder), "until": until}, f"stopped after {until}", as_json=as_json)
    failed = result.metrics.failed_gates if result.metrics else ()
    payload = {"out": str(folder), "metrics": run_metrics(result), "files": result.files}
    answer(payload, "" if quiet else _summary_line(folder, run_metrics(result)), as_json=as_json)
    for gate in failed:
        print(f"{folder}: quality gate failed: {gate}", file=sys.stderr)
    return GATE_FAILED if failed else 0


@app.command
def validate(config: Path, *, settings: Settings = [], as_json: Json = False) -> int:  # noqa: B006 - as in run
    """Check a config or study without running it, and print every fault with file:line:column.

    Parameters
    ----------
    config
        The YAML file to check.
    """
    from scaffold_pipeline.studies.file import is_study, read_study

    if is_study(config):
        names = [point.name for point in read_study(config, settings).points]
        return answer({"valid": True, "points": names}, f"{config}: ok, {len(names)} points", as_json=as_json)
    plan = _plan(config, settings)
    return answer({"valid": True, "stages": plan.labels}, f"{config}: ok, {len(plan.steps)} stages", as_json=as_json)


@app.command
def stages(name: str | None = None, *, markdown: bool = False, metrics: bool = False) -> int:
    """List the installed stages, or show the parameters and metrics of one.

    Parameters
    ----------
    name
        The stage to describe.
    markdown
        Print the table of stages that the README shows.
    metrics
        Print the README's table of what is measured, and how.
    """
    from scaffold_pipeline.stages.catalogue import describe, markdown_table, metrics_table, require_stage
    from scaffold_pipeline.stages.contract import Stage
    from scaffold_pipeline.stages.registry import installed_stages

    if name is not None:
        print(describe(require_stage(name)))
    elif markdown:
        print(markdown_table())
    elif metrics:
        print(metrics_table())
    else:
        for stage in installed_stages():
            print(f"{stage.name:18} {stage.summary}" if isinstance(stage, Stage) else f"broken: {stage}")
    return 0


@app.command
def schema() -> int:
    """Print the JSON Schema of a config, installed plug-ins included."""
    from scaffold_pipeline.stages.catalogue import config_schema

    return answer(config_schema(), "", as_json=True)


@app.command
def new(folder: Path, *, example: str = "femoral_head") -> int:
    """Write a starter config and its schema into FOLDER.

    Parameters
    ----------
    folder
        Folder for config.yaml and schema.json; created if it does not exist.
    example
        Name of the example to start from.
    """
    from scaffold_pipeline.config.starter import write_example

    path = write_example(folder, example)
    print(f"wrote {path}; next: scaffold-pipeline run {path}")
    return 0


@app.command
def inspect(file: Path, *, units: str | None = None, as_json: Json = False) -> int:
    """Measure a surface or solid file: size, volume, manifoldness, pieces, and whether a run would load it.

    The exit code is 1 where `load_surface` with its default settings would refuse the file.

    Parameters
    ----------
    file
        STL, OBJ, PLY, OFF, 3MF, GLB, glTF, VTP or legacy VTK.
    units
        mm, cm, m or inch; by default the unit stored in the file, or mm.
    """
    from scaffold_pipeline.stages.inspection import inspect_file

    facts, refusal = inspect_file(file, units)
    code = answer(facts, "\n".join(f"{key}: {value}" for key, value in facts.items()), as_json=as_json)
    if refusal:
        print(refusal, file=sys.stderr)
        return FAILED
    return code


@app.command
def compare(
    first: Annotated[Path, Parameter(name="A")],
    second: Annotated[Path, Parameter(name="B")],
    /,
    *,
    show_all: Annotated[bool, Parameter(name="--all")] = False,
    as_json: Json = False,
) -> int:
    """Compare two runs: configs, inputs, metrics, hashes of artifacts and files, versions.

    Times and memory are not compared: they differ between any two runs.

    Parameters
    ----------
    first
        Directory of a finished run.
    second
        Directory of the other run.
    show_all
        Show equal values too.
    """
    from scaffold_pipeline.provenance.compare import compare_runs, to_lines

    compared = compare_runs(first, second, show_all=show_all)
    sections = {section: [asdict(line) for line in lines] for section, lines in compared.items()}
    return answer({"a": str(first), "b": str(second), **sections}, "\n".join(to_lines(compared)), as_json=as_json)


app.command(study)
app.command(cache)
app.command(verify)
app.command(report)
app.command(crate)


def main(arguments: list[str] | None = None) -> int:
    """Run one command and return its exit code; every failure is one line on standard error."""
    use_one_blas_thread()
    if arguments is None:
        keep_streams_open()
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    debug = _DEBUG in tokens
    tokens = [token for token in tokens if token != _DEBUG]
    try:
        code = int(app(tokens, exit_on_error=False, print_error=False) or 0)
        sys.stdout.flush()
    except KeyboardInterrupt:
        return _fail("interrupted; finished stages are kept: the same command continues", INTERRUPTED, tokens)
    except Exception as error:  # noqa: BLE001 - a user sees a line, not a traceback
        if debug:
            traceback.print_exc()
        return _fail(*_error_lines(error), tokens)
    return code


def _plan(config: Path, settings: list[str]) -> Plan:
    from scaffold_pipeline.config.draft import read_draft
    from scaffold_pipeline.config.plan import make_plan

    return make_plan(read_draft(config, settings))


def _summary_line(folder: Path, metrics: dict[str, Fact]) -> str:
    requested, measured = metrics.get("porosity_requested"), metrics.get("porosity")
    porosity = f"porosity {measured:.3f}" if isinstance(measured, float) else "porosity not measured"
    target = f" (requested {requested:.3f})" if isinstance(requested, float) else ""
    quality = metrics["quality"] if isinstance(metrics["quality"], str) else "FAILED"
    return f"{folder}: {porosity}{target}, quality: {quality}; see {folder / 'report.html'}"


def _error_lines(error: Exception) -> tuple[str, int]:
    """Return the text to print for an error, and the exit code."""
    return (str(error), USAGE) if isinstance(error, CycloptsError) else lines_and_code(error)


def _fail(message: str, code: int, tokens: list[str]) -> int:
    print(message, file=sys.stderr)
    if "--json" in tokens:
        answer({"error": message.splitlines(), "exit_code": code}, "", as_json=True)
    return code

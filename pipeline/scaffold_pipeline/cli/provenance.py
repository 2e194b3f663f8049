"""Commands on finished runs: `verify` repeats one, `report` rewrites its page, `crate` packs it to hand on."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from scaffold_pipeline.cli.options import FAILED, Json, Quiet, answer
from scaffold_pipeline.processes.threads import threads_of_children

if TYPE_CHECKING:
    from scaffold_pipeline.provenance.verify import Verification


def verify(
    folder: Annotated[Path, Parameter(name="RUN_DIR")],
    /,
    *,
    threads: Annotated[int | None, Parameter(validator=Number(gte=1))] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> int:
    """Repeat a finished run and compare the hash of each result; report the first that differs.

    fTetWild is not deterministic, so its mesh is taken from the run's store. The folder itself is not changed.

    Parameters
    ----------
    folder
        The folder of a finished run, or of a study's point.
    threads
        Number of threads of compiled code; no result depends on it.
    """
    from scaffold_pipeline.cli.console import watch
    from scaffold_pipeline.provenance.verify import verify_run

    with watch(quiet=quiet or as_json) as progress, threads_of_children(threads) if threads else nullcontext():
        result = verify_run(folder, progress)
    payload = {"out": str(folder), "agrees": result.difference is None, **asdict(result)}
    answer(payload, "" if quiet or result.difference else f"{folder}: {_agreement(result)}", as_json=as_json)
    if result.difference is None:
        return 0
    print(f"{folder}: {_difference(result)}", file=sys.stderr)
    return FAILED


def report(
    folder: Annotated[Path, Parameter(name="RUN_DIR")], /, *, quiet: Quiet = False, as_json: Json = False
) -> int:
    """Write report.html again from a run's record and files, without computing anything.

    Parameters
    ----------
    folder
        The folder of a finished run, or of a study's point.
    """
    from scaffold_pipeline.report.publish import publish_page

    path = publish_page(folder)
    return answer({"report": str(path)}, "" if quiet else f"wrote {path}", as_json=as_json)


def crate(
    folder: Annotated[Path, Parameter(name="DIR")],
    /,
    *,
    licence: Annotated[str, Parameter(name=["--licence", "--license"])],
    out: Path | None = None,
    as_json: Json = False,
) -> int:
    """Pack a finished run or study as an RO-Crate: its files, their hashes, and how they were made.

    Parameters
    ----------
    folder
        The folder of a run or of a study.
    licence
        URL of the licence of the files; every crate must name one.
    out
        The ZIP file to write; DIR.crate.zip by default.
    """
    from scaffold_pipeline.provenance.crate import write_crate

    target = out or folder.resolve().with_name(f"{folder.resolve().name}.crate.zip")
    count = write_crate(folder, target, licence)
    text = f"{target}: {count} files; the authors are not known here, add them yourself"
    return answer({"crate": str(target), "files": count}, text, as_json=as_json)


def _agreement(result: Verification) -> str:
    fixed = f"; not deterministic, so taken from the store: {', '.join(result.stored)}" if result.stored else ""
    return f"{result.stages} stages and {result.files} files agree with the record{fixed}{_versions(result)}"


def _difference(result: Verification) -> str:
    first = result.difference
    if first is None:
        raise AssertionError("there is no difference to describe")
    hashes = f"recorded {first.recorded or 'nothing'}, found {first.found or 'nothing'}"
    return f"{first.label}: {first.what} differs: {hashes}; {result.stages} stages before it agree{_versions(result)}"


def _versions(result: Verification) -> str:
    pairs = result.versions.items()
    changed = [f"{name} {then or 'absent'} then, {now or 'absent'} now" for name, (then, now) in pairs]
    return f"; different versions: {'; '.join(changed)}" if changed else ""

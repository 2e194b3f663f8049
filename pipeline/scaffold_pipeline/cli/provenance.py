"""The commands on what is done: `verify` makes it again, `report` its page, and `crate` packs it to hand on."""

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
    """Run again what a run recorded, and compare the hash of each result; name the first that differs.

    What cannot be repeated, a mesh of fTetWild, is taken from the run's store. The folder itself stays as it is.

    Parameters
    ----------
    folder
        The folder of a finished run, or of a study's point.
    threads
        Threads of compiled code; no result depends on them.
    """
    from scaffold_pipeline.cli.console import watch
    from scaffold_pipeline.provenance.verify import verify_run

    with watch(quiet=quiet or as_json) as progress, threads_of_children(threads) if threads else nullcontext():
        found = verify_run(folder, progress)
    told = {"out": str(folder), "agrees": found.difference is None, **asdict(found)}
    answer(told, "" if quiet or found.difference else f"{folder}: {_agreement(found)}", as_json=as_json)
    if found.difference is None:
        return 0
    print(f"{folder}: {_difference(found)}", file=sys.stderr)
    return FAILED


def report(
    folder: Annotated[Path, Parameter(name="RUN_DIR")], /, *, quiet: Quiet = False, as_json: Json = False
) -> int:
    """Write report.html again from a run's record and files; nothing is computed again.

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
        URL of the licence that you give the files under: a crate has to name one.
    out
        The ZIP file to write; DIR.crate.zip by default.
    """
    from scaffold_pipeline.provenance.crate import write_crate

    target = out or folder.resolve().with_name(f"{folder.resolve().name}.crate.zip")
    count = write_crate(folder, target, licence)
    text = f"{target}: {count} files; who made it is for you to add"
    return answer({"crate": str(target), "files": count}, text, as_json=as_json)


def _agreement(found: Verification) -> str:
    fixed = f"; cannot be repeated and taken as stored: {', '.join(found.stored)}" if found.stored else ""
    return f"{found.stages} stages and {found.files} files agree with the record{fixed}{_versions(found)}"


def _difference(found: Verification) -> str:
    first = found.difference
    if first is None:
        raise AssertionError("told only of a difference")
    hashes = f"recorded {first.recorded or 'nothing'}, found {first.found or 'nothing'}"
    return f"{first.label}: {first.what} differs: {hashes}; {found.stages} stages before it agree{_versions(found)}"


def _versions(found: Verification) -> str:
    changed = [f"{name} {then or 'absent'} then, {now or 'absent'} now" for name, (then, now) in found.versions.items()]
    return f"; other versions: {'; '.join(changed)}" if changed else ""

"""Check that the wheel and the sdist in a folder hold what they should and nothing else: `distributions.py FOLDER`."""

import sys
import tarfile
import zipfile
from pathlib import Path

WHEEL_NEEDS = (
    "scaffold_pipeline/cli/app.py",
    "scaffold_pipeline/py.typed",
    "scaffold_pipeline/runs/runner.py",
    "scaffold_pipeline/examples/femoral_head.yaml",
    "scaffold_pipeline/report/templates/painter.js",
    "scaffold_pipeline/report/templates/study_page.js",
    "scaffold_pipeline/report/templates/tables.js",
    "scaffold_pipeline/report/templates/viewer.js",
    "scaffold_pipeline/report/templates/run.html.j2",
    "scaffold_stages/arbf_field.py",
    "scaffold_geometry/fields/shepard.py",
    "scaffold_geometry/py.typed",
    "scaffold_stages/py.typed",
)
SDIST_NEEDS = (
    "pyproject.toml", "README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "constraints.txt",
    "configs/minimal.yaml", "pipeline/scaffold_pipeline/cli/app.py", "stages/scaffold_stages/arbf_field.py",
    "tests/end_to_end/distributions.py",
)  # fmt: skip
FOREIGN = ("__pycache__", "/runs/", ".venv/", ".ci/")


def _outside_our_room(name: str) -> str:
    """Return the path of a file, without the folder `runs` that is the engine's own."""
    return f"/{name}".replace("/scaffold_pipeline/runs/", "/scaffold_pipeline/")


def main(folder: Path) -> int:
    """Print what is missing from, or foreign in, the distributions; return 1 where there is something."""
    wheel = zipfile.ZipFile(next(folder.glob("*.whl"))).namelist()
    with tarfile.open(next(folder.glob("*.tar.gz"))) as archive:
        sdist = [name.partition("/")[2] for name in archive.getnames()]
    faults = [f"wheel lacks {name}" for name in WHEEL_NEEDS if name not in wheel]
    faults += [f"sdist lacks {name}" for name in SDIST_NEEDS if name not in sdist]
    faults += [
        f"foreign file {name}"
        for name in wheel + sdist
        if any(part in f"/{name}" for part in FOREIGN) and "pipeline/runs/" not in name
    ]
    tops = {name.partition("/")[0] for name in wheel} - {"scaffold_pipeline", "scaffold_geometry", "scaffold_stages"}
    faults += [f"wheel installs {name}" for name in tops if not name.endswith(".dist-info")]
    print("\n".join(faults) or f"wheel: {len(wheel)} files, sdist: {len(sdist)} files")
    return int(bool(faults))


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))

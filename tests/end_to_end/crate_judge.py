"""An RO-Crate judged by the format's own validator: `crate_judge.py CRATE.zip`, in an environment that has both
`roc-validator` and `rocrate` (it wants other versions of rich than the tests do).

The validator asks the network for the format's context. Here it gets the one that comes with rocrate, and none else. A
crate without its licence is refused first: a validator that accepts everything is none.
"""

from __future__ import annotations

import importlib.resources
import json
import sys
import tempfile
import zipfile
from io import BytesIO
from pathlib import Path

import requests
from requests.adapters import HTTPAdapter
from requests_cache import CachedSession
from rocrate_validator import services
from rocrate_validator.models import Severity, ValidationSettings
from urllib3 import HTTPResponse

CONTEXT = "https://w3id.org/ro/crate/1.3/context"
METADATA = "ro-crate-metadata.json"


def faults_of(crate: Path, context: Path) -> list[str]:
    """Return what the validator has against a crate."""
    result = services.validate(
        ValidationSettings(
            rocrate_uri=str(crate),
            profile_identifier="ro-crate-1.3",
            requirement_severity=Severity.REQUIRED,
            cache_path=context,
            offline=True,
        )
    )
    return [str(issue.message) for issue in result.get_issues()]


class _Context(HTTPAdapter):
    """Answers every request with the context that comes with rocrate."""

    def send(self, request: requests.PreparedRequest, **_: object) -> requests.Response:
        text = importlib.resources.files("rocrate").joinpath("data/ro-crate.jsonld").read_bytes()
        headers = {"Content-Type": "application/ld+json"}
        return self.build_response(request, HTTPResponse(BytesIO(text), headers, 200, preload_content=False))


def keep_context(path: Path) -> None:
    """Put the format's context, under its address, into a cache that the validator reads."""
    with CachedSession(str(path)) as session:
        session.mount("https://", _Context())
        session.get(CONTEXT)


def without_licence(crate: Path, target: Path) -> Path:
    """Write a copy of a crate whose root has no licence."""
    with zipfile.ZipFile(crate) as whole, zipfile.ZipFile(target, "w") as harmed:
        for name in whole.namelist():
            content = whole.read(name)
            if name == METADATA:
                told = json.loads(content)
                del next(entity for entity in told["@graph"] if entity["@id"] == "./")["license"]
                content = json.dumps(told).encode()
            harmed.writestr(name, content)
    return target


def main(crate: Path) -> int:
    """Print what is wrong with the crate; return 1 where something is, or where nothing ever would be."""
    with tempfile.TemporaryDirectory() as folder:
        context = Path(folder) / "context"
        keep_context(context)
        if not faults_of(without_licence(crate, Path(folder) / "harmed.zip"), context):
            print("the validator accepts a crate without a licence")
            return 1
        faults = faults_of(crate, context)
    print("\n".join(faults) or f"{crate}: accepted")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))

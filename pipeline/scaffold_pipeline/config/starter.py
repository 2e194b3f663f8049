"""The example configs that come with the project, to start a new config from."""

from __future__ import annotations

import json
from pathlib import Path

from scaffold_pipeline.errors import ConfigError, Fault, did_you_mean
from scaffold_pipeline.stages.catalogue import config_schema

_SCHEMA_LINE = "# yaml-language-server: $schema=schema.json\n"


def examples() -> dict[str, Path]:
    """Return the example configs by name: those of the installed package, or the checkout's folder `configs`."""
    installed = Path(__file__).parents[1] / "examples"
    folder = installed if installed.is_dir() else Path(__file__).parents[3] / "configs"
    return {path.stem: path for path in sorted(folder.glob("*.yaml"))}


def write_example(folder: Path, name: str) -> Path:
    """Write the example `name` as `folder/config.yaml`, with its mesh and the schema for editors; return the path.

    Raises `ConfigError` for an unknown example, and if one of the files exists already.
    """
    known = examples()
    if name not in known:
        raise ConfigError([Fault(0, 0, f"no example is called {name!r}{did_you_mean(name, known)}", "--example")])
    target, schema = folder / "config.yaml", folder / "schema.json"
    rule = "exists already; choose another folder, or remove it first"
    inputs = {path: folder / path.name for path in known[name].parent.glob(f"{name}.msh")}
    existing = [Fault(0, 0, rule, str(path)) for path in (target, schema, *inputs.values()) if path.exists()]
    if existing:
        raise ConfigError(existing)
    folder.mkdir(parents=True, exist_ok=True)
    schema.write_text(json.dumps(config_schema(), indent=2) + "\n", encoding="utf-8")
    for source, copy in inputs.items():
        copy.write_bytes(source.read_bytes())
    text = known[name].read_text(encoding="utf-8")
    body = text.split("\n", 1)[1] if text.startswith("# yaml-language-server") else text
    target.write_text(_SCHEMA_LINE + body, encoding="utf-8")
    return target

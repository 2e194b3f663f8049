"""The installed stages, their parameters and metrics, from their contracts: stage list, README tables, JSON Schema."""

from __future__ import annotations

from typing import Any

from scaffold_pipeline.artifacts import Metric
from scaffold_pipeline.errors import ConfigError, Fault
from scaffold_pipeline.stages.contract import Follows, Stage, Unit
from scaffold_pipeline.stages.registry import installed_stages, load_stage


def require_stage(name: str) -> Stage:
    """Return the stage `name`; raises `ConfigError` with the most similar name if there is none."""
    try:
        return load_stage(name)
    except LookupError as error:
        raise ConfigError([Fault(0, 0, str(error.args[0]))]) from error


def describe(stage: Stage) -> str:
    """Return the description of a stage for users: purpose, slots, and parameters with units and defaults."""
    reads = ", ".join(f"{name}{' (optional)' if read.optional else ''}" for name, read in stage.reads.items())
    lines = [stage.name, f"  {stage.summary}", f"  reads: {reads or '-'}", f"  writes: {stage.writes}", "  parameters:"]
    for name, text in describe_parameters(stage).items():
        lines += [f"    {name}: {text['type']}, {text['default']}", f"        {text['meaning']}"]
    metrics = [metric for metric in stage.reports.metrics if not metric.instead]
    lines += ["  metrics:"] if metrics else []
    lines += [f"    {metric.key}{f', {metric.unit}' if metric.unit else ''}: {metric.title}" for metric in metrics]
    lines += ["  quality gates:"] if stage.reports.gates else []
    lines += [f"    {gate.name}, switched by {gate.switch}: {gate.passed}" for gate in stage.reports.gates]
    return "\n".join(lines)


def markdown_table() -> str:
    """Return the table of stages for the README."""
    rows = ["| stage | does | reads | writes | parameters |", "|---|---|---|---|---|"]
    for stage in installed_stages():
        if isinstance(stage, Stage):
            reads = ", ".join(stage.reads) or "-"
            parameters = ", ".join(f"`{name}`" for name in stage.params.model_fields) or "-"
            rows.append(f"| `{stage.name}` | {stage.summary} | {reads} | {stage.writes} | {parameters} |")
    return "\n".join(rows)


def metrics_table() -> str:
    """Return the table of metrics that the README shows: a row for all that are computed in the same way."""
    stages = [stage for stage in installed_stages() if isinstance(stage, Stage)]
    metrics = [metric for stage in stages for metric in stage.reports.metrics if metric.method and not metric.instead]
    by_method: dict[str, dict[Metric, None]] = {}
    for metric in metrics:
        by_method.setdefault(metric.method, {})[metric] = None
    rows = ["| keys | BoneJ, CTAn | how, and how far off |", "|---|---|---|"]
    for method, group in by_method.items():
        keys = ", ".join(f"`{metric.key}`" for metric in group)
        symbols = ", ".join(dict.fromkeys(metric.symbol for metric in group if metric.symbol))
        rows.append(f"| {keys} | {symbols} | {method} |")
    return "\n".join(rows)


def config_schema() -> dict[str, Any]:
    """Return the JSON Schema of a configuration with the installed stages."""
    stages = [_stage_schema(stage) for stage in installed_stages() if isinstance(stage, Stage)]
    definitions = {name: body for schema in stages for name, body in schema.pop("$defs", {}).items()}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "scaffold-pipeline config",
        "type": "object",
        "additionalProperties": False,
        "required": ["stages"],
        "properties": {
            "name": {"type": "string", "pattern": "^[A-Za-z0-9][A-Za-z0-9._-]{0,99}$"},
            "seed": {"type": "integer", "minimum": 0},
            "stages": {"type": "array", "minItems": 1, "items": {"oneOf": stages}},
        },
        "$defs": definitions,
    }


def _stage_schema(stage: Stage) -> dict[str, Any]:
    schema = stage.params.model_json_schema()
    for name, unit in stage.params.marked(Unit).items():
        body = schema["properties"][name]
        body["description"] = f"{body.get('description', '')} [{unit.name}]".strip()
    words = {
        "use": {"const": stage.name},
        "as": {"type": "string", "description": f"Slot to write, instead of {stage.writes}."},
        "from": {"type": "object", "description": f"Slots to read, instead of: {', '.join(stage.reads)}."},
    }
    schema["properties"] = {**words, **schema.get("properties", {})}
    schema["required"] = ["use", *schema.get("required", [])]
    return {**schema, "title": stage.name, "description": stage.summary}


def describe_parameters(stage: Stage) -> dict[str, dict[str, str]]:
    """Return for each parameter of a stage its `type` with the unit, its `default` and its `meaning`, in words."""
    units, follows = stage.params.marked(Unit), stage.params.marked(Follows)
    properties = stage.params.model_json_schema().get("properties", {})
    texts = {}
    for name, info in stage.params.model_fields.items():
        default = "required" if info.is_required() else f"default {info.get_default(call_default_factory=True)!r}"
        if name in follows:
            default += f", or as {follows[name].stage}.{follows[name].parameter}"
        kind = _kind(properties.get(name, {}))
        texts[name] = {
            "type": f"{kind} in {units[name].name}" if name in units else kind,
            "default": default,
            "meaning": " ".join((info.description or "").split()),
        }
    return texts


def _kind(schema: dict[str, Any]) -> str:
    if "enum" in schema:
        return " | ".join(map(str, schema["enum"]))
    if "const" in schema:
        return str(schema["const"])
    if "anyOf" in schema:
        return " | ".join(_kind(part) for part in schema["anyOf"] if part.get("type") != "null")
    kind = str(schema.get("format") or schema.get("type") or "value")
    return f"list of {_kind(schema['items'])}" if kind == "array" and "items" in schema else kind

"""From a study file to its points, each a config of its own: all faults are found, each with its place.

base: ../heel.yaml            # a config, relative to this file
set: {write_solid.preview: false}             # values for all points, as with `--set`
vary:                         # the varied parameters, named as for `--set`, and their values
  isosurface.porosity: [0.5, 0.6, 0.7]
  jitter.amount: {linspace: [0.0, 0.3, 4]}    # or {range: [start, stop, step]}
mode: grid                    # all combinations; zip: first with first, and so on; list: `vary` lists the points
repeats: 3                    # number of seeds for each point

Instead of `base` and `vary`, `runs: [a.yaml, b.yaml]` lists configs that are run unchanged.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path

from scaffold_pipeline.config import yaml_source
from scaffold_pipeline.config.draft import (
    NAME,
    NAME_RULE,
    STUDY_KEYS,
    Setting,
    make_draft,
    read_document,
    read_settings,
    target_fault,
)
from scaffold_pipeline.config.plan import Plan, make_plan
from scaffold_pipeline.config.yaml_source import Document
from scaffold_pipeline.errors import ConfigError, Fault, did_you_mean
from scaffold_pipeline.runs.store import hash_json
from scaffold_pipeline.stages.faults import format_value
from scaffold_pipeline.studies.variations import MODES, Variations, read_variations, setting

MOST_POINTS = 2000
"""A study of more points needs confirmation: the number may be a typing error."""

_TOP_LEVEL = ("name", "base", "set", "vary", "mode", "repeats", "runs")
_OTHER_SIGNS = re.compile(r"[^A-Za-z0-9._-]+")
_LONGEST_NAME = 80


@dataclass(frozen=True)
class Point:
    """One config of a study: `varied` are its varied parameters, `settings` replace values of the config.

    `caption` is the config's leading comment, for a config that is run unchanged.
    """

    name: str
    varied: Mapping[str, object]
    config: Document
    settings: tuple[Setting, ...]
    caption: str = ""

    def plan(self) -> Plan:
        """Return the point's plan; raises `ConfigError` with all its faults."""
        return make_plan(make_draft(self.config, self.settings))


@dataclass(frozen=True)
class Study:
    """The points of a study, the columns of its table for the varied parameters, and its file's leading comment."""

    name: str
    columns: tuple[str, ...]
    points: tuple[Point, ...]
    caption: str = ""


def is_study(path: Path) -> bool:
    """Return whether the YAML file at `path` is a study rather than a config."""
    return bool(STUDY_KEYS & set(read_document(path, "a study or a config is a mapping").values))


@dataclass(frozen=True)
class _BasePoints:
    """The points without repeats: the `key` of the file that defines them, their number, and what yields them."""

    key: str
    count: int
    columns: tuple[str, ...]
    points: Callable[[], Iterator[Point]]


def read_study(path: Path, settings: Sequence[str | Setting] = (), *, may_be_large: bool = False) -> Study:
    """Read the study file at `path`; `settings`, as `--set` takes them, are applied to every config.

    Raises `ConfigError` with all faults of the file or, if it has none, of all points, and for more than
    `MOST_POINTS` points unless `may_be_large`.
    """
    document = read_document(path, "a study is a mapping with the keys base and vary, or runs")
    _raise_any([*document.faults, *_top_level_faults(document)])
    given = (*_own_settings(document), *read_settings(settings))
    _raise_any(fault for fault in map(_name_fault, given) if fault)
    base = _from_runs(document, given) if "runs" in document.values else _from_base(document, given)
    repeats = document.values.get("repeats", 1)
    count = base.count * repeats
    if count > MOST_POINTS and not may_be_large:
        rule = f"makes {count:,} points, more than {MOST_POINTS:,}; confirm with --yes"
        raise ConfigError([document.fault((base.key,), f"{base.key}: {rule}")])
    points = [_name_point(point) for single in base.points() for point in _repeat_point(single, repeats)]
    _raise_any(_point_faults(points, document.fault((base.key,), "")))
    columns = (*base.columns, *(("repeat", "seed") if repeats > 1 else ()))
    return Study(str(document.values.get("name", path.stem)), columns, tuple(points), document.comment)


def _top_level_faults(document: Document) -> Iterator[Fault]:
    values = document.values
    for key in values:
        if key not in _TOP_LEVEL:
            yield document.fault((str(key),), f"unknown key {key!r}{did_you_mean(str(key), _TOP_LEVEL)}")
    name, mode, repeats = values.get("name", "study"), values.get("mode", "grid"), values.get("repeats", 1)
    if not (isinstance(name, str) and NAME.fullmatch(name)):
        yield document.fault(("name",), f"name: {NAME_RULE}, got {format_value(name)}")
    if mode not in MODES:
        yield document.fault(("mode",), f"mode: must be one of {', '.join(MODES)}, got {format_value(mode)}")
    if isinstance(repeats, bool) or not isinstance(repeats, int) or repeats < 1:
        yield document.fault(("repeats",), f"repeats: must be a whole number, at least 1, got {format_value(repeats)}")
    for key in {"base", "vary", "mode"} & set(values) if "runs" in values else ():
        yield document.fault((key,), f"{key}: cannot be combined with runs, which lists whole configs")
    if not {"base", "runs"} & set(values):
        yield document.fault((), "needs `base:`, the config to vary, or `runs:`, a list of configs")
    elif set(values) <= {"name", "base", "set", "mode"}:
        yield document.fault(("base",), "nothing varies; give vary or repeats")


def _own_settings(document: Document) -> tuple[Setting, ...]:
    entry = document.values.get("set", {})
    if not isinstance(entry, dict):
        raise ConfigError([document.fault(("set",), f"set: must map parameters to values, got {format_value(entry)}")])
    return tuple(setting(document, ("set", str(target)), str(target), value) for target, value in entry.items())


def _name_fault(given: Setting) -> Fault | None:
    return given.fault("name: cannot be set, the study names its points") if given.target == "name" else None


def _from_base(document: Document, given: tuple[Setting, ...]) -> _BasePoints:
    config = _read_config(document, ("base",), document.values["base"])
    if "vary" not in document.values:
        return _BasePoints("repeats", 1, (), lambda: iter([Point("", {}, config, given)]))
    variations = read_variations(document, document.values.get("mode", "grid"))
    if not isinstance(variations, Variations):
        raise ConfigError(variations)
    _raise_any(_target_faults(config, variations, given))
    short = _short_names(variations.targets)

    def points() -> Iterator[Point]:
        for settings in variations.combinations():
            varied = {each.target: each.value for each in settings}
            yield Point(_point_name(varied, short), varied, config, (*given, *settings))

    return _BasePoints("vary", variations.count, variations.targets, points)


def _target_faults(config: Document, variations: Variations, given: tuple[Setting, ...]) -> Iterator[Fault]:
    for head in variations.heads:
        fault = _name_fault(head) or target_fault(config, head)
        yield from [fault] if fault else []
    for fixed in given:
        if fixed.target in variations.targets:
            yield fixed.fault(f"the study varies {fixed.target}; change its values there")


def _from_runs(document: Document, given: tuple[Setting, ...]) -> _BasePoints:
    entries = document.values["runs"]
    if not isinstance(entries, list) or not entries:
        raise ConfigError([document.fault(("runs",), f"runs: must be a list of configs, got {format_value(entries)}")])
    configs = [_read_config(document, ("runs", index), entry) for index, entry in enumerate(entries)]

    def points() -> Iterator[Point]:
        for config in configs:
            name = str(config.values.get("name", Path(config.source).stem))
            yield Point(name, {"run": name}, config, given, config.comment)

    return _BasePoints("runs", len(configs), ("run",), points)


def _read_config(document: Document, path: yaml_source.Path, entry: object) -> Document:
    """Return the config named at `path` of a study file, relative to its folder."""
    label = ".".join(map(str, path))
    if not isinstance(entry, str):
        raise ConfigError([document.fault(path, f"{label}: must be the path of a config, got {format_value(entry)}")])
    config = Path(document.source).parent / Path(entry).expanduser()
    if not config.is_file():
        rule = "no such file; paths in a study are relative to the study"
        raise ConfigError([document.fault(path, f"{label}: {rule}, got {config}")])
    return read_document(config, "a config is a mapping with the keys name, seed and stages")


def _repeat_point(point: Point, repeats: int) -> Iterator[Point]:
    """Yield `point` with `repeats` seeds: its own first, then seeds derived from it, the same for every point."""
    if repeats == 1:
        yield point
        return
    seeds = [given for given in point.settings if given.target == "seed"]
    root = seeds[-1].value if seeds else point.config.values.get("seed", 0)
    for number in range(1, repeats + 1):
        seed = root if number == 1 else derived_seed(root, number)
        own = [] if number == 1 else [Setting("seed", seed, Fault(0, 0, "", "repeats"))]
        varied = {**point.varied, "repeat": number, "seed": seed}
        name = "_".join(part for part in (point.name, f"repeat-{number}") if part)
        yield replace(point, name=name, varied=varied, settings=(*point.settings, *own))


def derived_seed(root: object, number: int) -> int:
    """Return the seed of repeat `number` of a config whose seed is `root`."""
    return int.from_bytes(sha256(f"{root}:repeat {number}".encode()).digest()[:8], "big") >> 1


def _name_point(point: Point) -> Point:
    return replace(point, settings=(*point.settings, Setting("name", point.name, Fault(0, 0, ""))))


def _short_names(targets: Sequence[str]) -> dict[str, str]:
    """Return the last part of each target, or the whole target if two have the same last part."""
    last = [target.rpartition(".")[2] for target in targets]
    return {target: word if last.count(word) == 1 else target for target, word in zip(targets, last, strict=True)}


def _point_name(varied: Mapping[str, object], short: Mapping[str, str]) -> str:
    """Return a folder name made of the varied parameters, with a hash if they do not fit into it."""
    texts = {short[target]: str(value) for target, value in varied.items()}
    name = "_".join(f"{word}-{_OTHER_SIGNS.sub('-', text)}" for word, text in texts.items())
    is_whole = len(name) <= _LONGEST_NAME and not any(_OTHER_SIGNS.search(text) for text in texts.values())
    return name if is_whole else f"{name[: _LONGEST_NAME - 9]}-{hash_json(dict(varied))[:8]}"


def _point_faults(points: Sequence[Point], place: Fault) -> Iterator[Fault]:
    seen: set[str] = set()
    for point in points:
        try:
            point.plan()
        except ConfigError as error:
            yield from error.faults
        if point.name in seen:
            yield replace(place, message=f"gives the point {point.name} twice; keep one")
        seen.add(point.name)


def _raise_any(faults: Iterable[Fault]) -> None:
    all_faults = list(faults)
    if all_faults:
        raise ConfigError(all_faults)

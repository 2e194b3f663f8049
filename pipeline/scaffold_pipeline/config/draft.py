"""From a YAML file and `--set` texts to a draft of the run: all faults are found, each with its place.

name: heel              # also the name of the run directory
seed: 7                 # all randomness comes from it
stages:
  - use: load_surface   # a stage; `as: NAME` renames the slot it writes, `from: {argument: slot}` those it reads
    path: heel.stl      # everything else is a parameter of the stage
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from scaffold_pipeline.config import yaml_source
from scaffold_pipeline.config.yaml_source import Document
from scaffold_pipeline.errors import ConfigError, Fault, StageDefinitionError, did_you_mean
from scaffold_pipeline.stages.contract import InputFileMark, Params, Stage
from scaffold_pipeline.stages.faults import (
    format_value,
    parameter_fault,
    to_plain,
    unknown_parameter,
    without_consequences,
)
from scaffold_pipeline.stages.registry import load_stage
from scaffold_pipeline.stages.seeds import seed_fault

_TOP_LEVEL = ("name", "seed", "stages")
STUDY_KEYS = frozenset({"base", "runs", "vary"})
"""Keys that only a study has."""
UNNAMED = "run"
"""Name of a config that is not a file and gives none."""
_STAGE_WORDS = ("use", "as", "from")
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
NAME_RULE = "must be letters, digits, dots, dashes and underscores, as it names a folder"
_SLOT = re.compile(r"[a-z][a-z0-9_]*")


@dataclass(frozen=True)
class StageDraft:
    """One entry of `stages:`; `stage` is None if no such stage is installed, `params` is None if they are invalid."""

    index: int
    use: str
    stage: Stage | None
    params: Params | None
    given: frozenset[str] = frozenset()
    slot: str | None = None
    sources: Mapping[str, str] = field(default_factory=dict)

    @property
    def path(self) -> yaml_source.Path:
        """Place of the entry in the file."""
        return ("stages", self.index)

    def prefix(self, message: str) -> str:
        """Return `message` with the name of the entry before it."""
        return f"stages.{self.index} ({self.use}): {message}"


@dataclass(frozen=True)
class Setting:
    """A value that replaces one of the config; `target` is stage.key, name or seed.

    `place` is where it is given, as a fault without a message; its file paths are relative to `folder`.
    """

    target: str
    value: object
    place: Fault
    folder: Path = Path()
    form: str = "stage.parameter"

    def fault(self, message: str) -> Fault:
        """Return a fault at the place where the setting is given."""
        return replace(self.place, message=message)


@dataclass(frozen=True)
class Draft:
    """The configuration in a file with its settings, and the faults found so far."""

    name: str
    seed: int
    stages: tuple[StageDraft, ...]
    document: Document
    overrides: Mapping[yaml_source.Path, Setting]
    faults: tuple[Fault, ...]

    def fault(self, path: yaml_source.Path, message: str) -> Fault:
        """Return a fault at `path`: in the file, or in the setting that gave the value."""
        for length in range(len(path), 0, -1):
            if path[:length] in self.overrides:
                return self.overrides[path[:length]].fault(message)
        return self.document.fault(path, message)


def read_draft(path: Path, settings: Sequence[str] = ()) -> Draft:
    """Read the configuration at `path` and apply `settings`, texts of the form `stage.key=value`.

    Raises `ConfigError` if the file cannot be read or is not a YAML mapping. All other faults are kept in the draft,
    and are reported together with those of the plan.
    """
    return make_draft(
        read_document(path, "a config is a mapping with the keys name, seed and stages"), read_settings(settings)
    )


def read_document(path: Path, rule: str) -> Document:
    """Return the YAML mapping in the file at `path`; raises `ConfigError` with the text `rule` if it is none."""
    document = yaml_source.parse(_read_text(path), str(path))
    if not isinstance(document.values, dict):
        raise ConfigError([document.fault((), rule)])
    return document


def read_settings(texts: Sequence[str | Setting]) -> tuple[Setting, ...]:
    """Return the settings in texts of the form `stage.key=value`, as `--set` takes them; a `Setting` stays as it is."""
    settings = []
    for text in texts:
        if isinstance(text, Setting):
            settings.append(text)
            continue
        target, sign, value = text.partition("=")
        target = target.strip() if sign else ""
        parsed = value if target == "name" else yaml_source.parse_scalar(value)
        settings.append(Setting(target, parsed, Fault(0, 0, "", f"--set {text}"), form="stage.key=value"))
    return tuple(settings)


def settings_from(values: Mapping[str, Any] | None) -> tuple[Setting, ...]:
    """Return what a dict of `stage.key` to values asks for; raises `ConfigError` where it is none."""
    given: object = {} if values is None else values  # what a caller gives may be of any type
    if not isinstance(given, Mapping):
        rule = f"settings: must map stage.parameter to values, got {format_value(given)}"
        raise ConfigError([Fault(0, 0, rule)])
    return tuple(
        Setting(str(target), to_plain(value), Fault(0, 0, "", f"settings[{str(target)!r}]"))
        for target, value in given.items()
    )


def make_draft(document: Document, settings: Sequence[Setting] = ()) -> Draft:
    """Return the draft of a configuration that was read, its values replaced by `settings`."""
    path = Path(document.source)
    values = _copy_tree(document.values)
    values.setdefault("name", path.stem or UNNAMED)
    setting_faults, overrides = _apply_settings(values, settings)
    draft = Draft("", 0, (), document, overrides, ())
    faults = [*document.faults, *setting_faults, *_top_level_faults(draft, values)]
    entries = values.get("stages")
    context = {"base": path.resolve().parent} if document.source else {}  # a dict's paths are seen from here
    stages = []
    for index, entry in enumerate(entries if isinstance(entries, list) else []):
        stage_draft, stage_faults = _read_stage(draft, index, entry, context)
        stages.append(stage_draft)
        faults.extend(stage_faults)
    name, seed = str(values["name"]), values.get("seed", 0)
    return Draft(name, seed if isinstance(seed, int) else 0, tuple(stages), document, overrides, tuple(faults))


def _copy_tree(value: Any) -> Any:  # noqa: ANN401 - a YAML tree
    """Return a copy of a YAML tree in which every alias has its own copy of the value."""
    if isinstance(value, dict):
        return {key: _copy_tree(entry) for key, entry in value.items()}
    return [_copy_tree(entry) for entry in value] if isinstance(value, list) else value


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8-sig")  # some editors put a byte-order mark first
    except IsADirectoryError as error:
        raise ConfigError([Fault(0, 0, "a config is a YAML file, but this is a directory", str(path))]) from error
    except FileNotFoundError as error:
        raise ConfigError([Fault(0, 0, "no such file; `scaffold-pipeline new DIR` writes one", str(path))]) from error
    except UnicodeDecodeError as error:
        raise ConfigError([Fault(0, 0, "not a text file in UTF-8, so not a config", str(path))]) from error
    except OSError as error:
        raise ConfigError([Fault(0, 0, f"cannot be read: {error.strerror}", str(path))]) from error


def _top_level_faults(draft: Draft, values: dict[Any, Any]) -> Iterator[Fault]:
    if STUDY_KEYS & set(values):
        command = f"`scaffold-pipeline study {draft.document.source}`"
        yield draft.fault((), f"this is a study; run it with {command}")
        return
    for key in values:
        if key not in _TOP_LEVEL:
            yield draft.fault((str(key),), f"unknown key {key!r}{did_you_mean(str(key), _TOP_LEVEL)}")
    name = values["name"]
    if not (isinstance(name, str) and NAME.fullmatch(name)):
        yield draft.fault(("name",), f"name: {NAME_RULE}, got {name!r}")
    fault = seed_fault(values.get("seed", 0))
    if fault:
        yield draft.fault(("seed",), fault)
    if not isinstance(values.get("stages"), list) or not values["stages"]:
        yield draft.fault(("stages",), "stages: must be a list of at least one stage, each with `use: NAME`")


def _read_stage(draft: Draft, index: int, entry: object, context: Mapping[str, Any]) -> tuple[StageDraft, list[Fault]]:
    path = ("stages", index)
    if not isinstance(entry, dict) or not isinstance(entry.get("use"), str):
        message = f"stages.{index}: must be a mapping with `use: STAGE`, got {format_value(entry)}"
        return StageDraft(index, "?", None, None), [draft.fault(path, message)]
    bare = StageDraft(index, entry["use"], None, None)
    try:
        stage = load_stage(bare.use)
    except (LookupError, StageDefinitionError) as error:
        return bare, [draft.fault((*path, "use"), bare.prefix(str(error.args[0])))]
    faults = [draft.fault((*path, key), bare.prefix(message)) for key, message in _word_faults(entry, stage)]
    given = {str(key): value for key, value in entry.items() if key not in _STAGE_WORDS}
    params: Params | None = None
    try:
        params = stage.params.model_validate(given, context=context)
    except ValidationError as error:
        faults.extend(
            draft.fault((*path, *detail["loc"]), bare.prefix(parameter_fault(detail, stage)))
            for detail in without_consequences(error.errors(include_url=False))
        )
    slot, sources = entry.get("as", stage.writes), entry.get("from") or {}
    sources = {str(key): str(value) for key, value in sources.items()} if isinstance(sources, dict) else {}
    return StageDraft(index, bare.use, stage, params, frozenset(given), str(slot), sources), faults


def _word_faults(entry: dict[Any, Any], stage: Stage) -> Iterator[tuple[str, str]]:
    slot = entry.get("as", stage.writes)
    if not (isinstance(slot, str) and _SLOT.fullmatch(slot)):
        yield "as", f"as: must be lower-case letters, digits and underscores, got {slot!r}"
    sources = entry.get("from") or {}
    if not isinstance(sources, dict):
        yield "from", f"from: must map the stage's inputs to slots, got {sources!r}"
        return
    for argument in sources:
        if argument not in stage.reads:
            yield "from", f"from: the stage has no input {argument!r}{did_you_mean(str(argument), stage.reads)}"


def _apply_settings(
    values: dict[Any, Any], settings: Sequence[Setting]
) -> tuple[list[Fault], dict[yaml_source.Path, Setting]]:
    """Write each setting into `values`; return the faults and the setting of each path that was written."""
    faults, overrides = [], {}
    for setting in settings:
        try:
            path = _setting_path(values, setting)
            _assign(values, path, setting)
        except LookupError as error:
            faults.append(setting.fault(str(error.args[0])))
        else:
            overrides[path] = setting
    return faults, overrides


def _setting_path(values: dict[Any, Any], setting: Setting) -> yaml_source.Path:
    """Return the path of the setting's target in `values`; raises `LookupError` if there is no such place."""
    target = setting.target
    if target in {"name", "seed"}:
        return (target,)
    stages = values.get("stages")
    entries = [entry if isinstance(entry, dict) else {} for entry in (stages if isinstance(stages, list) else [])]
    head, _, rest = target.partition(".")
    if head == "stages":
        number, _, rest = rest.partition(".")
        head = f"stages.{number}"
        matches = [int(number)] if number.isdecimal() and int(number) < len(entries) else []
    else:
        matches = [index for index, entry in enumerate(entries) if head in (entry.get("use"), entry.get("as"))]
    if not rest:
        raise LookupError(f"must have the form {setting.form}")
    if not matches:
        known = [str(entry["use"]) for entry in entries if "use" in entry]
        raise LookupError(f"the config has no stage {head!r}{did_you_mean(head, known)}")
    if len(matches) > 1:
        raise LookupError(f"{head!r} occurs {len(matches)} times; write stages.{matches[0]}.{rest} for the first")
    return ("stages", matches[0], *rest.split("."))


def target_fault(document: Document, setting: Setting) -> Fault | None:
    """Return the fault of a setting's target, whatever its value: no such stage, or no such parameter."""
    try:
        path = _setting_path(document.values, setting)
        use = document.values["stages"][path[1]]["use"] if len(path) > 1 else None
        stage = load_stage(use) if isinstance(use, str) else None
    except (LookupError, StageDefinitionError) as error:
        return setting.fault(str(error.args[0]))
    if stage is None or path[2] in (*_STAGE_WORDS, *stage.params.model_fields):
        return None
    return setting.fault(f"{setting.target}: {unknown_parameter(str(path[2]), stage)}")


def _assign(values: Any, path: yaml_source.Path, setting: Setting) -> None:  # noqa: ANN401 - a YAML tree
    for depth, part in enumerate(path[:-1]):
        if isinstance(values, dict):
            values = values.setdefault(part, {})
        elif isinstance(values, list) and isinstance(part, int):
            values = values[part]
        else:
            raise _not_a_mapping(path[:depth], part)
    if not isinstance(values, dict):
        raise _not_a_mapping(path[:-1], path[-1])
    values[path[-1]] = _resolve_value(values, str(path[-1]), setting)


def _not_a_mapping(path: yaml_source.Path, part: str | int) -> LookupError:
    return LookupError(f"{'.'.join(map(str, path))} is a single value, so {part!r} cannot be set in it")


def _resolve_value(entry: dict[Any, Any], key: str, setting: Setting) -> object:
    """Return the setting's value; a file path is taken relative to the setting's folder, as a shell completes it."""
    value = setting.value
    if not isinstance(value, str):
        return _copy_tree(value)
    try:
        stage = load_stage(str(entry.get("use")))
    except (LookupError, StageDefinitionError):
        return value  # reported where the stage is read
    is_path = key in stage.params.marked(InputFileMark)
    return str(setting.folder.absolute() / Path(value).expanduser()) if is_path else value

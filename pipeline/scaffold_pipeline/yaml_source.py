"""YAML text to plain values and the place of every one of them.

ruamel.yaml reads YAML 1.2: `12:30` is text and a repeated key is seen, where other readers take the last.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import StringIO
from typing import Any, TypeAlias

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, SequenceNode

from scaffold_pipeline.errors import ConfigError, Fault

Path: TypeAlias = tuple[str | int, ...]
"""Where a value stands in its document: ("stages", 2, "amount")."""

FIRST_PLACE = (1, 1)


@dataclass(frozen=True)
class Document:
    """A parsed file: its values, where each value and key stands (line and column from 1), and repeated keys."""

    source: str
    values: Any
    places: dict[Path, tuple[int, int]]
    faults: tuple[Fault, ...] = ()

    def fault(self, path: Path, message: str) -> Fault:
        """Return a fault at `path`, or at the nearest thing around it that stands in the file."""
        while path and path not in self.places:
            path = path[:-1]
        line, column = self.places.get(path, FIRST_PLACE)
        return Fault(line, column, message, self.source)


def parse(text: str, source: str) -> Document:
    """Parse one YAML document; raises `ConfigError` with the place where it is not YAML."""
    places: dict[Path, tuple[int, int]] = {}
    repeated: list[Fault] = []
    try:
        root = YAML(pure=True).compose(StringIO(text))
        _walk(root, (), places, repeated, source)
        reader = YAML(typ="safe", pure=True)
        reader.allow_duplicate_keys = True
        values = reader.load(StringIO(text))
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line, column = (mark.line + 1, mark.column + 1) if mark else FIRST_PLACE
        raise ConfigError([Fault(line, column, f"not valid YAML: {error.problem or error.context}", source)]) from error
    except (YAMLError, ValueError) as error:
        raise ConfigError([Fault(*FIRST_PLACE, f"not valid YAML: {str(error).splitlines()[0]}", source)]) from error
    except RecursionError as error:
        raise ConfigError([Fault(*FIRST_PLACE, "an alias refers to what it stands in; spell it out", source)]) from error
    return Document(source, values, places, tuple(repeated))


def parse_scalar(text: str) -> Any:  # noqa: ANN401 - YAML decides the type
    """Return the value that `text` has in YAML; text that is not YAML stays text."""
    try:
        return YAML(typ="safe", pure=True).load(StringIO(text))
    except YAMLError:
        return text


def to_yaml(values: object) -> str:
    """Return `values` as block-style YAML in their own order."""
    writer = YAML(typ="safe", pure=True)
    writer.default_flow_style = False
    writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    stream = StringIO()
    writer.dump(values, stream)
    return stream.getvalue()


def _walk(
    node: Node | None, path: Path, places: dict[Path, tuple[int, int]], repeated: list[Fault], source: str
) -> None:
    if node is None:
        return
    places.setdefault(path, (node.start_mark.line + 1, node.start_mark.column + 1))
    if isinstance(node, SequenceNode):
        for index, child in enumerate(node.value):
            _walk(child, (*path, index), places, repeated, source)
    elif isinstance(node, MappingNode):
        seen: dict[str, int] = {}
        for key, child in node.value:
            name, line = str(key.value), key.start_mark.line + 1
            if name in seen:
                message = f"{name!r} is given twice, first on line {seen[name]}; keep one"
                repeated.append(Fault(line, key.start_mark.column + 1, message, source))
            seen.setdefault(name, line)
            places.setdefault((*path, name), (line, key.start_mark.column + 1))
            _walk(child, (*path, name), places, repeated, source)

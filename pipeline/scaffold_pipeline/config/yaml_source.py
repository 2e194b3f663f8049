"""From YAML text to plain values and the place of each.

ruamel.yaml reads YAML 1.2: `12:30` is text. Repeated keys are found here; other readers take the last one silently.
"""

from __future__ import annotations

from dataclasses import dataclass
from io import StringIO
from itertools import takewhile
from typing import Any, TypeAlias

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, Node, SequenceNode
from ruamel.yaml.reader import ReaderError

from scaffold_pipeline.errors import ConfigError, Fault

Path: TypeAlias = tuple[str | int, ...]
"""The place of a value in its document: ("stages", 2, "amount")."""

FIRST_PLACE = (1, 1)

_MOST_VALUES = 100_000
"""More than any config has: aliases of aliases can expand to any number."""


@dataclass(frozen=True)
class Document:
    """A parsed file: its values, the place of each value and key (line and column from 1), and repeated keys.

    `comment` is the comment at its beginning, in one line. A config made in Python has no `source` and no places.
    """

    source: str
    values: Any
    places: dict[Path, tuple[int, int]]
    faults: tuple[Fault, ...] = ()
    comment: str = ""

    def fault(self, path: Path, message: str) -> Fault:
        """Return a fault at `path`, or at the innermost value around it that is in the file."""
        if not self.source:
            return Fault(0, 0, message)
        while path and path not in self.places:
            path = path[:-1]
        line, column = self.places.get(path, FIRST_PLACE)
        return Fault(line, column, message, self.source)


def parse(text: str, source: str) -> Document:
    """Parse one YAML document; raises `ConfigError` with the place of a syntax error."""
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
        place = (mark.line + 1, mark.column + 1) if mark else FIRST_PLACE
        raise _not_yaml(error.problem or error.context, place, source) from error
    except ReaderError as error:
        before = text[: error.position]
        place = before.count("\n") + 1, len(before) - before.rfind("\n")
        raise _not_yaml(str(error).splitlines()[0], place, source) from error
    except (YAMLError, ValueError) as error:
        raise _not_yaml(str(error).splitlines()[0], FIRST_PLACE, source) from error
    except RecursionError as error:
        message = "an alias refers to a value that contains it, or values are nested too deeply; write them out"
        raise ConfigError([Fault(*FIRST_PLACE, message, source)]) from error
    return Document(source, values, places, tuple(repeated), _leading_comment(text))


def _leading_comment(text: str) -> str:
    """Return the comment at the beginning of `text` as one line, without the schema line for editors."""
    lines = takewhile(lambda line: line.startswith("#"), text.splitlines())
    texts = (line.lstrip("#").strip() for line in lines)
    return " ".join(line for line in texts if line and not line.startswith("yaml-language-server:"))


def _not_yaml(problem: object, place: tuple[int, int], source: str) -> ConfigError:
    return ConfigError([Fault(*place, f"not valid YAML: {problem}", source)])


def parse_scalar(text: str) -> Any:  # noqa: ANN401 - YAML decides the type
    """Return the value of `text` read as YAML; text that is not YAML stays text."""
    try:
        return YAML(typ="safe", pure=True).load(StringIO(text))
    except (YAMLError, ValueError):  # ValueError: it looks like a date, but is none
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
    if len(places) > _MOST_VALUES:
        message = f"has more than {_MOST_VALUES} values with aliases expanded; use fewer aliases"
        raise ConfigError([Fault(*FIRST_PLACE, message, source)])
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

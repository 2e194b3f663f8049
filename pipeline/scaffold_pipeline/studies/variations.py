"""The varied parameters of a study: their values, and how these are combined."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from itertools import product
from pathlib import Path as FilePath

from scaffold_pipeline.config.draft import Setting
from scaffold_pipeline.config.yaml_source import Document, Path
from scaffold_pipeline.errors import Fault
from scaffold_pipeline.stages.faults import format_value

MODES = ("grid", "zip", "list")

_FORMS = "a list, {range: [start, stop, step]} or {linspace: [start, stop, count]}"
_DIGITS = 12
"""Significant digits of computed values: 0.1 + 2 * 0.1 is 0.3."""


@dataclass(frozen=True)
class Axis:
    """One parameter and its `count` values, computed one by one: a full list may be too large for memory."""

    target: str
    count: int
    value: Callable[[int], object]
    path: Callable[[int], Path]

    def at(self, index: int, document: Document) -> Setting:
        """Return the setting that gives the parameter its value number `index`."""
        return setting(document, self.path(index), self.target, self.value(index))


@dataclass(frozen=True)
class Variations:
    """All combinations of a study: their number, and a function that yields the settings of each."""

    count: int
    targets: tuple[str, ...]
    combinations: Callable[[], Iterator[tuple[Setting, ...]]]
    heads: tuple[Setting, ...]
    """Each parameter once, placed at its name: an unknown parameter is reported once, not for each value."""


def read_variations(document: Document, mode: str) -> Variations | list[Fault]:
    """Return the variations in `vary:` of a study file, or its faults."""
    entry = document.values.get("vary")
    if mode == "list":
        return _from_list(document, entry)
    if not isinstance(entry, dict) or not entry:
        rule = "vary: must map parameters to values, such as `isosurface.porosity: [0.5, 0.6]`"
        return [document.fault(("vary",), f"{rule}, got {format_value(entry)}")]
    results = [_read_axis(document, str(target), values) for target, values in entry.items()]
    axes = [axis for axis in results if isinstance(axis, Axis)]
    faults = [fault for fault in results if isinstance(fault, Fault)]
    faults += _length_faults(document, axes) if mode == "zip" else []
    return faults or _combine(document, axes, mode)


def setting(document: Document, path: Path, target: str, value: object = None) -> Setting:
    """Return the setting at `path` of a study file."""
    return Setting(target, value, document.fault(path, ""), FilePath(document.source).parent)


def _combine(document: Document, axes: list[Axis], mode: str) -> Variations:
    counts = [axis.count for axis in axes]

    def combinations() -> Iterator[tuple[Setting, ...]]:
        ranges = map(range, counts)
        for indices in zip(*ranges, strict=True) if mode == "zip" else product(*ranges):
            yield tuple(axis.at(index, document) for axis, index in zip(axes, indices, strict=True))

    count = counts[0] if mode == "zip" else math.prod(counts)
    targets = tuple(axis.target for axis in axes)
    heads = [setting(document, ("vary", target), target) for target in targets]
    return Variations(count, targets, combinations, tuple(heads))


def _length_faults(document: Document, axes: list[Axis]) -> list[Fault]:
    return [
        document.fault(
            ("vary", axis.target),
            f"{axis.target}: has {axis.count} values, but {axes[0].target} has {axes[0].count}; "
            "`mode: zip` needs lists of equal length",
        )
        for axis in axes[1:]
        if axis.count != axes[0].count
    ]


def _from_list(document: Document, entry: object) -> Variations | list[Fault]:
    if not isinstance(entry, list) or not entry:
        rule = "vary: with `mode: list` it must be a list of mappings, such as `- {isosurface.porosity: 0.5}`"
        return [document.fault(("vary",), f"{rule}, got {format_value(entry)}")]
    faults = [
        document.fault(("vary", index), f"vary.{index}: must map parameters to values, got {format_value(point)}")
        for index, point in enumerate(entry)
        if not isinstance(point, dict) or not point
    ]
    if faults:
        return faults

    points = [
        tuple(setting(document, ("vary", index, str(target)), str(target), value) for target, value in point.items())
        for index, point in enumerate(entry)
    ]
    heads = tuple(each for point in points for each in point)
    targets = tuple(dict.fromkeys(each.target for each in heads))
    return Variations(len(points), targets, lambda: iter(points), heads)


def _read_axis(document: Document, target: str, entry: object) -> Axis | Fault:
    path: Path = ("vary", target)
    if isinstance(entry, list):
        if not entry:
            return document.fault(path, f"{target}: is an empty list; give at least one value")
        return Axis(target, len(entry), entry.__getitem__, lambda index: (*path, index))
    makers = {"range": _range, "linspace": _linspace}
    word = next(iter(entry), None) if isinstance(entry, dict) and len(entry) == 1 else None
    if not isinstance(entry, dict) or word not in makers:
        return document.fault(path, f"{target}: must be {_FORMS}, got {format_value(entry)}")
    numbers = entry[word]
    try:
        count, value = makers[word](*_three_numbers(numbers))
    except ValueError as error:
        return document.fault((*path, word), f"{target}: {word}: {error}, got {format_value(numbers)}")
    return Axis(target, count, value, lambda _: (*path, word))


def _three_numbers(entry: object) -> tuple[float, float, float]:
    numbers = entry if isinstance(entry, list) else []
    is_sound = all(
        isinstance(number, int | float) and not isinstance(number, bool) and math.isfinite(number) for number in numbers
    )
    if len(numbers) != 3 or not is_sound:  # start, stop, and step or count
        raise ValueError("must be three numbers")
    return numbers[0], numbers[1], numbers[2]


def _range(start: float, stop: float, step: float) -> tuple[int, Callable[[int], object]]:
    """Return the number of values from `start` to `stop`, and each by its index; `stop` is one if a step ends on it.

    >>> count, value = _range(0.1, 0.3, 0.1)
    >>> [value(index) for index in range(count)]
    [0.1, 0.2, 0.3]
    """
    first, last, stride = (Fraction(Decimal(str(number))) for number in (start, stop, step))
    if stride == 0 or (last - first) / stride < 0:
        raise ValueError("must be [start, stop, step] with a step from start towards stop")
    is_whole = all(isinstance(number, int) for number in (start, step))
    return int((last - first) / stride) + 1, lambda index: _number(first + index * stride, is_whole=is_whole)


def _linspace(start: float, stop: float, count: float) -> tuple[int, Callable[[int], object]]:
    """Return `count` and that many evenly spaced values from `start` to `stop`, each by its index.

    >>> count, value = _linspace(0, 1, 3)
    >>> [value(index) for index in range(count)]
    [0.0, 0.5, 1.0]
    """
    if not isinstance(count, int) or count < 2:  # both ends
        raise ValueError("must be [start, stop, count] with a whole count, at least 2")
    first, last = (Fraction(Decimal(str(number))) for number in (start, stop))
    stride = (last - first) / (count - 1)
    is_whole = isinstance(start, int) and isinstance(stop, int) and stride.denominator == 1
    return count, lambda index: _number(first + index * stride, is_whole=is_whole)


def _number(value: Fraction, *, is_whole: bool) -> int | float:
    return int(value) if is_whole else float(f"{float(value):.{_DIGITS}g}")

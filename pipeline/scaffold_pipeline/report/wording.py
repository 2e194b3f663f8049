"""Numbers, times and verdicts as text for people."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable

_GATE_STARTS = re.compile(r"; (?=[a-z_]+: )")  # a gate's line, `name: what; remedy`, may hold a semicolon itself

NOTHING = "\u2013"
"""The text for a missing value."""


def to_text(value: object) -> str:
    """Return a fact as text: numbers with four digits, more if close to 1; yes or no; a dash for None.

    >>> [to_text(value) for value in (0.65432, 0.99998, 1234567, 12345.6, True, None, [1.0, 2.34567])]
    ['0.6543', '0.99998', '1\u202f234\u202f567', '12\u202f346', 'yes', '\u2013', '1, 2.346']
    """
    if value in (None, "", []):
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")
    if isinstance(value, float):
        is_large = math.isfinite(value) and abs(value) >= 1e4  # where four digits show no fraction
        if is_large and abs(value) < 1e15:  # above, an exponent reads better
            return to_text(round(value))
        return f"{value:.4g}" if value == 1.0 or f"{value:.4g}" != "1" else f"{value:.9g}"
    return ", ".join(map(to_text, value)) if isinstance(value, list) else str(value)


def to_name(number: object) -> str | None:
    """Return an identifying number, such as a seed, with all digits and no spaces.

    >>> [to_name(number) for number in (4398626441190084260, None)]
    ['4398626441190084260', None]
    """
    return None if number is None else str(number)


def to_duration(seconds: float | None) -> str:
    """Return a time as text.

    >>> [to_duration(seconds) for seconds in (0.0123, 4.2, 125.0, 7300.0, None)]
    ['0.01 s', '4.2 s', '2 min 5 s', '2 h 1 min', '\u2013']
    """
    if seconds is None:
        return NOTHING
    if seconds < 60.0:  # a minute
        return f"{seconds:.1f} s" if seconds >= 1.0 else f"{seconds:.2f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes_left = divmod(minutes, 60)
    return f"{hours} h {minutes_left} min" if hours else f"{minutes} min {rest} s"


def to_size(count: float | None) -> str:
    """Return a number of bytes as text.

    >>> [to_size(count) for count in (512, 56085484, 3.2e9, None)]
    ['512 B', '56.1 MB', '3.2 GB', '\u2013']
    """
    if count is None:
        return NOTHING
    for unit in ("B", "kB", "MB"):
        if count < 999.5:  # rounds to 1000
            return f"{count:.0f} B" if unit == "B" else f"{count:.1f} {unit}"
        count /= 1000.0
    return f"{count:.1f} GB"


def failed_gates(quality: object) -> list[str] | None:
    """Return the failed quality gates in `quality` of the metrics or the record; None if not measured."""
    if isinstance(quality, str):
        if quality in {"", "not measured"}:
            return None
        return [] if quality == "pass" else _GATE_STARTS.split(quality)
    return [str(gate) for gate in quality] if isinstance(quality, Iterable) else None

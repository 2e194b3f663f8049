"""Pages from templates: every value is escaped by jinja2, except the package's own styles and scripts."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from scaffold_pipeline.report.wording import to_duration, to_name, to_size, to_text

_TEMPLATES = Path(__file__).with_name("templates")


class Cell(NamedTuple):
    """A cell of a table: its text, and the number that it is sorted by; None sorts last."""

    text: str
    value: float | None


class Figure(NamedTuple):
    """A picture in a page: `source` is a data URI, `about` the alternative text, `width` in mm or None."""

    source: str
    about: str
    caption: str = ""
    width: float | None = None


def to_data_uri(kind: str, content: bytes) -> str:
    """Return a file as a data URI of a MIME type, which loads nothing."""
    return f"data:{kind};base64,{b64encode(content).decode()}"


def render(template: str, *, styles: Iterable[str], scripts: Iterable[str], **context: object) -> str:
    """Return a page: a template with its context, its style files, and the one script that it may run."""
    script = "".join(map(_read, scripts))
    digest = b64encode(sha256(script.encode()).digest()).decode()
    own = {"style": Markup("".join(map(_read, styles))), "script": Markup(script)}  # noqa: S704 - files of this package
    return _environment().get_template(template).render(**context, **own, script_sha256=digest)


@cache
def _environment() -> Environment:
    """Return jinja2's environment: all values escaped, undefined names are errors, JSON for scripts."""
    environment = Environment(
        loader=FileSystemLoader(_TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.policies["json.dumps_kwargs"] = {"ensure_ascii": False, "allow_nan": False}
    environment.filters |= {
        "anchor": lambda title: title.lower().replace(" ", "-"),
        "duration": to_duration,
        "name": to_name,
        "size": to_size,
        "sort_key": lambda value: "" if value is None else f"{value:.9g}",
        "text": to_text,
    }
    return environment


@cache
def _read(name: str) -> str:
    return (_TEMPLATES / name).read_text(encoding="utf-8")

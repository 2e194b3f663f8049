"""Results in notebooks: a run as HTML, and a page in the notebook or the browser."""

from __future__ import annotations

import sys
import tempfile
import webbrowser
from base64 import b64encode
from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from scaffold_pipeline.artifacts.markup import facts_table, verdict_html

_PICTURE = "preview.png"

_MAIN_NUMBERS = (
    *("porosity", "porosity_requested", "volume_mm3", "solid_pieces", "pore_pieces"),
    *("struts_interrupted", "channels_interrupted", "strut_thickness_mean", "pore_size_mean", "seconds"),
)
"""The main metrics of a run, shown if they were measured; the page has all."""

_FRAME_HEIGHT = 800
"""Height, pixels, of the page's verdict, picture and first table."""


def run_html(folder: Path, record: Mapping[str, Any], metrics: Mapping[str, Any]) -> str:
    """Return a run as HTML: its name, the verdict, the picture if there is one, and the main metrics."""
    numbers = {key: metrics[key] for key in _MAIN_NUMBERS if metrics.get(key) is not None}
    warnings = "".join(f"<li>{escape(str(message))}</li>" for message in record["warnings"])
    listed = f"<p>warnings:</p><ul>{warnings}</ul>" if warnings else ""
    title = f"<strong>{escape(str(record['name']))}</strong>"
    verdict = verdict_html(metrics.get("quality"))
    return f"<div><p>{title}, {verdict}</p>{_picture_html(folder, record)}{facts_table(numbers)}{listed}</div>"


def _picture_html(folder: Path, record: Mapping[str, Any]) -> str:
    path = folder / _PICTURE
    if _PICTURE not in record["files"] or not path.is_file():
        return ""
    return f'<img alt="the solid" style="max-width: 480px" src="data:image/png;base64,{_base64(path)}">'


def _base64(path: Path) -> str:
    return b64encode(path.read_bytes()).decode()


def show_page(page: Path, *, is_temporary: bool) -> None:
    """Show a self-contained HTML page in the notebook, or else in the browser.

    The browser may open the page after the process has ended, so a temporary page is copied to the system's temporary
    folder.
    """
    shell = _notebook()
    if shell is not None:
        from IPython.display import HTML, display

        source = escape(page.read_text(encoding="utf-8"), quote=True)
        style = f"width: 100%; height: {_FRAME_HEIGHT}px; border: 0"
        display(HTML(f'<div><iframe sandbox="allow-scripts" style="{style}" srcdoc="{source}"></iframe></div>'))
        return
    if is_temporary:
        with tempfile.NamedTemporaryFile(prefix="scaffold-", suffix=".html", delete=False) as copy:
            copy.write(page.read_bytes())
        page = Path(copy.name)
    webbrowser.open(page.as_uri())


def _notebook() -> object | None:
    """Return IPython's shell in a notebook, where it has a kernel; None in a terminal or a script."""
    if "IPython" not in sys.modules:
        return None
    shell = sys.modules["IPython"].get_ipython()
    return shell if hasattr(shell, "kernel") else None

"""The notebook of `docs/notebooks` runs from its first cell to its last, in a kernel of its own."""

from __future__ import annotations

from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
NAME = "from_bone_to_solid"


@pytest.fixture(scope="module")
def stored():
    return nbformat.read(FOLDER / f"{NAME}.ipynb", as_version=4)


@pytest.fixture(scope="module")
def executed(stored, tmp_path_factory):
    """Return the notebook's code cells after they have run, and the folder that they ran in."""
    folder = tmp_path_factory.mktemp("notebook")
    notebook = nbformat.from_dict(stored.copy())
    NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(folder)}}).execute()
    return [cell for cell in notebook.cells if cell.cell_type == "code"], folder


def shown(cell, kind):
    """Return what a cell shows of one kind, `text/html` or `image/png`."""
    return [output.data[kind] for output in cell.outputs if kind in output.get("data", {})]


def test_it_walks_from_a_bone_to_a_solid_in_ten_cells_stored_without_outputs(stored):
    cells = [cell for cell in stored.cells if cell.cell_type == "code"]
    assert len(cells) == 10
    assert [cell for cell in cells if cell.outputs or cell.execution_count] == []
    assert "load_surface" in cells[0].source
    assert "from_trimesh" in cells[0].source


def test_its_results_show_themselves(executed):
    cells, _ = executed
    assert "OuterShape" in shown(cells[0], "text/html")[0]
    assert "VolumeMesh" in shown(cells[1], "text/html")[0]
    assert [len(shown(cells[number], "image/png")) for number in (3, 5)] == [1, 1]
    assert "Solid" in shown(cells[4], "text/html")[0]
    assert "WrittenFiles" in shown(cells[8], "text/html")[0]
    assert "quality: <strong>pass</strong>" in shown(cells[9], "text/html")[0]
    assert "data:image/png;base64," in shown(cells[9], "text/html")[0]


def test_its_solid_is_what_was_asked_for(executed):
    cells, folder = executed
    told = "".join(output.text for output in cells[7].outputs if output.output_type == "stream")
    assert "1 piece" in told
    assert shown(cells[6], "text/plain") == ["'all gates passed'"]
    assert "watertight: True" in told
    assert float(told.split()[1].rstrip(",")) == pytest.approx(0.5, abs=0.01)
    assert [path.name for path in (folder / "femur").iterdir()] == ["solid.stl"]

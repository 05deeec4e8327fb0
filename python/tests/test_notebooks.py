"""The notebooks of the documentation run from start to end."""

import pathlib

import pytest

nbformat = pytest.importorskip("nbformat")
client = pytest.importorskip("nbclient")
pytest.importorskip("matplotlib")
pytest.importorskip("pandas")

FOLDER = pathlib.Path(__file__).resolve().parents[2] / "docs" / "notebooks"


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    client.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    for number, cell in enumerate(notebook.cells):
        assert all(output["output_type"] != "error" for output in cell.get("outputs", [])), number


def test_there_are_notebooks():
    assert len(list(FOLDER.glob("*.ipynb"))) == 2

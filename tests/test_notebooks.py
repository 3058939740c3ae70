"""The notebooks are small as they are stored, and run as a reader would run them (with -m slow)."""

import os
import shutil
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parent.parent

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LIMIT = 100_000
"""Bytes of a stored notebook: what a code host shows without waiting."""

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def test_there_are_notebooks():
    assert len(NOTEBOOKS) >= 6


@every_notebook
def test_a_notebook_is_stored_small_and_without_errors(path):
    size = path.stat().st_size
    assert size <= LIMIT, f"{path.name} has {size} bytes; run python .ci/small_notebooks.py notebooks/*.ipynb"
    notebook = nbformat.read(path, as_version=4)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert outputs, "stored without outputs"
    assert not [output for output in outputs if output.output_type == "error"]
    assert not [output for output in outputs if output.get("name") == "stderr"]


@pytest.mark.slow  # a step of its own in .ci/run
@every_notebook
def test_a_notebook_runs_and_was_saved_with_its_outputs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code), "saved without outputs"
    if "BAYES_GREYBOX_DATA" not in os.environ and any("BAYES_GREYBOX_DATA" in cell.source for cell in code):
        pytest.skip("BAYES_GREYBOX_DATA names no folder of data")
    for folder in ("configs", "benchmarks"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    (tmp_path / "notebooks").mkdir()
    client = NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path / "notebooks")}})
    client.execute()

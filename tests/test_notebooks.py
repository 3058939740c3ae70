"""The notebooks run as a reader would run them."""

import os
import shutil
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parent.parent

pytestmark = pytest.mark.slow  # a step of its own in .ci/run


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_a_notebook_runs_and_was_saved_with_its_outputs(path, tmp_path):
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code), "saved without outputs"
    if "BAYES_GREYBOX_DATA" not in os.environ and any("BAYES_GREYBOX_DATA" in cell.source for cell in code):
        pytest.skip("BAYES_GREYBOX_DATA names no folder of data")
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    (tmp_path / "notebooks").mkdir()
    client = NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path / "notebooks")}})
    client.execute()

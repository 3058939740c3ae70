"""The notebooks are small as they are stored, and their cells run, on fewer draws than a reader's (with -m slow)."""

import os
import re
import shutil
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parent.parent

NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
LIMIT = 100_000
"""Bytes of a stored notebook: what a code host shows without waiting."""

SHORTER = {"draws": 250, "tune": 250, "replicates": 2}
"""Largest numbers of what only makes results more exact, in the run here: what a cell does is what is asked."""

every_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def shortened(source):
    """The source of a cell with no more draws, and data sets of a benchmark, than `SHORTER` has."""
    return re.sub(
        rf"\b({'|'.join(SHORTER)})=(\d+)", lambda found: f"{found[1]}={min(int(found[2]), SHORTER[found[1]])}", source
    )


def test_a_cell_has_fewer_draws_and_is_the_same_otherwise():
    cell = "fit = model.fit(data, draws=1000, tune=200, seed=1000)\nAsked(folder, replicates=12)"
    assert shortened(cell) == "fit = model.fit(data, draws=250, tune=200, seed=1000)\nAsked(folder, replicates=2)"


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
def test_a_notebook_runs_and_was_saved_with_its_outputs(path, tmp_path, monkeypatch):
    notebook = nbformat.read(path, as_version=4)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(cell.execution_count for cell in code), "saved without outputs"
    for cell in code:
        cell.source = shortened(cell.source)
    if "BAYES_GREYBOX_DATA" not in os.environ and any("BAYES_GREYBOX_DATA" in cell.source for cell in code):
        pytest.skip("BAYES_GREYBOX_DATA names no folder of data")
    for folder in ("configs", "benchmarks"):
        shutil.copytree(ROOT / folder, tmp_path / folder)
    (tmp_path / "notebooks").mkdir()
    # Its fits are longer than those of tests: what is saved to compile them is lost twice over as they sample.
    monkeypatch.delenv("JAX_DISABLE_MOST_OPTIMIZATIONS", raising=False)
    client = NotebookClient(notebook, timeout=900, resources={"metadata": {"path": str(tmp_path / "notebooks")}})
    client.execute()

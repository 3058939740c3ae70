"""README's Python blocks run as a reader would run them, and its picture is drawn: with -m slow."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

pytestmark = pytest.mark.slow  # in .ci/run with the notebooks


def test_the_python_blocks_of_readme_run(tmp_path, monkeypatch):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    shutil.copytree(ROOT / "configs", tmp_path / "configs")
    # The picture of README is drawn from the study that its last block makes.
    script = ROOT / "docs" / "draw_gallery.py"
    drawn = f"import pathlib, runpy\ndrawer = runpy.run_path({str(script)!r})\n"
    drawn += "drawer['save'](bg.plots.overview(study, wide=False), pathlib.Path('picture.png'))"
    code = "\n".join([*blocks, drawn])
    # Its fits are longer than those of tests: what is saved to compile them is lost twice over as they sample.
    monkeypatch.delenv("JAX_DISABLE_MOST_OPTIMIZATIONS", raising=False)
    result = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=600)
    assert result.returncode == 0, result.stderr
    assert (tmp_path / "run.nc").is_file()
    assert (tmp_path / "gap.html").is_file()
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")
    assert "Converged" in result.stdout

"""The gallery's pictures and outputs, and README's picture.

From the root of a checkout, some minutes in all:

    python docs/draw_gallery.py [NAME ...]

Each script of docs/gallery makes measurements, or reads them, and ends with a study. Beside it are written what the
study says, as NAME.txt, and its overview, as NAME.png. README's picture is that of `hardening_spring`, drawn narrow.
Measured records are read from the folder that `BAYES_GREYBOX_DATA` names.
"""

import runpy
import sys
import textwrap
from pathlib import Path

from matplotlib.figure import Figure
from PIL import Image

import bayes_greybox as bg

DOCS = Path(__file__).parent
GALLERY = DOCS / "gallery"

FIRST = "hardening_spring"
"""The script whose study is shown on the first page and in README."""

WIDTH = 88
"""Characters in a line of output."""


def study_of(name: str) -> bg.Study:
    """The study that a script makes."""
    return runpy.run_path(str(GALLERY / f"{name}.py"))["study"]


def said(study: bg.Study) -> str:
    """The verdict of a study on a line of its own, and its sentence."""
    sentence = textwrap.fill(study.sentence, WIDTH, break_long_words=False, break_on_hyphens=False)
    return f"{study.verdict}\n\n{sentence}\n"


def save(figure: Figure, path: Path) -> None:
    """Write a picture as a PNG of 256 colours, a third of the usual size."""
    figure.savefig(path, dpi=130)
    few = Image.open(path).convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=3)
    few.save(path, optimize=True)


def draw(name: str) -> None:
    """Run a script, and write its output and its picture."""
    study = study_of(name)
    (GALLERY / f"{name}.txt").write_text(said(study), encoding="utf-8")
    save(bg.plots.overview(study), GALLERY / f"{name}.png")
    if name == FIRST:
        save(bg.plots.overview(study, wide=False), DOCS / "what_it_does.png")


if __name__ == "__main__":
    for each in sys.argv[1:] or sorted(path.stem for path in GALLERY.glob("*.py")):
        print(each, flush=True)
        draw(each)

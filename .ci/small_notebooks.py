"""Make the stored outputs of notebooks small: python .ci/small_notebooks.py notebooks/*.ipynb, after they were run.

Figures keep their size and lose colours that nobody sees. A cell with the tag "drop-figure" keeps only the text of its
output; say so in the text beside it. Running this twice changes nothing more.
"""

import base64
import io
import sys
from pathlib import Path

import nbformat
from PIL import Image

COLOURS = 96


def fewer_colours(png: str) -> str:
    """The same picture as an indexed PNG, base64; as it came if that is no smaller."""
    image = Image.open(io.BytesIO(base64.b64decode(png)))
    if image.mode == "P":
        return png
    target = io.BytesIO()
    white = Image.new("RGBA", image.size, "white")
    flat = Image.alpha_composite(white, image.convert("RGBA")).convert("RGB")
    few = flat.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    few.save(target, "PNG", optimize=True)
    small = base64.b64encode(target.getvalue()).decode()
    return small if len(small) < len(png) else png


def shrink(path: Path) -> None:
    """Rewrite one notebook."""
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        for output in cell.get("outputs", []):
            data = output.get("data", {})
            if "image/png" in data and "drop-figure" in cell.metadata.get("tags", []):
                del data["image/png"]
            elif "image/png" in data:
                data["image/png"] = fewer_colours(data["image/png"])
    nbformat.write(notebook, path)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        shrink(Path(name))
        print(f"{Path(name).stat().st_size:>8} {name}")

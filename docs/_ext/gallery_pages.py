"""The gallery as pages: each script of docs/gallery with what its study said, and the overview that it drew."""

from pathlib import Path

from catalogue_pages import keep
from gallery_text import example, index, page
from sphinx.application import Sphinx

SOURCE, FOLDER = "gallery", "generated/gallery"


def _write(app: Sphinx) -> None:
    source, folder = Path(app.srcdir) / SOURCE, Path(app.srcdir) / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    examples = [example(script) for script in sorted(source.glob("*.py"))]
    keep(folder / "index.md", index(examples))
    for each in examples:
        keep(folder / f"{each.name}.md", page(each))
        picture = (source / f"{each.name}.png").read_bytes()
        target = folder / f"{each.name}.png"
        if not target.exists() or target.read_bytes() != picture:
            target.write_bytes(picture)
    made = {"index", *(each.name for each in examples)}
    for path in folder.iterdir():
        if path.stem not in made:
            path.unlink()


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks for its sources."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

"""The catalogue as pages: every effect of its TOML files, with a picture of its formula."""

from pathlib import Path

from catalogue_text import DOMAINS, index, page
from effect_pictures import save_picture
from sphinx.application import Sphinx

from bayes_greybox.physics.catalogue.loading import load_catalogue

FOLDER = "generated/catalogue"


def write(folder: Path) -> None:
    """Write all pages and pictures; what is there and the same already keeps its date."""
    folder.mkdir(parents=True, exist_ok=True)
    keep(folder / "index.md", index())
    for domain in DOMAINS:
        keep(folder / f"{domain}.md", page(domain))
        for effect in load_catalogue(domain):
            save_picture(effect, folder / f"{domain}-{effect.slug}.svg")


def keep(path: Path, text: str) -> None:
    """Write a page unless it is there already, with the same text."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def _write(app: Sphinx) -> None:
    write(Path(app.srcdir) / FOLDER)


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks for its sources."""
    app.connect("builder-inited", _write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

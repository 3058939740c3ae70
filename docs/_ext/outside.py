"""Links to what stands beside `docs/`, and the notebooks as pages.

Pages link to files of the checkout as a code host shows them, `../notebooks/x.ipynb`. Notebooks are copied into the
build from the one place where they stand, and links to them lead to their pages.
"""

import os
import re
import shutil
from pathlib import Path

from sphinx.application import Sphinx

NOTEBOOKS = "generated/tutorials"

PAGES = {"README.md": "index.md"}
"""What of the checkout is a page of the site under another name."""

LISTED = {"results/README": "results"}
"""Pages that list all others of their folder, which a code host shows without a table of contents."""

_LINK = re.compile(r"\]\(((?:\.\./)+)([^)#\s]+)(#[^)\s]*)?\)")


def _copy_notebooks(app: Sphinx) -> None:
    root, folder = Path(app.srcdir).parent, Path(app.srcdir) / NOTEBOOKS
    folder.mkdir(parents=True, exist_ok=True)
    for old in set(path.name for path in folder.glob("*.ipynb")) - set(
        path.name for path in (root / "notebooks").glob("*.ipynb")
    ):
        (folder / old).unlink()
    for notebook in sorted((root / "notebooks").glob("*.ipynb")):
        copy = folder / notebook.name
        if not copy.exists() or copy.read_bytes() != notebook.read_bytes():
            shutil.copyfile(notebook, copy)


def _mend(app: Sphinx, docname: str, content: list[str]) -> None:
    docs = Path(app.srcdir)
    here = docs / docname

    def mended(match: re.Match[str]) -> str:
        up, path, anchor = match.groups()
        target = Path(os.path.normpath(here.parent / up / path))
        if docs in target.parents:
            return match.group()
        name = target.relative_to(docs.parent).as_posix() if docs.parent in target.parents else ""
        if name.startswith("notebooks/"):
            return f"](/{NOTEBOOKS}/{target.name}{anchor or ''})"
        if name in PAGES:
            return f"](/{PAGES[name]})"
        return match.group()

    content[0] = _LINK.sub(mended, content[0])
    if docname in LISTED:
        content[0] += "\n```{toctree}\n:hidden:\n:glob:\n\n*\n```\n"


def setup(app: Sphinx) -> dict[str, bool]:
    """Copy notebooks before pages are looked for, and mend links as pages are read."""
    app.connect("builder-inited", _copy_notebooks)
    app.connect("source-read", _mend)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

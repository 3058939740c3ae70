"""The text of the gallery's pages: each script of docs/gallery with what its study said."""

import ast
from dataclasses import dataclass
from pathlib import Path

VERDICTS = {
    "named": "A name was found",
    "one of": "One of several effects",
    "partly named": "A name, but not the whole answer",
    "unknown": "Something without a name",
    "recalibrate": "A wrong number",
    "instrument": "The sensor",
    "no gap": "Nothing is missing",
}
"""Headings of the gallery by verdict, in their order."""

LEAD = """# Gallery

Measurements, a simulation, and what a study says: where they disagree, what is missing, whether adding it helps.
Each is a script that you can run, two with a data file of your own; its picture is
`bayes_greybox.plots.overview(study)`. `python docs/draw_gallery.py` draws them again.
"""


@dataclass(frozen=True)
class Example:
    """A script, what its first lines say about it, and what its study said."""

    name: str
    title: str
    about: str
    code: str
    verdict: str
    output: str


def example(script: Path) -> Example:
    """Read a script of the gallery, and the output beside it."""
    text = script.read_text(encoding="utf-8")
    title, _, about = (ast.get_docstring(ast.parse(text)) or "").partition("\n")
    code = text.partition('"""\n\n')[2]
    verdict, _, output = script.with_suffix(".txt").read_text(encoding="utf-8").partition("\n")
    return Example(script.stem, title, about.strip(), code, verdict, output.strip())


def page(each: Example) -> str:
    """Return the text of an example's page, in MyST Markdown."""
    picture = f"```{{image}} {each.name}.png\n:class: paper\n:alt: {each.title}: gap, hypotheses and free run.\n```"
    code = f"```python\n{each.code}print(study.sentence)\n```"
    output = f"```text\n{each.output}\n```"
    return "\n\n".join([f"# {each.title}", each.about, picture, code, output]) + "\n"


def index(examples: list[Example]) -> str:
    """Return the text of the gallery's first page: a picture of each example, by verdict."""
    parts = [LEAD]
    for verdict, heading in VERDICTS.items():
        shown = [each for each in examples if each.verdict == verdict]
        if shown:
            parts += [f"## {heading}: *{verdict}*", *map(_card, shown)]
    pages = "\n".join(each.name for each in examples)
    return "\n\n".join(parts) + f"\n\n```{{toctree}}\n:hidden:\n\n{pages}\n```\n"


def _card(each: Example) -> str:
    target = f":target: {each.name}.html\n:class: paper thumbnail\n:alt: {each.title}: gap, hypotheses and free run."
    return f"```{{image}} {each.name}.png\n{target}\n```\n\n[{each.title}]({each.name}.md)"

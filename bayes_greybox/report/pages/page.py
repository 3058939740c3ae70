"""The page of a report, which becomes one HTML file that needs nothing else.

Pages are lists of sections, each a list of blocks; one template draws them all.
"""

import base64
import hashlib
import os
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from bayes_greybox.report.drawing.svg import drawing
from bayes_greybox.report.tables import Table as Table
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.whole_files import write_text

_TEMPLATES = Path(__file__).parent / "templates"


@dataclass(frozen=True)
class Badge:
    """A verdict in a word or two; its tone is "good", "warn", "bad" or "quiet"."""

    text: str
    tone: str
    symbol: str = ""


@dataclass(frozen=True)
class Card:
    """A number that matters, alone or before and after; `left` is the length of the after bar, before being 1."""

    title: str
    about: str
    after: str
    before: str = ""
    note: str = ""
    left: float | None = None


@dataclass(frozen=True)
class Words:
    """A paragraph; "plain", or an "alert" that must not be overlooked."""

    text: str
    tone: str = "plain"
    kind: str = "words"


@dataclass(frozen=True)
class Items:
    """A list, each item with a heading of its own or none."""

    items: Sequence[tuple[str, str]]
    kind: str = "items"


@dataclass(frozen=True)
class Code:
    """Text to read letter by letter, or to copy."""

    text: str
    caption: str = ""
    kind: str = "code"


@dataclass(frozen=True)
class Equations:
    """Learned equations, notes such as nonlinear parameters, the rule for terms, and all in LaTeX to copy.

    An equation is formulas in MathML, of which a line may break between any two, and the same in plain letters.
    """

    equations: Sequence[tuple[Sequence[str], str]]
    notes: Sequence[str]
    rule: str
    latex: str


@dataclass(frozen=True)
class Picture:
    """A figure as SVG; `narrow` is another drawing of it for a phone, `wide` keeps it from shrinking there."""

    drawing: str
    alt: str
    caption: str = ""
    narrow: str = ""
    wide: bool = False


@dataclass(frozen=True)
class Pictures:
    """Figures side by side where there is room."""

    pictures: Sequence[Picture]
    kind: str = "pictures"


@dataclass(frozen=True)
class Details:
    """Blocks that a reader opens."""

    summary: str
    blocks: Sequence[Any]
    kind: str = "details"


@dataclass(frozen=True)
class Cards:
    """Numbers that matter, side by side where there is room."""

    cards: Sequence[Card]
    kind: str = "cards"


@dataclass(frozen=True)
class Findings:
    """Findings about a verdict, each with topic, text and `against`: True, False, or None if not looked at."""

    findings: Sequence[Any]
    kind: str = "findings"


@dataclass(frozen=True)
class Section:
    """A section of the page, open or folded; `lead` says how to read it."""

    anchor: str
    title: str
    lead: str = ""
    blocks: Sequence[Any] = ()
    folded: bool = False


@dataclass(frozen=True)
class Page:
    """A report: the verdict in a sentence and in badges, alerts before all else, then the evidence.

    `remarks` follow the headline; the sections in `opening` stand before the list of contents.
    """

    title: str
    kind: str
    headline: str
    badges: Sequence[Badge] = ()
    facts: Sequence[str] = ()
    alerts: Sequence[str] = ()
    equations: Equations | None = None
    opening: Sequence[Section] = ()
    sections: Sequence[Section] = ()
    footer: str = ""
    remarks: str = ""


def render(page: Page) -> str:
    """Return the page as HTML: style, figures and the script that reads values off them are inside.

    No other script than that runs, by the page's own policy: it names its digest.
    """
    script = (_TEMPLATES / "hover.js").read_text(encoding="utf-8")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return _template().render(page=page, script=script, digest=digest)


def require_place(path: str | os.PathLike[str]) -> None:
    """Refuse the destination of a page that cannot be written, before the work for it."""
    try:
        with tempfile.TemporaryFile(dir=Path(path).parent):
            pass
    except OSError as error:
        raise _unwritable(path, error) from error


def write_page(page: Page, path: str | os.PathLike[str]) -> None:
    """Write a page, which needs no network, beside its destination, then rename it: it is never half-written.

    Raises:
        InputError: The destination cannot be written.
    """
    text = render(page)
    try:
        write_text(path, text)
    except OSError as error:
        raise _unwritable(Path(path), error) from error


def picture(figure: Figure, alt: str, *, wide: bool = False) -> Picture:
    """Return a figure for the page."""
    return Picture(drawing(figure, alt), alt, wide=wide)


def time_picture(draw: Callable[[float], Figure], alt: str, caption: str = "") -> Picture:
    """Return a wide figure, such as one along time, drawn at two widths in inches: for a screen and for a phone."""
    return Picture(drawing(draw(9.0), alt), alt, caption, narrow=drawing(draw(4.6), alt), wide=True)


def _unwritable(path: str | os.PathLike[str], error: OSError) -> InputError:
    return InputError(f'Cannot write "{os.fspath(path)}" ({error.strerror or error}); choose another place.')


@cache
def _template() -> Any:
    import jinja2  # only pages need it

    look: dict[str, Any] = {"autoescape": True, "trim_blocks": True, "lstrip_blocks": True}
    loader = jinja2.FileSystemLoader(_TEMPLATES)
    return jinja2.Environment(loader=loader, undefined=jinja2.StrictUndefined, **look).get_template("page.html.j2")

"""Whatever things are called, pages and figures show it as text: nothing of it becomes a tag or an attribute."""

from dataclasses import replace
from xml.etree import ElementTree

import page_rules
import pytest
import xarray as xr
from fabricated import fabricate, oscillator
from matplotlib.figure import Figure

import bayes_greybox as bg
from bayes_greybox.report.drawing.svg import drawing
from bayes_greybox.report.pages.fit_page import fit_page
from bayes_greybox.report.pages.page import Code, Items, Page, Section, Table, Words, render

MARK = "bang"
HOSTILE = f"\"'><script>{MARK}()</script>]]>&amp;{{{{ 7*7 }}}}"
TAG = f'">&<img src=x onerror={MARK}()>'


def intruders(html: str) -> list:
    """Tags and attributes that a page would not have by itself."""
    outline = page_rules.Outline(html)
    assert not outline.faults, outline.faults
    return [
        (tag, about)
        for tag, about in outline.tags
        if any(name.startswith("on") or MARK in name for name in about) or (tag == "img" and about.get("src") == "x")
    ] + [text for text in script_texts(html) if MARK in text]


def script_texts(html: str) -> list[str]:
    """What stands in scripts, which a browser would run."""
    return [part.split("</script>")[0] for part in html.split("<script")[1:]]


def test_the_rule_rings():
    assert intruders(f"<p><img src=x onerror={MARK}()></p>") and intruders(f"<p><script>{MARK}()</script></p>")
    assert not intruders("<p>&lt;script&gt;</p>")


@pytest.fixture(scope="module")
def fit():
    data = oscillator(40)
    data = replace(data, units={"t": "s", "y": "m", "v": "m/s"}, run_names=(HOSTILE,), remarks=(HOSTILE,))
    terms = [bg.Term("v", name=TAG), bg.Term("y**3", name=f"$\\frac{{{MARK}&%#_^~")]
    model = bg.GreyBox({"v": terms}, simulation={"y": "v"}, discrepancy=None)
    made = fabricate(model, data, chains=2, draws=20)
    made.idata["log_prior"] = xr.DataTree(made.idata["posterior"].dataset[["v_sigma"]])
    return made


def test_a_page_of_a_fit_shows_names_as_text(fit):
    html = render(fit_page(fit, config=HOSTILE))
    assert not intruders(html)
    # It is shown, and not left out.
    assert HOSTILE in "".join(page_rules.Outline(html).every)


def test_every_block_of_a_page_does():
    blocks = [
        Words(HOSTILE),
        Items([(HOSTILE, HOSTILE)]),
        Code(HOSTILE, HOSTILE),
        Table([HOSTILE], [[HOSTILE]], HOSTILE),
    ]
    sections = [Section("anchor", HOSTILE, HOSTILE, blocks)]
    html = render(Page(HOSTILE, HOSTILE, HOSTILE, facts=[HOSTILE], alerts=[HOSTILE], sections=sections, footer=HOSTILE))
    assert not intruders(html) and "7*7" in html


def test_a_drawing_shows_labels_as_text():
    figure = Figure()
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], label=HOSTILE.replace("$", ""))
    axes.set_title(HOSTILE)
    axes.legend()
    svg = drawing(figure, HOSTILE)
    # Well-formed, or a quote or a bracket of the texts would have ended something.
    root = ElementTree.fromstring(svg)
    assert root.get("aria-label") == HOSTILE
    assert not intruders(svg) and any(MARK in (each.text or "") for each in root.iter())

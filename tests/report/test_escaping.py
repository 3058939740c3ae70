"""Whatever things are called, pages and figures show it as text: nothing of it becomes a tag or an attribute."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import page_rules
import pytest
from fabricated import fabricate, oscillator, shown
from matplotlib.figure import Figure

import bayes_greybox as bg
from bayes_greybox.report.drawing.svg import drawing
from bayes_greybox.report.pages.fit_page import fit_page
from bayes_greybox.report.pages.page import Code, Items, Page, Section, Table, Words, render
from bayes_greybox.report.pages.study_page import study_page

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
    return shown(model, data)


def test_a_page_of_a_fit_shows_names_as_text(fit):
    html = render(fit_page(fit, config=HOSTILE))
    assert not intruders(html)
    # It is shown, and not left out.
    assert HOSTILE in "".join(page_rules.Outline(html).every)


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    """A study that names an effect of a user's own file, which says hostile things wherever it may say any."""
    texts = {"name": HOSTILE, "meaning": HOSTILE, "latex": HOSTILE, "reverse": HOSTILE}
    told = "\n".join(f"{key} = {json.dumps(value)}" for key, value in texts.items())
    second = f'[[effect]]\nslug = "square"\nname = {json.dumps(TAG)}\nexpression = "position**2"\nmeaning = "m"\n'
    file = tmp_path_factory.mktemp("hostile") / "mine.toml"
    first = f'[[effect]]\nslug = "cube"\nexpression = "position**3"\nsign = -1\n{told}\n'
    file.write_text(f"{first}{second}", encoding="utf-8")
    data = bg.systems.duffing(k3=40.0).simulate(t=np.linspace(0, 20, 161), noise=0.05, seed=0)
    data = replace(data, run_names=(HOSTILE,), remarks=(HOSTILE,))
    simulation = {"y": "ydot", "ydot": "F - 10*y - 0.5*ydot"}
    model = bg.GreyBox(simulation=simulation, discrepancy=bg.OrthogonalGP(variables=("y",)))
    return bg.find_missing_effects(model, data, catalogue=file, settle=False, progress=False)


def test_a_page_of_a_study_shows_names_of_a_users_catalogue_as_text(named):
    assert named.verdict == "named"
    html = render(study_page(named, config=HOSTILE))
    assert not intruders(html)
    shown = "".join(page_rules.Outline(html).every)
    assert HOSTILE in shown and TAG in shown


def test_a_page_of_a_study_shows_all_that_it_says_as_text(study):
    effects, where, instrument = study.effects.copy(), study.where.copy(), study.instrument.copy()
    for table, columns in ((effects, ("name", "expression", "unit")), (where, ("description",))):
        for column in columns:
            table[column] = HOSTILE
    tie = {"equation": "ydot", "slugs": ("cubic-stiffness", "no such < effect"), "advice": HOSTILE}
    changed = replace(
        study, effects=effects, where=where, instrument=instrument, ties=[tie], warnings=[HOSTILE], against=[HOSTILE],
        left_out={("ydot", HOSTILE): HOSTILE}, settings={HOSTILE: {HOSTILE: HOSTILE}},
    )  # fmt: skip
    html = render(study_page(changed, config=HOSTILE))
    assert not intruders(html)
    assert "".join(page_rules.Outline(html).every).count(HOSTILE) >= 8


@pytest.mark.parametrize("units", [{"y": TAG}, {"y": HOSTILE}])
def test_a_unit_that_is_none_reaches_no_page(units):
    with pytest.raises(bg.InputError, match="nit"):
        fabricate(bg.GreyBox({"v": ["y"]}, simulation={"y": "v"}), replace(oscillator(40), units=units))


def test_a_state_is_called_as_an_identifier():
    time = np.linspace(0.0, 1.0, 5)
    with pytest.raises(bg.InputError, match="name"):
        bg.Trajectories.from_arrays(time, states={TAG: time}, derivatives={TAG: time})


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

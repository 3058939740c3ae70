import json
import re
from html import escape, unescape
from types import SimpleNamespace

import numpy as np
import page_rules
import pytest
from fabricated import shown

import bayes_greybox as bg
from bayes_greybox.criticism.discrepancy import discrepancy_table
from bayes_greybox.report.pages import fit_page as fit_page_module
from bayes_greybox.report.pages.fit_page import fit_html
from bayes_greybox.report.words.formatting import probability_text
from bayes_greybox.running.errors import InputError

SHORT = {"draws": 50, "tune": 200, "chains": 2, "progress": False}
"""As long a warm-up, and as many rows, as in the test of ArviZ: both run one program."""


@pytest.fixture(scope="module")
def fit():
    data = bg.systems.oscillator().simulate(np.linspace(0.0, 20.0, 60), noise=0.02, seed=1)
    model = bg.GreyBox({"ydot": ["y", "y**3", "ydot**3"]}, discrepancy=bg.OrthogonalGP(features=8))
    return model.fit(data, **SHORT)


@pytest.fixture(scope="module")
def html(fit, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("page") / "run.html"
    fit_html(fit, path, config="[data]")
    return path.read_text(encoding="utf-8")


def test_the_page_of_a_fit_has_its_verdict_first_and_every_part(fit, html):
    assert not fit.verdict.ok
    head = html.split("<main>")[0]
    assert "Not converged" in head and "do not rely on these numbers" in head
    assert "In d(ydot)/dt, y³ and ydot³ matter" in head
    assert 'aria-label="d(ydot)/dt = ' in head and "<math" in head and "<summary>LaTeX</summary>" in head
    anchors = re.findall(r'<section id="([\w-]+)"', html)
    assert anchors == [
        "numbers",
        "coefficients",
        "discrepancy",
        "predicted",
        "free-run",
        "checks",
        "convergence",
        "settings",
    ]


def test_the_numbers_are_those_of_the_fit(fit, html):
    table = fit.inclusion()
    shown = probability_text(table.loc[("ydot", "y**3"), "inclusion"])
    assert f'<td class="number">{escape(shown)}</td>' in html
    assert "P(included)" in html and "SpikeAndSlab" in html and "RMS of f" in html
    assert all(reason.split(":")[0] in unescape(html) for reason in fit.verdict.reasons)


def test_nothing_is_fetched_and_every_figure_has_words(html):
    assert page_rules.broken(html) == []
    assert len(re.findall(r"<figure ", html)) == 9 == len(re.findall(r'<svg [^>]*aria-label="[^"]{20,}"', html))


def test_what_a_figure_shows_can_be_read_off_it(html):
    """A line of the drawing, by the box and the limits of its axes, is the line that was drawn."""
    drawn = r'aria-label="Discrepancy in d\(ydot\)/dt {}" viewBox="[^"]*" data-axes="([^"]*)">(.*?)</svg>'
    found = re.search(drawn.format("along time"), html)
    (axes,) = json.loads(unescape(found[1]))
    assert axes["names"] == ["time [s]", "discrepancy f [m/s²]"] and list(axes["lines"].values()) == ["mean"]
    (line,) = axes["lines"]
    commands = re.search(rf'id="{line}">.*?d="M([^"]*)"', found[2])[1]
    start, steps = commands.split("l")
    points = np.cumsum(np.array([start.split(), *np.reshape(steps.split(), (-1, 2))], float), axis=0)
    left, top, width, height = axes["box"]
    time = axes["x"][0] + (points[:, 0] - left) / width * np.subtract(*axes["x"][::-1])
    assert time[0] == pytest.approx(0.0, abs=0.02) and time[-1] == pytest.approx(20.0, abs=0.02)
    assert np.all(np.diff(time) >= 0)
    maps = re.search(drawn.format("over the states"), html)
    shown = [one["map"] for one in json.loads(unescape(maps[1]))]
    assert [one["name"] for one in shown] == ["mean of f [m/s²]", "sd of f [m/s²]"]
    assert all(len(one["values"]) == 2 * one["across"] ** 2 for one in shown)


def test_maps_of_an_f_that_is_nothing_are_folded(fit, monkeypatch):
    def maps_in(left):
        learned = {"ydot": SimpleNamespace(discrepancy=SimpleNamespace(left=left))}
        monkeypatch.setattr(fit_page_module, "fitted_system", lambda _: SimpleNamespace(learned=learned))
        section = fit_page_module._discrepancy(fit, discrepancy_table(fit))
        return [block.kind for block in section.blocks][:2]

    assert maps_in(True)[0] == "pictures" and maps_in(False) == ["words", "details"]


def test_the_checks_are_on_the_page(fit, html):
    found = fit.checks()
    assert list(found.table.columns) == ["ok", "value", "limit", "reason"]
    assert [check for _, check in found.table.index] == ["LOO-PIT", "whiteness", "prior sensitivity"]
    # two hundred draws have not converged, and every check says so first
    assert not found.ok and "not converged" in found.reasons[0] and found.reasons[0] in html
    assert html.count("passed</td>") == int(found.table["ok"].sum())


def test_a_model_of_a_study_says_what_the_study_said(fit, tmp_path):
    fit.idata.attrs["missing_effects"] = '{"verdict": "named", "sentence": "It lacks a spring."}'
    try:
        fit_html(fit, tmp_path / "run.html")
    finally:
        del fit.idata.attrs["missing_effects"]
    assert "It lacks a spring. (Verdict: named.)" in (tmp_path / "run.html").read_text(encoding="utf-8")


def test_a_fit_without_discrepancy_has_no_section_about_it(tmp_path):
    data = bg.systems.oscillator().simulate(np.linspace(0.0, 10.0, 60), noise=0.02, seed=1)
    model = bg.GreyBox({"ydot": ["y", "y**3"]}, prior=bg.Laplace(), discrepancy=None)
    fit_html(shown(model, data), tmp_path / "run.html")
    html = (tmp_path / "run.html").read_text(encoding="utf-8")
    assert 'id="discrepancy"' not in html and "left to the discrepancy" not in html
    assert "P(|θ| &gt; ROPE)" in html and "P(included)" not in html


def test_a_place_that_cannot_be_written_is_named(fit, tmp_path):
    with pytest.raises(InputError, match='Cannot write ".*run.html"'):
        fit_html(fit, tmp_path / "absent" / "run.html")

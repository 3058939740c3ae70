import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pandas as pd
import pytest
from fake_study import (
    SENTENCE,
    corrections,
    effects,
    fake_fit,
    fake_study,
    free_paths,
    gap_map,
    gap_table,
    gap_trace,
    hypotheses,
    oscillator,
    rounds,
    where,
)

from bayes_greybox.data.errors import InputError
from bayes_greybox.report.formatting import estimate, formula, interval, nats, number, pareto
from bayes_greybox.report.pages.page import Page, Section, Table, render, write_page
from bayes_greybox.report.pages.study_page import BADGES, study_html, study_page
from bayes_greybox.report.pages.tables import settings_rows
from bayes_greybox.report.record import study_record
from bayes_greybox.report.study_figures import study_figures
from bayes_greybox.report.study_words import amended_simulation, closed_text, metric_interval
from bayes_greybox.report.terminal.study import study_tables

# Most of the time a page takes is that of its figures.
PLAIN = {"maps": {}, "traces": {}, "paths": {}}
EMPTY = {"area", "base", "br", "col", "hr", "img", "input", "link", "meta", "source", "wbr"}


class Outline(HTMLParser):
    """Tags in order, their attributes, and the text that a reader sees; refuses tags that are not closed."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict]] = []
        self.words: list[str] = []
        self.feed(text)
        assert not self.open, f"not closed: {self.open}"

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-1:]}"
        self.open.pop()

    def handle_data(self, data):
        if "style" not in self.open:
            self.words.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.words).split())

    def of(self, tag: str) -> list[dict]:
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def html(tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("page") / "gap.html"
    study_html(fake_study(), path, config='[data]\npath = "run.csv"\n')
    return path.read_text(encoding="utf-8")


def outline(**changes) -> Outline:
    return Outline(render(study_page(fake_study(**changes))))


def test_the_verdict_comes_first_then_the_numbers_then_the_evidence(html):
    page = Outline(html)
    order = ["Named", SENTENCE, "The gap before and after, on held-out data", "Where simulation and measurement"]
    places = [page.text.index(words) for words in order]
    assert places == sorted(places)
    anchors = [attributes["id"] for attributes in page.of("section")]
    assert anchors == [
        "numbers", "where", "what", "how-much", "free-run", "gap", "rounds", "convergence", "corrections", "ties",
        "settings",
    ]  # fmt: skip
    assert [a["href"] for a in page.of("a")] == [f"#{anchor}" for anchor in anchors[1:]]


def test_the_page_is_one_file_that_fetches_nothing(html):
    page = Outline(html)
    for tag, attributes in page.tags:
        assert tag not in {"script", "link", "iframe", "object", "embed"}
        for name in ("src", "srcset", "href", "data", "action"):
            assert attributes.get(name, "data:").startswith(("data:", "#")), (tag, name)
    assert "@import" not in html and "url(" not in html
    policy = next(meta for meta in page.of("meta") if meta.get("http-equiv") == "Content-Security-Policy")
    assert policy["content"].startswith("default-src 'none'")


def test_figures_have_texts_for_those_who_cannot_see_them_and_ids_are_unique(html):
    page = Outline(html)
    images = page.of("img")
    assert len(images) == 8
    assert all(len(image["alt"]) > 20 for image in images)
    # Figures along time are drawn once more for a phone.
    assert len(page.of("source")) == 3
    ids = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert page.of("html")[0]["lang"] == "en"


def test_every_rung_of_the_ladder_shows_its_numbers(html):
    text = Outline(html).text
    for words in (
        "40.9 %", "0.16 %", "99.6 % of the gap closed", "17.3 s", "never",
        "|y| > 0.71 m", "83.0 %", "4.4×",
        "pendulum restoring force", "0.970", "< 0.001", "recalibration of the simulation",
        "−0.800 ± 0.013 1/m²/s²", "−0.8214 to −0.7786",
        'ydot = "F - y - 0.1*ydot - 0.8*y**3 - 0.008*ydot"',
        "Every convergence check passed.", "1.001",
        "−0.0080 ± 0.0040 1/s", "0.610",
        "Drive the system to |y| > 1.1 m",
        "input-gain", "prior odds / no gap", "versions / jax", 'path = "run.csv"', "seed",
    ):  # fmt: skip
        assert words in text, words


def test_the_same_study_makes_the_same_file(html, tmp_path):
    study_html(fake_study(), tmp_path / "again.html", config='[data]\npath = "run.csv"\n')
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == html


@pytest.mark.parametrize("verdict", ["no gap", "recalibrate", "named", "partly named", "unknown"])
def test_every_verdict_has_its_own_badge(verdict):
    page = outline(verdict=verdict, **PLAIN)
    assert BADGES[verdict].text in page.text.split(SENTENCE)[0]
    assert len({(badge.text, badge.symbol) for badge in BADGES.values()}) == 5


def test_a_fit_that_did_not_converge_says_so_before_anything_else():
    page = outline(fit=fake_fit(ok=False), **PLAIN)
    before = page.text.split("The gap before and after")[0]
    assert "sampler did not converge" in before and "do not rely on these numbers" in before and "R̂ of" in before
    assert "12 divergences" in page.text.split("Can the sampler be trusted?")[2]
    assert "did not converge" not in outline(**PLAIN).text


def test_a_study_that_was_not_sampled_says_so_and_draws_intervals_only():
    page = outline(fit=None, **PLAIN)
    assert "screened only, not sampled" in page.text and "Laplace approximation" in page.text


def test_without_held_out_data_the_numbers_are_said_to_be_of_the_training_data():
    page = outline(test=None, gap=gap_table(("train",)), **PLAIN)
    assert "on the training data (none were held out)" in page.text
    assert "held-out data: none" in page.text
    assert "on the held-out data" not in page.text.lower()


def test_what_a_study_lacks_is_left_out_without_a_gap():
    nothing = {
        "effects": effects().iloc[:0],
        "hypotheses": hypotheses().iloc[:0],
        "corrections": corrections().iloc[:0],
        "where": where().iloc[:0],
        "rounds": rounds().iloc[:0],
        "ties": [],
        "paths": {},
        "left_out": {},
    }
    page = outline(verdict="no gap", sentence="Nothing is missing.", **nothing)
    anchors = [attributes["id"] for attributes in page.of("section")]
    assert anchors == ["numbers", "where", "what", "how-much", "gap", "convergence", "settings"]
    assert "No effect was added" in page.text and "No region and no stretch" in page.text
    assert "[simulation]" not in page.text
    assert "nan" not in page.text.lower().split()


def test_a_gap_that_grew_is_not_called_closed():
    table = gap_table()
    table["after"], table["closed"] = 2 * table["before"], -1.0
    page = outline(gap=table, **PLAIN)
    assert "the gap grew by 100 %" in page.text and "of the gap closed" not in page.text
    assert all(float(width) <= 100 for width in re.findall(r'style="width: ([\d.]+)%"', render_of(gap=table, **PLAIN)))
    assert closed_text(float("nan")) == "" and closed_text(0.001) == "unchanged"


def render_of(**changes) -> str:
    return render(study_page(fake_study(**changes)))


def test_the_equation_is_named_only_where_there_are_several():
    def heads(page: Outline) -> bool:
        return "equation" in page.text.split("Where simulation")[-1].split()

    assert not heads(outline())
    data = oscillator()
    second = {
        "maps": {"ydot": gap_map(data), "y": gap_map(data, equation="y")},
        "traces": {"ydot": gap_trace(data), "y": gap_trace(data, equation="y")},
        "hypotheses": pd.concat([hypotheses(), hypotheses("y")]),
    }
    page = outline(**second)
    assert heads(page) and "d(y)/dt" in page.text
    assert {"gap_map_ydot", "gap_map_y", "ranking_y"} <= set(study_figures(fake_study(**second)))


def test_a_gap_over_one_variable_is_one_picture_of_curves():
    page = outline(maps={"ydot": gap_map(oscillator(), n_var=1)}, traces={}, paths={})
    alts = [image["alt"] for image in page.of("img")]
    assert sum("over y" in alt for alt in alts) == 1


def test_names_are_text_and_never_markup():
    table = effects()
    table.loc[0, "name"] = "<script>alert(1)</script> & $x$"
    text = render_of(effects=table, sentence="a < b & c", **PLAIN)
    assert "<script>" not in text and "&lt;script&gt;" in text
    assert "a &lt; b &amp; c" in text


def test_a_page_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    page = Page("t", "k", "h", sections=[Section("a", "A")])
    path = tmp_path / "gap.html"
    path.write_text("old")
    with monkeypatch.context() as broken:
        broken.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError(28, "No space left on device")))
        with pytest.raises(InputError, match="No space left on device.*choose another"):
            write_page(page, path)
    assert [(p.name, p.read_text()) for p in tmp_path.iterdir()] == [("gap.html", "old")]
    write_page(page, path)
    assert path.read_text().startswith("<!DOCTYPE html>")
    with pytest.raises(InputError, match="Cannot write"):
        write_page(page, tmp_path / "absent" / "gap.html")


def test_a_callable_simulation_is_not_printed():
    study = fake_study()
    callable_base = replace(study.base, simulation=lambda t, x, u: x)
    assert amended_simulation(fake_study(base=callable_base)) == ""
    assert "how-much" in render_of(base=callable_base, **PLAIN)


def test_terms_that_are_sums_are_put_in_brackets():
    table = effects().iloc[:1].copy()
    table["expression"], table["mean"], table["sd"] = "y - 0.2", 1.5, 0.1
    words = amended_simulation(fake_study(effects=table, corrections=corrections().iloc[:0]))
    assert words == 'ydot = "F - y - 0.1*ydot + 1.5*(y - 0.2)"'


def test_the_figures_of_a_study_are_named_after_what_they_show():
    figures = study_figures(fake_study())
    assert set(figures) == {
        "gap_map", "gap_time", "ranking", "rounds", "added_coefficients", "free_run_y", "free_run_ydot",
    }  # fmt: skip


def test_the_terminal_has_the_sentence_first_and_fits_80_columns():
    from rich.console import Console

    console = Console(width=80, record=True, file=io.StringIO())
    for part in study_tables(fake_study(fit=fake_fit(ok=False))):
        console.print(part)
    text = console.export_text().replace("\u00a0", " ")
    assert text.startswith("NAMED: The simulation misses a cubic spring")
    assert "Not converged" in text and "+  cubic spring" in text and "99.6 %" in text and "train" not in text
    assert "…" not in text


@pytest.mark.parametrize(
    ("shown", "expected"),
    [
        (number(float("nan")), "–"),
        (number(float("inf")), "∞"),
        (number(None), "–"),
        (number(-3), "−3"),
        (number(20240101), "20240101"),
        (settings_rows({"seed": 20240101, "runs": [1234567, 2]}), [("seed", "20240101"), ("runs", "1234567, 2")]),
        (nats(-12345.67), "−12345.7"),
        (pareto(float("-inf")), "–"),
        (metric_interval(fake_study(), "time to failure", 15.0, float("inf")), "15 s to never"),
        (number(1.23e-7), "1.23·10⁻⁷"),
        (number(np.float64(0.12345)), "0.123"),
        (number(True), "True"),
        (estimate(-0.8, 0.013, "1/m**2"), "−0.800 ± 0.013 1/m²"),
        (estimate(float("nan"), 1.0), "–"),
        (estimate(1.0, 0.0), "1 ± 0"),
        (interval(-0.81, -0.79), "−0.81 to −0.79"),
        (interval(1000.01, 1000.02), "1000.01 to 1000.02"),
        (interval(float("nan"), 1.0), "–"),
        (formula("y**3*ydot - 2*y**-1"), "y³·ydot − 2·y⁻¹"),
        (formula("y**1.5"), "y**1.5"),
    ],
)
def test_numbers_and_formulas_read_well(shown, expected):
    assert shown == expected


def test_columns_of_numbers_and_formulas_are_told_apart():
    assert Table(("term", "#mean", "`form"), []).heads == [("term", "text"), ("mean", "number"), ("form", "formula")]


def test_free_runs_are_of_the_held_out_data():
    data = oscillator(seed=2)
    page = outline(test=data, paths=free_paths(data))
    assert "on the held-out data" in page.text


def test_small_numbers_keep_their_digits_in_the_record():
    study = fake_study(effects=effects().assign(mean=1.23456789e-13, sd=float("nan")))
    (row, *_) = study_record(study, {})["effects"]
    assert row["mean"] == 1.23456789e-13 and row["sd"] is None

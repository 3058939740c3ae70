import base64
import hashlib
import io
import re
from dataclasses import replace

import numpy as np
import page_rules
import pandas as pd
import pytest
from tiny_study import judged

from bayes_greybox.cli.ending import exit_code
from bayes_greybox.discovery.decision.decide import VERDICTS
from bayes_greybox.discovery.learned import shown_effects, studied_system
from bayes_greybox.equations.learned import Value
from bayes_greybox.physics.terms import Term
from bayes_greybox.report.equations.markup import equation_mathml, equations_latex
from bayes_greybox.report.equations.text import as_simulation, equation_text, equations_text
from bayes_greybox.report.folders.study_record import study_record
from bayes_greybox.report.pages.page import Page, Section, Table, render, write_page
from bayes_greybox.report.pages.shared import settings_rows
from bayes_greybox.report.pages.study_page import BADGES, study_html, study_page
from bayes_greybox.report.plots import ranking, study_figures
from bayes_greybox.report.terminal.study import study_tables
from bayes_greybox.report.words.formatting import (
    estimate,
    formula,
    interval,
    nats,
    number,
    numbers_in,
    pareto,
    percent_text,
    probability_text,
    share_interval,
    share_text,
    unbroken,
)
from bayes_greybox.report.words.sentence import sentence
from bayes_greybox.report.words.study import closed_share, closed_text, metric_interval, metric_value, name_of
from bayes_greybox.running.errors import InputError

# Most of the time a page takes is that of its figures.
PLAIN = {"maps": {}, "traces": {}, "paths": {}}


class Outline(page_rules.Outline):
    """A page as tests ask it; refuses tags that are not closed."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        assert not self.faults

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.every).split())

    def of(self, tag: str) -> list[dict]:
        return [attributes for name, attributes in self.tags if name == tag]


TIED = (
    {
        "equation": "ydot",
        "slugs": ("cubic-stiffness", "quintic-stiffness"),
        "advice": "To tell them apart, measure up to |y| = 3 m.",
    },
)


@pytest.fixture(scope="module")
def html(study, tmp_path_factory) -> str:
    path = tmp_path_factory.mktemp("page") / "gap.html"
    study_html(replace(study, ties=list(TIED)), path, config='[data]\npath = "run.csv"\n')
    return path.read_text(encoding="utf-8")


def outline(study, **changes) -> Outline:
    return Outline(render(study_page(replace(study, **changes))))


def test_the_verdict_comes_first_then_the_numbers_then_the_evidence(study, html):
    page = Outline(html)
    order = [
        "Named",
        " ".join(study.sentence.split()),
        "What to do now",
        "Does the simulation now follow",
        "The gap before and after, on held-out data",
        "Where simulation and measurement",
        "What could be missing",
        "What speaks against it",
    ]
    places = [page.text.index(words) for words in order]
    assert places == sorted(places)
    anchors = [attributes["id"] for attributes in page.of("section")]
    assert anchors == [
        "to-do", "free-run", "numbers", "where", "what", "against", "measurement", "corrections", "how-much", "gap",
        "convergence", "settings",
    ]  # fmt: skip
    assert [a["href"] for a in page.of("a")] == [f"#{anchor}" for anchor in anchors[3:]]
    folded = [attributes["id"] for attributes in page.of("section") if attributes.get("class") == "folded"]
    assert folded == ["measurement", "corrections", "how-much", "gap", "convergence"]


def test_the_page_keeps_to_the_rules_for_pages(html):
    assert page_rules.broken(html) == []


def test_no_script_runs_but_the_one_that_reads_values_off_the_figures(html):
    (script,) = re.findall(r"<script>(.*?)</script>", html, re.DOTALL)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    assert f"default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'sha256-{digest}'" in html
    assert not re.search(r"fetch|XMLHttp|import|eval|innerHTML", script)


def test_figures_have_texts_for_those_who_cannot_see_them(html):
    page = Outline(html)
    # Figures along time are drawn once more for a phone.
    assert len(page.of("figure")) == 7 and len(page.of("svg")) == 10
    assert all(len(image["aria-label"]) > 20 for image in page.of("svg"))
    assert page.of("html")[0]["lang"] == "en"


def test_every_rung_of_the_ladder_shows_its_numbers(study, html):
    text = Outline(html).text
    share, error = (study.gap.loc[("test", metric, "ydot")] for metric in ("unexplained share", "derivative NMSE"))
    added, second = shown_effects(study).iloc[0], study.effects.iloc[1]
    right = as_simulation(studied_system(study))
    assert right.startswith('y = "ydot"\nydot = "F - y - 0.1*ydot - 0.8') and right.endswith('*y**3"')
    for words in (
        percent_text(share["before"]), share_text(error["after"]), f"{percent_text(share['closed'])} of the gap closed",
        study.where.loc[0, "description"], percent_text(study.where.loc[0, "gap_share"]), "×",
        added["name"], second["name"], probability_text(added["probability"]), "< 0.001",
        "recalibration of the simulation", estimate(added["mean"], added["sd"], added["unit"]),
        interval(added["lower"], added["upper"]), right, "Every convergence check passed.",
        probability_text(study.corrections.loc[("ydot", "y"), "probability"]), "To tell them apart, measure up to |y|",
        "prior odds / no_gap", "versions / jax", 'path = "run.csv"', "seed",
        *(name_of(study, slug) for _, slug in study.left_out),
    ):  # fmt: skip
        assert " ".join(words.split()) in text, words


def test_the_same_study_makes_the_same_file(study, html, tmp_path):
    study_html(replace(study, ties=list(TIED)), tmp_path / "again.html", config='[data]\npath = "run.csv"\n')
    assert (tmp_path / "again.html").read_text(encoding="utf-8") == html


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_has_its_own_badge(study, verdict):
    page = outline(study, verdict=verdict, **PLAIN)
    said = " ".join(sentence(replace(study, verdict=verdict)).split())
    assert BADGES[verdict].text in page.text.split(said)[0]
    assert list(BADGES) == list(VERDICTS)
    assert len({(badge.text, badge.symbol) for badge in BADGES.values()}) == len(VERDICTS)


def test_a_fit_that_did_not_converge_says_so_before_anything_else(study):
    page = outline(study, fit=judged(study.fit, False), **PLAIN)
    before = page.text.split("The gap before and after")[0]
    assert "sampler did not converge" in before and "do not rely on these numbers" in before and "R̂ is" in before
    assert "12 divergences" in page.text.split("Can the sampler be trusted?")[2]
    assert "did not converge" not in outline(study, **PLAIN).text


def test_a_tail_that_is_a_little_short_is_said_without_an_alarm(study):
    short = replace(study, fit=judged(study.fit, False, short=True))
    page, text = outline(short, **PLAIN), printed(short)
    for words in (page.text, " ".join(text.split())):
        assert "do not rely" not in words and "did not converge" not in words and "Not converged" not in words
        assert "The tail effective sample size is 398" in words and "Converged, but more draws would" in words
    assert study_record(short, {})["convergence"]["short"] and exit_code({"study": short.fit}) == 0


def test_a_study_that_was_not_sampled_says_so_and_draws_intervals_only(study):
    page = outline(study, fit=None, **PLAIN)
    assert "no sampler was run" in page.text and "Laplace approximation" in page.text


def test_without_held_out_data_the_numbers_are_said_to_be_of_the_training_data(study):
    page = outline(study, test=None, gap=study.gap.loc[["train"]], **PLAIN)
    assert "on the training data (none were held out)" in page.text
    assert "held-out data: none" in page.text
    assert "on the held-out data" not in page.text.lower()


def test_what_a_study_lacks_is_left_out_without_a_gap(study):
    nothing = {
        "effects": study.effects.iloc[:0],
        "hypotheses": study.hypotheses.iloc[:0],
        "corrections": study.corrections.iloc[:0],
        "where": study.where.iloc[:0],
        "rounds": study.rounds.iloc[:0],
        "instrument": study.instrument.iloc[:0],
        "checks": study.checks.iloc[:0],
        "ties": [],
        "paths": {},
        "left_out": {},
        "amendments": {},
    }
    page = outline(study, verdict="no gap", **nothing)
    anchors = [attributes["id"] for attributes in page.of("section")]
    assert anchors == [
        "to-do", "numbers", "where", "what", "against", "measurement", "gap", "convergence", "settings",
    ]  # fmt: skip
    assert "found unlikely: each has a probability below 1.0 %" in page.text
    assert "No region and no stretch" in page.text
    assert "[simulation]" not in page.text
    assert "nan" not in page.text.lower().split()


def test_an_effect_of_the_other_sign_says_what_it_then_does(study):
    turned = study.effects.assign(reverse=np.where(study.effects["status"] == "added", "softens: pushes away", ""))
    page, text = outline(study, effects=turned, **PLAIN), printed(replace(study, effects=turned))
    said = "sign reversed: “softens: pushes away”"
    assert said in page.text.split("The gap before and after")[0] and f"Cubic stiffness ({said})" in page.text
    assert said in " ".join(text.split()) and "…" not in text
    assert re.search(r"\+  Cubic stiffness,(?: |[^\n]*\n +)sign reversed", text)
    # A hardening spring has the usual sign.
    assert "sign reversed" not in outline(study, **PLAIN).text


def test_a_correction_whose_sign_is_not_told_is_no_sure_one(study):
    table = study.corrections.copy()
    table[["probability", "mean", "sd", "lower", "upper"]] = 0.9999, 0.15, 0.03, 0.1, 0.2
    sure = "Coefficients that are more likely off than not"
    unclear = "Coefficients that are corrected by what cannot be told from zero"
    page = outline(study, corrections=table, **PLAIN)
    assert sure in page.text and unclear not in page.text
    for change in ({"lower": -0.1}, {"sd": 0.2}):
        page = outline(study, corrections=table.assign(**change), **PLAIN)
        assert sure not in page.text and unclear in page.text and "None of them" not in page.text


def test_a_gap_that_grew_is_not_called_closed(study):
    table = study.gap.copy()
    table["after"], table["closed"] = 2 * table["before"], -1.0
    page = outline(study, gap=table, **PLAIN)
    assert "the gap grew to 2 times what it was" in page.text and "of the gap closed" not in page.text
    assert all(
        float(width) <= 100 for width in re.findall(r'style="width: ([\d.]+)%"', render_of(study, gap=table, **PLAIN))
    )
    assert closed_text(float("nan")) == "" and closed_text(0.001) == "unchanged"
    assert closed_text(-0.3) == "the gap grew by 30.0\u00a0%"


def test_what_grew_many_times_is_said_as_a_multiple_on_page_and_terminal(study):
    table = study.gap.copy()
    runs = table.index.get_level_values("metric") == "free-run NRMSE"
    table.loc[runs, "after"], table.loc[runs, "closed"] = 23202.76 * table.loc[runs, "before"], -23201.76
    page = outline(study, gap=table, **PLAIN)
    assert "the gap grew to 23000 times what it was" in page.text
    text = printed(replace(study, gap=table))
    # The numbers stand beside it: a column has no shares of it and multiples.
    assert re.search(r"free-run NRMSE +y +47.9 % +1.11·10⁶ % +grew\n", text) and "…" not in text
    assert not re.search(r"\d{6} %", page.text + text)


def render_of(study, **changes) -> str:
    return render(study_page(replace(study, **changes)))


def test_the_equation_is_named_only_where_there_are_several(study):
    def heads(page: Outline) -> bool:
        return "equation" in [text for tag, text in page.texts if tag == "th"]

    assert not heads(outline(study))
    again = study.hypotheses.rename({"ydot": "y"}, level="equation")
    second = {
        "maps": {**study.maps, "y": replace(study.maps["ydot"], equation="y")},
        "traces": {**study.traces, "y": replace(study.traces["ydot"], equation="y")},
        "hypotheses": pd.concat([study.hypotheses, again]),
    }
    page = outline(study, **second)
    assert heads(page) and "d(y)/dt" in page.text
    assert {"gap_map_ydot", "gap_map_y", "ranking_y"} <= set(study_figures(replace(study, **second)))


def test_a_gap_over_one_variable_is_one_picture_of_curves(study):
    whole = study.maps["ydot"]
    cut = {"variables": whole.variables[:1], "axes": whole.axes[:1], "units": whole.units[:1]}
    cut |= {name: getattr(whole, name)[:, 0] for name in ("before", "after", "probability", "after_probability")}
    curves = replace(whole, **cut, samples=np.asarray(whole.samples)[:, :1])
    page = outline(study, maps={"ydot": curves}, traces={}, paths={})
    alts = [image["aria-label"] for image in page.of("svg")]
    assert sum("over y" in alt for alt in alts) == 1


def test_names_are_text_and_never_markup(study):
    table = study.effects.copy()
    table.loc[0, "name"] = "<script>alert(1)</script> & $x$"
    text = render_of(study, effects=table, **PLAIN)
    assert "<script>alert" not in text and "&lt;script&gt;" in text
    assert "<h1>The simulation lacks &lt;script&gt;alert(1)&lt;/script&gt; &amp; $x$ in d(ydot)/dt" in text


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


def test_a_callable_simulation_is_not_printed(study):
    callable_base = replace(study.base, simulation=lambda t, x, u: x)
    assert as_simulation(studied_system(replace(study, base=callable_base))) == ""
    assert "how-much" in render_of(study, base=callable_base, **PLAIN)


def test_terms_that_are_sums_are_put_in_brackets(study):
    system = studied_system(study)
    (cubic,) = system.learned["ydot"].terms
    shifted = replace(cubic, term=Term("y - 0.2"), value=Value(1.5, 0.1, 1.3, 1.7))
    system = replace(system, learned={"ydot": replace(system.learned["ydot"], terms=(shifted,))})
    assert as_simulation(system).endswith('ydot = "F - y - 0.1*ydot + 1.5*(y - 0.2)"')
    assert "+ 1.50(10) [1/(m²·s²)] (y − 0.2)" in equations_text(system)
    assert r"\left(y - 0.2\right)" in equations_latex(system)
    assert "<mo>(</mo>" in equation_mathml(system, "ydot")[-1]


def test_the_extended_equation_is_at_the_top_in_letters_that_break_between_summands(study, html):
    head = Outline(html.split("<main>")[0] + "</div></body></html>")
    (equation,) = [a for _, a in head.tags if a.get("class") == "equation"]
    text = equation_text(studied_system(study), "ydot")
    assert equation["aria-label"] == text and text.startswith("d(ydot)/dt = F − y − 0.1·ydot − 0.8")
    # The left-hand side, three of the simulation, one that was found; each is a formula of its own.
    assert len(head.of("math")) == 5 and len(head.of("mfrac")) == 1 and len(head.of("msup")) == 1
    assert r"\frac{\mathrm{d} \dot{y}}{\mathrm{d} t} &= F - y" in head.text
    assert head.text.count("1.23(4) is 1.23 ± 0.04") == 1


def test_the_figures_of_a_study_are_named_after_what_they_show(study):
    figures = study_figures(study)
    assert set(figures) == {
        "gap_map", "gap_time", "ranking", "rounds", "added_coefficients", "free_run_y", "free_run_ydot",
    }  # fmt: skip


def printed(study) -> str:
    """What a terminal of 80 columns shows."""
    from rich.console import Console

    console = Console(width=80, record=True, file=io.StringIO())
    for part in study_tables(study):
        console.print(part)
    return console.export_text().replace("\u00a0", " ")


def test_the_terminal_has_the_sentence_first_and_fits_80_columns(study):
    text = printed(replace(study, fit=judged(study.fit, False)))
    assert text.startswith("NAMED: The simulation lacks cubic stiffness")
    assert text.index("What to do now") < text.index("What speaks against it") < text.index("Where the gap is")
    assert "✗  Sampler" in text and "What was checked" in printed(study) and text.count("1.23(4) is 1.23") == 1
    closed = percent_text(study.gap.loc[("test", "free-run NRMSE", "y"), "closed"]).replace("\u00a0", " ")
    assert "Not converged" in text and "+  Cubic stiffness" in text and closed in text and "train" not in text
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
        (nats(-432.0, 2), "−432.00"),
        (pareto(float("-inf")), "–"),
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
        (formula("y**1.5"), "y^1.5"),
        (formula("x*y**2/(1.5**2 + y**2)"), "x·y²/(1.5² + y²)"),
        (formula("y**(-1)*v**(1/2)"), "y⁻¹·v^(1/2)"),
        (number(9.996e-4), "0.001"),
        (number(123456.7), "1.23·10⁵"),
        (number(1234.4), "1234"),
        (estimate(1.3e-4, 5.9e-4, "1/s**2"), "(1.3 ± 5.9)·10⁻⁴ 1/s²"),
        (interval(-1.0026, -0.999), "−1.0026 to −0.9990"),
        (interval(0.0, 9.75e-4), "(0 to 9.75)·10⁻⁴"),
        (interval(-1e-9, 1.2), "0 to 1.2"),
        (share_text(0.0), "<\u00a00.01\u00a0%"),
        (share_text(-1e-9), "<\u00a00.01\u00a0%"),
        (share_text(-0.003), "−0.30\u00a0%"),
        (share_interval(0.0, 1e-6), "<\u00a00.01\u00a0%"),
        (share_interval(0.0, 0.002), "0 to 0.20\u00a0%"),
        (share_interval(0.1, 0.2), "10.0 to 20.0\u00a0%"),
        (share_text(23201.76), "2.32·10⁶\u00a0%"),
        (closed_share(-0.3), "grew"),
        (closed_share(0.0), "unchanged"),
        (closed_share(1.0), ">\u00a099.9\u00a0%"),
    ],
)
def test_numbers_and_formulas_read_well(shown, expected):
    assert shown == expected


def test_a_run_that_never_fails_is_said_to(study):
    assert metric_interval(study, "time to failure", 15.0, float("nan")) == "15 s to never"
    assert metric_interval(study, "time to failure", float("nan"), float("nan")) == "never"
    assert metric_value(study, "time to failure", float("nan")) == "never"
    assert metric_interval(study, "free-run NRMSE", float("nan"), float("nan")) == "–"


def test_columns_of_numbers_and_formulas_are_told_apart():
    assert Table(("term", "#mean", "`form"), []).heads == [("term", "text"), ("mean", "number"), ("form", "formula")]


def test_free_runs_are_of_the_held_out_data(study):
    assert "on the held-out data" in outline(study).text


def test_small_numbers_keep_their_digits_in_the_record(study):
    tiny = replace(study, effects=study.effects.assign(mean=1.23456789e-13, sd=float("nan")))
    (row, *_) = study_record(tiny, {})["effects"]
    assert row["mean"] == 1.23456789e-13 and row["sd"] is None


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("y < -0.434 m and v > -0.243 m/s", "y < −0.434 m and v > −0.243 m/s"),
        ("|y_1| > 1e-05 1/s²", "|y_1| > 1·10⁻⁵ 1/s²"),
        ("t = 3.01 to 4.548 s", "t = 3.01 to 4.548 s"),
        ("-3.5 < x2 < 2", "−3.5 < x2 < 2"),
        ("everywhere", "everywhere"),
    ],
)
def test_numbers_in_a_region_are_written_as_elsewhere(text, shown):
    assert numbers_in(text) == shown


def test_what_is_folded_or_scrolled_is_printed():
    style = render(Page("", "", "", sections=[Section("one", "One", "", [Table(("a",), [("b",)], "c")])]))
    printed = style.split("@media print {")[1].split("</style>")[0]
    assert "details::details-content { content-visibility: visible" in printed
    assert ".scroll, .equation, pre { overflow: visible; }" in printed and "white-space: pre-wrap" in printed
    assert "@page { margin: 14mm 12mm; }" in printed
    # What is longer than a sheet cannot stay together.
    assert "section" not in printed


def test_the_probability_of_a_set_is_not_that_of_an_effect(study):
    table = study.hypotheses.copy()
    table.loc[("ydot", "cubic-stiffness"), "probability"] = 0.123
    page = outline(study, hypotheses=table, **PLAIN)
    every = page.text.split("Every hypothesis, best first")[1]
    assert "P by itself" in every and "0.123" in every and "0.123" not in page.text.split("What could be missing")[0]
    assert ranking(study, "ydot").axes[0].get_xlabel() == "probability of each by itself"


def test_a_coefficient_has_one_estimate_on_a_page(study):
    details = outline(study, **PLAIN).text.split("Every quantity with R̂ and effective sample sizes")[1]
    assert "How well each quantity was sampled" in details and "sd lower upper" not in details
    assert "y³ 1.00" in details


def test_an_effect_has_the_coefficient_that_the_equation_has(study):
    averaged = replace(study, effects=study.effects.assign(mean=9.99, lower=9.5, upper=10.5))
    shown = shown_effects(averaged)
    term = studied_system(study).learned["ydot"].terms[-1].value
    assert tuple(shown.loc[0, ["mean", "sd", "lower", "upper"]]) == (term.mean, term.sd, term.lower, term.upper)
    # Others have the coefficients that each would have alone.
    assert shown.loc[1, "mean"] == 9.99 and averaged.effects.loc[0, "mean"] == 9.99
    text, page = printed(averaged), outline(averaged, **PLAIN).text
    assert estimate(term.mean, term.sd) in text and interval(term.lower, term.upper) in page


def test_the_head_of_a_page_has_name_and_date(study):
    settings = {**study.settings, "name": "trolley", "date": "2026-11-28"}
    page = render_of(study, settings=settings, **PLAIN)
    assert "<title>trolley: missing-effect study: named</title>" in page
    assert "bayes_greybox · missing-effect study · trolley · 2026-11-28" in page
    assert "date" in study.settings and "<title>missing-effect study: named</title>" in render_of(study, **PLAIN)


def test_nothing_is_closed_where_nothing_was_added(study):
    page = outline(study, verdict="no gap", effects=study.effects.assign(status=""), **PLAIN)
    assert "of the gap closed" not in page.text and "lower by" in page.text


def test_f_of_any_shape_closes_nothing(study):
    unnamed = {"verdict": "unknown", "effects": study.effects.assign(status=""), "ties": []}
    page = outline(study, **unnamed, **PLAIN)
    assert "of the gap closed" not in page.text and "lower by" in page.text
    assert "taken up by f" in page.text and "taken up by f" not in outline(study, **PLAIN).text


def test_errors_of_free_runs_and_their_intervals_are_explained(study):
    assert "may thus lie below its interval" in outline(study, **PLAIN).text


def test_a_line_does_not_end_between_a_number_and_its_unit():
    assert unbroken("t = 0 to 2.475 s") == "t = 0 to 2.475\u00a0s"
    assert unbroken("y < −0.4 m and v > 2 m/s") == "y < −0.4\u00a0m and v > 2\u00a0m/s"
    assert unbroken("0.1 < y < 2") == "0.1 < y < 2"

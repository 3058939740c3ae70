import re
from html import escape

import numpy as np
import page_rules
import pandas as pd
import pytest
from fabricated import fabricate, oscillator

import bayes_greybox as bg
from bayes_greybox import cli
from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.greybox import Fit
from bayes_greybox.report.folders import saved
from bayes_greybox.report.folders.saved import load_comparison, save_comparison
from bayes_greybox.report.pages.comparison_page import comparison_page
from bayes_greybox.report.pages.page import render
from bayes_greybox.report.words.formatting import probability_text

NAMES = ("spike & slab", "laplace")


@pytest.fixture(scope="module")
def fits():
    """Two fits with draws made up: forty each, far too few to have converged."""
    data, shape = oscillator(60), (2, 20)
    spike = bg.GreyBox({"v": ["y", "v", "y**3"]}, noise_floor=0.01)
    laplace = bg.GreyBox({"v": ["v", "y**3"]}, prior=bg.Laplace(), noise_floor=0.01)
    gamma = np.broadcast_to([0, 1, 1], (*shape, 3))
    nil = {"weight": np.zeros((*shape, laplace.assemble(data)["v"].frame.basis.size))}
    made = (
        fabricate(
            spike, data, draws=20, seed=1, gamma=gamma, inclusion=np.broadcast_to([0.1, 0.9, 1.0], (*shape, 3)), **nil
        ),
        fabricate(laplace, data, draws=20, seed=2, **nil),
    )
    return {name: Fit(one.model, one.data, one.sampling, one.idata) for name, one in zip(NAMES, made, strict=True)}


@pytest.fixture(scope="module")
def table(fits):
    return bg.compare(fits, "block", block=6, max_refits=0, progress=False)


@pytest.fixture(scope="module")
def html(fits, table) -> str:
    return render(comparison_page(fits, table, "[models]"))


@pytest.fixture
def folder(fits, table, tmp_path):
    """A folder that holds one of two fits."""
    files = dict(zip(NAMES, (tmp_path / "out" / "a.nc", tmp_path / "b.nc"), strict=True))
    (tmp_path / "out").mkdir()
    for name, file in files.items():
        fits[name].save(file)
    save_comparison(tmp_path / "out", fits, table, files, config=("case.toml", "[models]"), figures=False)
    return tmp_path / "out"


def cells(html: str, section: str) -> list[list[str]]:
    """Rows of the first table of a section."""
    return tables(html, section)[0]


def tables(html: str, section: str) -> list[list[list[str]]]:
    """Rows of each table of a section, headings of rows first."""
    part = html.split(f'<section id="{section}"')[1].split("</section>")[0]
    bodies = re.findall(r"<tbody>(.*?)</tbody>", part, re.DOTALL)
    rows = [re.findall(r"<tr.*?</tr>", body) for body in bodies]
    return [[re.findall(r"<t[dh][^>]*>(.*?)</t[dh]>", row) for row in body] for body in rows]


def made_up(differences, errors, worst_k=(0.2, 0.2, 0.2)) -> pd.DataFrame:
    n = len(differences)
    columns = {"elpd": 100 + np.array(differences), "se": np.ones(n), "elpd_diff": differences, "diff_se": errors}
    rest = {"p_eff": np.ones(n), "weight": np.ones(n) / n, "worst_k": worst_k[:n], "refits": np.zeros(n, int)}
    index = pd.Index(["a", "b", "c"][:n], name="model")
    table = pd.DataFrame({**columns, **rest}, index=index)
    table.attrs |= {"notes": [], "folds": "single rows", "threshold": 0.7, "scheme": "loo", "block": None}
    return table


def test_the_page_has_every_part_and_fetches_nothing(html):
    anchors = re.findall(r'<section id="([\w-]+)"', html)
    assert anchors == ["ranking", "terms", "coefficients", "convergence", "settings"]
    assert page_rules.broken(html) == []
    assert "spike &amp; slab" in html and "spike & slab" not in html


def test_the_numbers_are_those_of_the_comparison(table, html):
    rows = cells(html, "ranking")
    assert [row[0].replace("&amp;", "&") for row in rows] == list(table.index)
    for row, (_, found) in zip(rows, table.iterrows(), strict=True):
        shown = [float(cell.replace("−", "-")) for cell in row[1:]]
        columns = ["elpd", "se", "elpd_diff", "diff_se", "weight", "worst_k", "refits", "p_eff"]
        np.testing.assert_allclose(shown, found[columns].to_numpy(float), atol=0.051)
    assert "10 blocks of up to 6 rows" in html
    assert all(note.split(":")[0].replace("&", "&amp;") in html for note in table.attrs["notes"])


def test_terms_stand_side_by_side_under_their_own_probability(fits, table, html):
    columns = {"spike & slab": "inclusion", "laplace": "outside_rope"}
    found = {name: fits[name].inclusion()[column].loc["v"] for name, column in columns.items()}
    likely, absent = tables(html, "terms")
    assert [row[0] for row in absent] == ["y"]
    for term, *shown in [*likely, *absent]:
        key = term.replace("³", "**3")
        expected = [escape(probability_text(found[name][key])) if key in found[name] else "–" for name in table.index]
        assert shown == expected
    assert "spike &amp; slab: P(included)" in html and "laplace: P(|θ| &gt; ROPE)" in html
    # Three terms of one model, two of the other, with their units.
    assert [len(rows) for rows in tables(html, "coefficients")] == [4, 1] and len(likely) == 2


def test_a_bad_fit_is_said_first_and_takes_the_good_badge_away(fits, table, html):
    assert not any(fit.verdict.ok for fit in fits.values())
    head = html.split("<main>")[0]
    assert "Not converged" in head and "do not rely on this comparison" in head and "badge good" not in head
    assert [row[1] for row in cells(html, "convergence")] == ["not converged"] * 2
    assert all(reason.split(":")[0] in html for fit in fits.values() for reason in fit.verdict.reasons)


def test_what_the_models_differ_in_comes_apart_from_what_they_share(table, html):
    differ = {name: values for name, *values in cells(html, "settings")}
    kinds = {"spike & slab": "SpikeAndSlab", "laplace": "Laplace"}
    assert differ["model / prior / kind"] == [kinds[name] for name in table.index]
    assert set(differ) == {"model / dictionary / v", "model / prior / kind"}
    assert "sampling / seed" in html and "jax" in html and "[models]" in html


@pytest.mark.parametrize(
    ("differences", "errors", "headline", "badge"),
    [
        (
            [0, -50.0],
            [0, 10.0],
            "a predicts data left out of the fit best: it is 50.0 nats ahead of b, 5.0 times",
            True,
        ),
        ([0, -3.9], [0, 0.1], "Too close to call: the data do not tell a and b apart.", False),
        ([0, -50.0], [0, 26.0], "Too close to call: the data do not tell a and b apart.", False),
        ([0, -1.0, -2.0], [0, 1.0, 1.0], "do not tell a, b and c apart.", False),
        ([0, -1.0, -90.0], [0, 1.0, 1.0], "do not tell a and b apart; c predicts worse.", False),
        # The runner-up is clearly behind, the third is not, for its difference is less well known.
        ([0, -10.0, -11.0], [0, 1.0, 9.0], "do not tell a and c apart; b predicts worse.", False),
    ],
)
def test_the_headline_says_who_leads_and_how_surely(fits, monkeypatch, differences, errors, headline, badge):
    (fit, *_) = fits.values()
    monkeypatch.setitem(fit.memory, f"{convergence.__module__}.{convergence.__qualname__}", type(fit.verdict)(True))
    page = comparison_page(dict.fromkeys("abc", fit), made_up(differences, errors))
    assert headline in page.headline
    assert [(one.text, one.tone) for one in page.badges] == [
        ("Clear lead", "good") if badge else ("Too close to call", "warn")
    ]
    assert not page.alerts


def test_a_large_pareto_k_is_an_alert(fits, monkeypatch):
    (fit, *_) = fits.values()
    monkeypatch.setitem(fit.memory, f"{convergence.__module__}.{convergence.__qualname__}", type(fit.verdict)(True))
    page = comparison_page({"a": fit, "b": fit}, made_up([0, -50.0], [0, 10.0], (-np.inf, np.inf)))
    assert [one.text for one in page.badges] == ["Pareto k too large", "Clear lead"]
    assert page.badges[1].tone == "quiet" and "above 0.7 for b," in page.alerts[0]


def test_a_folder_gives_back_the_same_table_and_page(folder, table, html):
    found = load_comparison(folder)
    pd.testing.assert_frame_equal(found.table, table, check_dtype=False)
    assert {**table.attrs, "versions": found.table.attrs["versions"]} == found.table.attrs
    assert (folder / "comparison.html").read_text(encoding="utf-8") == html
    assert render(comparison_page(found.fits, found.table, found.config)) == html


def test_an_infinite_pareto_k_survives_the_folder(fits, tmp_path):
    files = {"a": tmp_path / "a.nc", "b": tmp_path / "b.nc"}
    pair = dict(zip(files, fits.values(), strict=True))
    for name, file in files.items():
        pair[name].save(file)
    table = made_up([0, -50.0], [0, 10.0], (-np.inf, np.inf))
    save_comparison(tmp_path, pair, table, files, figures=False)
    assert load_comparison(tmp_path).table["worst_k"].tolist() == [-np.inf, np.inf]


def test_a_folder_may_move_but_its_fits_must_be_there_and_the_same(fits, folder, tmp_path):
    moved = folder.rename(tmp_path / "elsewhere")
    assert set(load_comparison(moved).fits) == set(NAMES)
    outside = tmp_path / "b.nc"
    held = outside.read_bytes()
    outside.unlink()
    with pytest.raises(bg.InputError, match=r"'laplace' of this comparison was \".*b.nc\" and is no longer there"):
        load_comparison(moved)
    outside.write_bytes(held[:-1])
    with pytest.raises(bg.InputError, match=r"b.nc\" has changed since it was compared"):
        load_comparison(moved)


def test_the_command_compares_several_fits_as_it_is_told(folder, table, monkeypatch, capsys):
    asked = {}

    def compared(fits, **arguments):
        asked.update(arguments, fits=list(fits))
        return table.rename(dict(zip(NAMES, ("a", "b"), strict=True)))

    # What compare does is tested elsewhere; here it would fit again.
    monkeypatch.setattr(saved, "compare", compared)
    monkeypatch.chdir(folder)
    assert cli.main(["report", "a.nc", "../b.nc", "--scheme", "block", "--block", "6", "--no-progress"]) == 3
    assert asked == {"fits": ["a", "b"], "scheme": "block", "block": 6, "progress": False}
    assert "The report is comparison.html." in capsys.readouterr().out
    assert '<th scope="row" class="text">a</th>' in (folder / "comparison.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("text", [None, "not JSON", "[]", "{}", '{"comparison": [], "fits": {}}'])
def test_a_folder_that_compare_did_not_write_is_refused(tmp_path, text):
    if text is not None:
        (tmp_path / "summary.json").write_text(text)
    with pytest.raises(bg.InputError, match=r"is not a folder that compare wrote: its summary.json is missing or"):
        load_comparison(tmp_path)


def test_a_comparison_of_priors_writes_the_page(fits, table, html, tmp_path):
    bg.PriorComparison(fits, table, pd.DataFrame()).to_html(tmp_path / "priors.html")
    # All but the configuration file, which it has none of.
    written = (tmp_path / "priors.html").read_text(encoding="utf-8")
    assert written.split('<section id="settings"')[0] == html.split('<section id="settings"')[0]

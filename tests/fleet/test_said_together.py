"""What assets say together, and what is left of earlier runs, of records that are made up."""

import json

import pytest

from bayes_greybox.discovery.fleet.shared import fleet_of
from bayes_greybox.fleet import run
from bayes_greybox.fleet.assets import Asset
from bayes_greybox.fleet.run import study_fleet
from bayes_greybox.fleet.studies import FleetStudy, _Studies
from bayes_greybox.report.pages.fleet_page import fleet_page
from bayes_greybox.report.pages.page import render
from bayes_greybox.report.terminal.study import fleet_tables
from bayes_greybox.report.words.fleet import fleet_sentence
from bayes_greybox.running.errors import InputError


def record(verdict, effects=(), before=0.5):
    gap = [{"data": "train", "metric": "unexplained share", "before": before, "after": 0.1}]
    return {"verdict": verdict, "sentence": "…", "effects": list(effects), "gap": gap, "convergence": None}


def lacks(slug, mean=1.0, expression="y", status="added", probability=0.97, tied_with=(), unit="1/s²", **inner):
    return {
        "equation": "v", "slug": slug, "name": slug.title(), "expression": expression, "unit": unit, "mean": mean,
        "sd": 0.1, "inner": inner, "status": status, "probability": probability, "tied_with": list(tied_with),
    }  # fmt: skip


def test_causes_that_differ_are_said_to():
    fleet = fleet_of({"a": record("named", [lacks("drag")]), "b": record("named", [lacks("lag", 2.0)])}, {})
    assert fleet.causes == () and "differs" in fleet_sentence(fleet)
    assert all(shared.whole is None for shared in fleet.shared)
    assert "Several causes" in render(fleet_page(fleet, {}))


def test_one_name_at_two_places_is_no_one_cause():
    """Springs of two masses are two effects, whatever they are called; nor are two of one asset an asset more."""
    fleet = fleet_of({
        "a": record("named", [lacks("cubic", expression="y**3"), lacks("cubic", expression="z**3")]),
        "b": record("named", [lacks("cubic", expression="z**3")]),
    }, {})  # fmt: skip
    assert [shared.assets for shared in fleet.shared] == [("a", "b"), ("a",)]
    (cause,) = fleet.causes
    assert cause.expression == "z**3" and "2 of 2 assets lack cubic" in fleet_sentence(fleet)


def test_what_all_lack_is_named_whole():
    each = record("named", [lacks("drag"), lacks("lag", 2.0)])
    fleet = fleet_of({"a": each, "b": each}, {})
    assert len(fleet.causes) == 2
    assert "2 of 2 assets lack drag in the equation of v and 2 lack lag in the equation of v" in fleet_sentence(fleet)
    assert "Causes in common" in render(fleet_page(fleet, {}))


def test_what_an_asset_cannot_tell_speaks_for_the_cause_of_the_others():
    tied = record("one of", [lacks("lag"), lacks("drag", status="one of")])
    fleet = fleet_of({"a": record("named", [lacks("drag")]), "b": record("named", [lacks("drag")]), "c": tied}, {})
    (cause,) = fleet.causes
    assert cause.slug == "drag" and cause.possible == ("c",) and "(1 more may)" in fleet_sentence(fleet)


def test_names_of_the_same_curve_speak_for_each_other():
    one = record("one of", [lacks("drag", probability=0.6, tied_with=["lag"]), lacks("lag", status="one of")])
    other = record("one of", [lacks("lag", probability=0.6, tied_with=["drag"]), lacks("drag", status="one of")])
    fleet = fleet_of({"a": one, "b": other}, {})
    assert {(shared.assets, shared.possible) for shared in fleet.shared} == {((), ("a", "b"))}
    assert "differs" not in fleet_sentence(fleet)


def test_coefficients_beside_other_inner_parameters_are_not_pooled():
    near = {k: record("named", [lacks("dead-zone", k, "dz(y, 0.4)", gap=0.4 + k / 100)]) for k in (1, 2)}
    (shared,) = fleet_of({str(k): each for k, each in near.items()}, {}).shared
    assert shared.whole is not None and shared.inner["gap"] == pytest.approx((0.41, 0.42))
    far = {str(k): record("named", [lacks("dead-zone", k, f"dz(y, {k})", gap=float(k))]) for k in (1, 2)}
    (shared,) = fleet_of(far, {}).shared
    assert shared.whole is None and shared.assets == ("1", "2")
    page = render(fleet_page(fleet_of(far, {}), {}))
    assert "gap 1 to 2" in page and "are not pooled, as the nonlinear parameter gap differs." in page


def test_fleets_of_nothing_or_of_one_have_a_page_too():
    assert "Nothing is missing in any of 2 assets" in fleet_sentence(
        fleet_of({"a": record("no gap", before=None), "b": record("instrument")}, {})
    )
    none = fleet_of({}, {"a": "no such column"})
    assert "None of 1 asset could" in fleet_sentence(none) and "Nothing studied" in render(fleet_page(none, {}))
    one = fleet_of({"a": record("named", [lacks("drag")]), "b": record("no gap"), "c": record("no gap")}, {})
    assert fleet_sentence(one) == "1 of 3 assets lacks something: a lacks drag."
    assert "One asset" in render(fleet_page(one, {}))


def test_an_unknown_gap_is_no_cause():
    fleet = fleet_of({name: record("unknown") for name in "abc"}, {})
    assert fleet.lacking == 3 and fleet.causes == () and "3 of 3 assets lack something" in fleet_sentence(fleet)
    assert "No name" in render(fleet_page(fleet, {}))


def test_what_no_study_is_sure_of_is_no_cause():
    each = record("one of", [lacks("drag", probability=0.758), lacks("lag", status="one of", probability=0.2)])
    fleet = fleet_of(dict.fromkeys("abc", each), {})
    assert fleet.causes == () and {study.lacks for study in fleet.assets} == {()}
    assert fleet_sentence(fleet) == "3 of 3 assets most likely lack drag in the equation of v (probability 0.758)."
    page = render(fleet_page(fleet, {}))
    assert "No sure cause" in page and "One cause" not in page and "perhaps drag" in page and "0 to 3" in page
    one = fleet_of({"a": each, "b": record("no gap")}, {})
    assert "a most likely lacks drag (probability 0.758)" in fleet_sentence(one)
    mixed = fleet_of({"a": each, "b": each, "c": record("partly named", [lacks("drag")])}, {})
    assert fleet_sentence(mixed) == "1 of 3 assets lacks drag in the equation of v (2 more may)."


def test_what_a_sensor_may_do_too_is_said():
    each = record("one of", [lacks("drag", probability=0.31, tied_with=["delay of F", "lag"])])
    fleet = fleet_of(dict.fromkeys("ab", each), {})
    said = "may lack drag in the equation of v (probability 0.310), or else a sensor is at fault (delay of F)."
    assert said in fleet_sentence(fleet) and "delay of F" in render(fleet_page(fleet, {}))


@pytest.mark.parametrize(
    ("verdict", "effect", "sure"),
    [
        ("named", lacks("drag"), True),
        ("named", lacks("drag", probability=0.5, tied_with=["lag"]), False),
        ("named", lacks("drag", probability=0.5, tied_with=["offset of v"]), False),
        ("partly named", lacks("drag"), True),
        ("partly named", lacks("drag", probability=0.8), False),
        # Of two effects one may be tied, and the other sure.
        ("one of", lacks("drag"), True),
        ("one of", lacks("drag", probability=0.8), False),
        ("unknown", lacks("drag"), False),
    ],
)
def test_an_asset_surely_lacks_what_its_study_is_sure_of(verdict, effect, sure):
    fleet = fleet_of({"a": record(verdict, [effect]), "b": record(verdict, [effect])}, {})
    assert len(fleet.causes) == sure
    expected = (("Drag",), ()) if sure else ((), ("Drag",))
    assert {(study.lacks, study.may_lack) for study in fleet.assets} == {expected}


def test_each_of_several_causes_has_its_own_count():
    both = record("named", [lacks("drag"), lacks("lag")])
    tied = record("one of", [lacks("lag", probability=0.5), lacks("drag", status="one of", probability=0.4)])
    fleet = fleet_of({"a": both, "b": both, "c": tied, "d": tied, "e": tied}, {})
    assert fleet_sentence(fleet).startswith("2 of 5 assets lack lag in the equation of v (3 more may) and 2 lack drag")
    first = record("named", [lacks("drag")])
    fleet = fleet_of({**{str(k): both for k in range(9)}, "last": first}, {})
    assert fleet_sentence(fleet) == (
        "10 of 10 assets lack drag in the equation of v and 9 lack lag in the equation of v."
    )


def test_one_effect_is_one_whatever_its_numbers_and_units():
    values = {"a": 1.01e-4, "b": 9.9e-5, "c": 1e-4}
    studies = {
        name: record("named", [lacks("dead-zone", expression=f"max(0, abs(y) - {gap:.4g})", unit=unit, gap=gap)])
        for (name, gap), unit in zip(values.items(), ("1/s²", "s**-2", "1/s**2"), strict=True)
    }
    (shared,) = fleet_of(studies, {}).shared
    assert shared.assets == ("a", "b", "c") and shared.whole is not None
    assert shared.expression == "max(0, abs(y) - gap)" and shared.expressions[1] == "max(0, abs(y) - 9.9e-05)"


@pytest.mark.parametrize("other", ["", "1/min²"])
def test_coefficients_are_pooled_in_one_unit_only(other):
    fleet = fleet_of({"a": record("named", [lacks("drag")]), "b": record("named", [lacks("drag", unit=other)])}, {})
    (cause,) = fleet.causes
    assert cause.assets == ("a", "b") and cause.whole is None and cause.units == ("1/s²", other)
    assert f"units differ (1/s² or {other or 'not known'})" in fleet_sentence(fleet)


@pytest.mark.parametrize("sd", [0.0, None])
def test_a_coefficient_without_a_spread_is_named_where_it_stops_the_pooling(sd):
    """Beside another effect, so that the headline has no room for it."""
    each = {"a": lacks("drag"), "b": {**lacks("drag"), "sd": sd}, "c": lacks("drag")}
    said = "The coefficients of drag are not pooled, as that of b has no standard deviation above zero."
    for others in ([], [lacks("lag")]):
        fleet = fleet_of({name: record("named", [own, *others]) for name, own in each.items()}, {})
        assert said in render(fleet_page(fleet, {})) and said in [str(part) for part in fleet_tables(fleet)]
    one = fleet_of({name: record("named", [own]) for name, own in each.items()}, {})
    assert "with coefficients that are not pooled, as that of b has no standard" in fleet_sentence(one)
    known = fleet_of({name: record("named", [own]) for name, own in each.items() if name != "b"}, {})
    assert "not pooled" not in render(fleet_page(known, {})) and known.shared[0].whole is not None


@pytest.mark.parametrize(
    ("first", "other"),
    [
        (lacks("my", expression="y**3"), lacks("my", expression="y**2")),
        (lacks("my", expression="1.5*y"), lacks("my", expression="1.6*y")),
        (lacks("my", p=1.0), lacks("my", q=1.0)),
    ],
)
def test_one_slug_of_two_formulas_is_two_effects(first, other):
    fleet = fleet_of({"a": record("named", [first]), "b": record("named", [other])}, {})
    assert [shared.assets for shared in fleet.shared] == [("a",), ("b",)] and fleet.causes == ()


def test_an_asset_has_its_own_formula():
    far = {str(k): record("named", [lacks("dead-zone", k, f"dz(y, {k})", gap=float(k))]) for k in (1, 2)}
    study = FleetStudy({}, fleet_of(far, {}), _Studies({}, {}))
    assert list(study.by_asset.index) == [("v", "dead-zone", "dz(y, 1)", "1"), ("v", "dead-zone", "dz(y, 2)", "2")]
    assert list(study.coefficients.index) == [("v", "dead-zone", "dz(y, gap)")]


@pytest.mark.parametrize(
    ("verdicts", "sentence", "badge"),
    [
        (["recalibrate"] * 3, "Nothing is missing in any of 3 assets, but 3 have a wrong coefficient.", "Recalibrate"),
        (
            ["recalibrate", "instrument", "instrument"],
            "Nothing is missing in any of 3 assets, but 1 has a wrong coefficient and 2 a fault of the measurement.",
            "Coefficients and measurements",
        ),
        (
            ["instrument", "no gap"],
            "Nothing is missing in any of 2 assets, but 1 has a fault of the measurement.",
            "The measurement",
        ),
    ],
)
def test_coefficients_and_measurements_are_no_missing_effects(verdicts, sentence, badge):
    fleet = fleet_of({str(k): record(verdict) for k, verdict in enumerate(verdicts)}, {})
    page = render(fleet_page(fleet, {}))
    assert fleet_sentence(fleet) == sentence and badge in page and "No gap" not in page and "No name" not in page


def test_assets_that_lack_nothing_do_not_count_against_a_cause():
    studies = {name: record("named", [lacks("drag")]) for name in "ab"}
    fleet = fleet_of({**studies, **{name: record("recalibrate") for name in "cde"}}, {})
    assert len(fleet.causes) == 1 and fleet.lacking == 2
    assert "2 of 5 assets lack drag" in fleet_sentence(fleet)
    assert fleet_sentence(fleet).endswith(". Of the others 3 have a wrong coefficient.")


@pytest.fixture
def made_up(monkeypatch, tmp_path):
    """A function that studies an asset of a fleet again, and its folder; what comes of it is made up."""
    given = {}

    def study_into(settings, folder, progress):
        folder.mkdir(parents=True, exist_ok=True)
        if given["fails"]:
            raise InputError("The file is empty.")
        (folder / "gap.html").write_text("page", encoding="utf-8")
        text = json.dumps({"command": "discover", **record("named", [lacks("drag")])})
        (folder / "summary.json").write_text(text, encoding="utf-8")

    class Settings:
        def with_settings(self, *_, **__):
            return self

    monkeypatch.setattr(Asset, "settings", lambda _: Settings())
    monkeypatch.setattr(run, "study_into", study_into)
    monkeypatch.setattr(run, "_mark", lambda *_: given["mark"])

    def study(mark="1", fails=False):
        given.update(mark=mark, fails=fails)
        asset = Asset("a", tmp_path / "a.toml")
        return study_fleet([asset], tmp_path / "out", {}, workers=1, progress=False)

    return study, tmp_path / "out" / "assets" / "a"


def test_a_page_that_was_removed_has_no_link(made_up):
    study, own = made_up
    study()
    page = own.parents[1] / "fleet.html"
    assert "assets/a/gap.html" in page.read_text(encoding="utf-8")
    (own / "gap.html").unlink()
    study()
    assert "assets/a/gap.html" not in page.read_text(encoding="utf-8")


def test_an_asset_that_fails_does_not_say_what_an_earlier_run_found(made_up):
    study, own = made_up
    study()
    found = (own / "summary.json").read_bytes()
    assert study("2", fails=True).failed
    assert not (own / "summary.json").exists() and not (own / "gap.html").exists()
    # With what was studied before its study need not be done again.
    assert study(fails=True).assets[0].verdict == "named" and (own / "summary.json").read_bytes() == found
    assert sorted(file.name for file in own.iterdir()) == ["asset.json", "gap.html", "summary.json"]


def test_saving_removes_studies_of_assets_that_are_no_more_and_nothing_else(tmp_path):
    old, mine = tmp_path / "assets" / "old", tmp_path / "assets" / "mine"
    for folder in (old / "figures", mine, tmp_path / "assets" / "gone" / "figures"):
        folder.mkdir(parents=True)
    left = {**record("unknown"), "command": "discover", "hypotheses": [{"equation": "v"}]}
    left["gap"][0]["variable"] = "v"
    for own in (old, tmp_path / "assets" / "gone"):
        (own / "summary.json").write_text(json.dumps(left), encoding="utf-8")
        for name in ("study.nc", "gap.html", "asset.json", "figures/gap_map.png", "figures/free_run_v.png"):
            (own / name).touch()
    # A study with a configuration of its own was never this fleet's.
    single = tmp_path / "assets" / "single"
    single.mkdir()
    (single / "summary.json").write_text(json.dumps(left), encoding="utf-8")
    (single / "config.toml").write_text("[data]", encoding="utf-8")
    kept = {
        single / "summary.json",
        single / "config.toml",
        old / "notes.txt",
        old / "figures" / "gap_map_marked.png",
        mine / "summary.json",
        mine / "study.nc",
    }
    for file in kept:
        file.touch()
    # What was found of an asset that fails now may be all there is of it.
    failed = tmp_path / "assets" / "a"
    failed.mkdir()
    (failed / "summary.json").write_text(json.dumps(left), encoding="utf-8")
    (failed / "study.nc").touch()
    kept |= {failed / "earlier-summary.json", failed / "study.nc"}
    FleetStudy({"a": "none"}, fleet_of({}, {"a": "none"}), _Studies({}, {})).save(tmp_path, progress=False)
    assert {file for file in (tmp_path / "assets").rglob("*") if file.is_file()} == kept
    assert not (tmp_path / "assets" / "gone").exists()

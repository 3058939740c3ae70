"""The command next, on a saved study."""

import pytest

from bayes_greybox import cli
from bayes_greybox.missing_effects import Study


@pytest.fixture(autouse=True)
def short(monkeypatch):
    """Short experiments of which little is simulated: the command's words are asked for, and not its figures."""
    whole, little = Study.next_experiment, {"outcomes": 8, "duration": 2.0, "rows": 11}
    monkeypatch.setattr(Study, "next_experiment", lambda self, **given: whole(self, **given, **little))


def test_a_saved_study_gives_the_sentence_and_the_table(study, tmp_path, capsys):
    study.save(tmp_path / "study.nc")
    words = ["next", str(tmp_path / "study.nc"), "--signal", "hold", "--amplitude", "3"]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert out.startswith("Measure next: (F: held at ")
    assert "Expected information" in out
    # A table may be too narrow for it; the sentence is not.
    assert "times the data's range: extrapolation." in " ".join(out.split())
    assert cli.main([*words, "--quiet"]) == 0
    assert "Expected information" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"), [(["--signal", "saw"], "no signals called 'saw'"), (["--amplitude", "-1"], "amplitudes must")]
)
def test_what_there_is_not_is_refused(study, tmp_path, capsys, words, message):
    study.save(tmp_path / "study.nc")
    assert cli.main(["next", str(tmp_path / "study.nc"), *words]) != 0
    assert message in capsys.readouterr().err


def test_a_fit_is_no_study(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("bayes_greybox.cli.studying.load", lambda file: object())
    assert cli.main(["next", str(tmp_path / "run.nc")]) != 0
    assert "holds a fit and no study" in " ".join(capsys.readouterr().err.split())


def test_a_configuration_says_what_can_be_done_and_options_go_before_it(study, tmp_path, monkeypatch, capsys):
    study.train.to_frame().rename(columns={"time": "t"}).to_csv(tmp_path / "data.csv", index=False)
    table = (
        '[data]\npath = "data.csv"\ntime = "t"\nstates = ["y", "v"]\ninputs = ["F"]\nderivatives = { v = "d(v)/dt" }\n'
    )
    known = '[simulation]\ny = "v"\nv = "F - 4*y - 0.5*v"\n[dictionary]\nv = []\n'
    asked = '[next]\nsignals = ["step"]\namplitudes = [3]\nbatch = 2\n'
    (tmp_path / "my.toml").write_text(table + known + asked)
    monkeypatch.setattr("bayes_greybox.cli.studying.find_missing_effects", lambda *_, **__: study)
    assert cli.main(["next", str(tmp_path / "my.toml"), "--batch", "1", "--no-progress"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert out.startswith("Measure next: (F: step from")
    assert "chosen one after another" not in out

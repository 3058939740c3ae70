"""What to measure next for a tie, from the study to the answer and its file."""

from dataclasses import replace

import numpy as np
import pytest

from bayes_greybox.discovery.next_experiment.ranked import Candidate
from bayes_greybox.missing_effects import load
from bayes_greybox.physics.experiments.signals import SIGNALS, USUAL_SIGNALS, Hold, Sine, Step, Sweep, Usual
from bayes_greybox.running.errors import InputError


def test_explanations_are_those_of_the_table_and_a_file_keeps_them(study, tmp_path):
    (own,) = study.explanations.values()
    table = study.hypotheses["probability"].droplevel("equation")
    assert len([e for e in own if e.components]) > 1
    assert all(np.isclose(e.probability, table[e.name]) for e in own)
    assert all(np.isclose(sum(c.weight for c in e.components), 1) for e in own if e.components)
    study.save(tmp_path / "study.nc")
    (again,) = load(tmp_path / "study.nc").explanations.values()
    for one, other in zip(own, again, strict=True):
        assert (one.name, len(one.components)) == (other.name, len(other.components))
        assert all(np.array_equal(a.root, b.root) for a, b in zip(one.components, other.components, strict=True))


def test_a_large_motion_tells_more_than_rest_and_rest_alone_stops(study):
    far = Candidate({"F": Hold(0.0)}, {"y": 1.5, "v": 0.0}, 4.0, 41, {"v": 0.3}, "far")
    still = Candidate({"F": Hold(0.0)}, {"y": 0.0, "v": 0.0}, 4.0, 41, {"v": 3.0}, "still")
    found = study.next_experiment([still, far], outcomes=24)
    assert [c.name for c in found.chosen] == ["far"]
    assert list(found.table["candidate"]) == ["far", "still"]
    assert "extrapolation" in found.table["said"][0]
    assert 0.05 < found.information.bits <= found.entropy
    stopped = study.next_experiment([still], outcomes=24)
    assert not stopped.chosen
    assert stopped.sentence.startswith("No candidate would tell them apart")


def test_a_candidate_that_fails_is_not_chosen(study):
    wild = Candidate({"F": Hold(1e9)}, {"y": 0.0, "v": 0.0}, 0.4, 5, {"v": 0.3}, "wild")
    found = study.next_experiment([wild], outcomes=8)
    assert not found.chosen
    assert found.responses == ()
    assert found.table["fails"][0] > 0.5
    assert "unsafe" in found.table["said"][0]


@pytest.mark.parametrize("name", SIGNALS)
def test_usual_signals_stay_within_their_amplitude(name):
    for signal in USUAL_SIGNALS[name](Usual(2.0, 1.0, 0.1, 1.0, 10.0)):
        assert isinstance(signal, SIGNALS[name])
        value = signal.value(np.linspace(0, 10, 2001))
        assert signal.text
        assert np.max(np.abs(value - 1.0)) <= 2.0 * 1.01


def test_what_is_to_be_measured_is_said_in_its_units():
    units = {"t": "s", "F": "N", "y": "m", "v": "m/s"}
    run = Candidate({"F": Sweep(1.04, 0.44, 2.39, 20.0, 0.0025)}, {"y": 4.1, "v": -7.54}, 20.0, 41, {"v": 0.3})
    assert run.name == "F: sweep of amplitude 1.04 from 0.44 to 2.39 about 0.0025; start at y = 4.1, v = -7.54"
    assert run.named_in(units).name == (
        "F: sweep of amplitude 1.04 N from 0.44 Hz to 2.39 Hz about 0.0025 N; start at y = 4.1 m, v = -7.54 m/s"
    )
    years = replace(run, name="", inputs={"F": Step(0.0, 2.0, 5.0)}).named_in({**units, "t": "yr"})
    assert years.name.startswith("F: step from 0 N to 2 N at 5 yr; start")
    assert Sine(2.0, 0.5).in_units("N", "yr") == "sine of amplitude 2 N at 0.5 1/yr" and Sine(2.0, 0.5).text.endswith(
        "0.5"
    )
    assert replace(run, name="mine").named_in(units).name == "mine"


def test_what_cannot_be_done_is_refused(study):
    with pytest.raises(InputError, match="no signals called 'saw'"):
        study.next_experiment(signals=["saw"])
    with pytest.raises(InputError, match="without sensors"):
        Candidate({}, {"y": 0.0}, 1.0, 10, {})

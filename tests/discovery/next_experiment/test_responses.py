"""What the sensors would show under each explanation: its bands, their figure, and the command's folder."""

import numpy as np
import pandas as pd
import pytest

from bayes_greybox import cli, plots
from bayes_greybox.discovery.next_experiment.ranked import Candidate
from bayes_greybox.physics.experiments.signals import Hold
from bayes_greybox.running.errors import InputError

FAR = Candidate({"F": Hold(0.0)}, {"y": 1.5, "v": 0.0}, 4.0, 41, {"v": 0.3}, "far")


@pytest.fixture(scope="module")
def found(study):
    return study.next_experiment([FAR])


def test_bands_are_those_of_each_explanations_coefficients(study, found):
    (shown,) = found.responses
    (own,) = study.explanations.values()
    known = [e for e in own if e.components]
    assert shown.names == tuple(e.name for e in known)
    assert sum(shown.probability) == pytest.approx(1)
    assert (shown.labels["v"], shown.candidate) == ("d(v)/dt", FAR)
    for e, (low, middle, high) in zip(known, shown.bands["v"], strict=True):
        assert np.all((low <= middle) & (middle <= high))
        # At the start the state is known: the rate is the simulation's and that of the terms.
        c = max(e.components, key=lambda each: each.weight)
        value = np.array([float(term.evaluate({"y": 1.5, "v": 0.0, "F": 0.0})) for term in c.terms])
        assert low[0] - 1e-9 <= -6.0 + value @ c.mean <= high[0] + 1e-9
        # 90 % of a normal; of 64 draws the ends have a standard error of 0.26 standard deviations each.
        sd = np.linalg.norm(value @ c.root.T)
        assert high[0] - low[0] == pytest.approx(2 * 1.645 * sd, abs=4 * 0.37 * sd)


def test_a_figure_has_each_explanation_and_the_noise(found):
    (figure,) = plots.next_experiment(found).values()
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    shown = found.responses[0]
    assert names[-1] == "noise, ±1 SD"
    assert names[0] == f"{shown.names[0]} ({shown.probability[0]:.2f})"
    above, below = figure.axes
    np.testing.assert_allclose(above.lines[1].get_ydata(), shown.bands["v"][1, 1])
    apart = (shown.bands["v"][1, 1] - shown.bands["v"][0, 1]) / 0.3
    np.testing.assert_allclose(below.lines[1].get_ydata(), apart)
    with pytest.raises(InputError, match="none at 3"):
        plots.next_experiment(found, 3)


def test_less_likely_explanations_are_counted_and_not_drawn():
    bands = np.zeros((6, 3, 5)) + np.arange(6)[:, None, None]
    figure = plots.plot_responses(
        np.arange(5.0), bands, names=list("abcdef"), probability=np.full(6, 1 / 6), noise=1.0, channel="x"
    )
    assert "2 less likely ones are not drawn" in [text.get_text() for text in figure.legends[0].get_texts()]
    assert len([line for line in figure.axes[0].lines if len(line.get_xdata())]) == 4


def test_the_command_writes_the_table_and_the_figures(study, tmp_path, capsys):
    study.save(tmp_path / "study.nc")
    words = ["next", str(tmp_path / "study.nc"), "--signal", "hold", "--amplitude", "3", "-o", str(tmp_path / "out")]
    assert cli.main(words) == 0
    assert "Table and figures are in" in capsys.readouterr().out
    assert (tmp_path / "out" / "next_v.png").stat().st_size > 10_000
    assert list(pd.read_csv(tmp_path / "out" / "candidates.csv").columns)[:2] == ["candidate", "information"]

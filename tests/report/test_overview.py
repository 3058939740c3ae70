"""One figure of a whole study."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

from bayes_greybox.report.plots import overview
from bayes_greybox.running.errors import InputError


def texts(figure):
    """Everything a reader can read; drawing first makes warnings of the layout fail the test."""
    figure.canvas.draw()
    return [text for text in (found.get_text() for found in figure.findobj(plt.Text)) if text]


@pytest.mark.parametrize("wide", [True, False])
def test_it_shows_where_what_and_whether_it_helps(study, wide):
    figure = overview(study, wide=wide)
    shown = texts(figure)
    for question in ("1  Where do simulation", "2  What is missing?", "3  Does adding it help?"):
        assert any(text.startswith(question) for text in shown)
    assert {"before", "after", "measured", "the simulation as given", "the extended model"} <= set(shown)
    width, height = figure.get_size_inches()
    assert (width > height) == wide
    assert plt.get_fignums() == []


def test_maps_before_and_after_have_one_scale_and_the_bars_add_to_one_at_most(study):
    figure = overview(study)
    (left, right), (bars, *_) = figure.subfigs[0].axes[:2], figure.subfigs[1].axes
    assert left.collections[0].get_clim() == right.collections[0].get_clim()
    lengths = [patch.get_width() for patch in bars.patches if patch.get_width() < 1.0]
    assert 0 < sum(lengths) <= 1 + 1e-9


def test_the_state_is_shown_whose_free_run_was_off_most(study):
    name, path = next(iter(study.paths.items()))
    far = replace(path, before=replace(path.before, mean=path.before.mean + 100 * np.std(path.measured)))
    failed = replace(path, before=replace(path.before, mean=np.full_like(path.before.mean, np.nan)))
    for worse in (far, failed):
        figure = overview(replace(study, paths={name: path, "other": worse}))
        (ax,) = figure.subfigs[2].axes
        assert ax.get_ylabel().startswith("other")


def test_without_a_free_run_the_gap_along_time_is_drawn(study):
    shown = texts(overview(replace(study, paths={})))
    assert "3  And along time?" in shown and "the gap along the training data" in shown
    # Nothing is left to be drawn: the panels are still there.
    assert "2  What is missing?" in texts(overview(replace(study, paths={}, traces={})))


def test_where_nothing_was_added_the_gap_along_time_is_drawn(study):
    (name, gap), *_ = study.maps.items()
    same = replace(study, maps={name: replace(gap, after=gap.before, after_probability=gap.probability)})
    assert "3  And along time?" in texts(overview(same))
    # Of two equations that one is shown whose gap was closed.
    still = replace(gap, after=gap.before, after_probability=gap.probability)
    figure = overview(replace(study, maps={"still": still, name: gap}))
    assert len(figure.subfigs[0].axes) == 3


def test_an_equation_that_was_not_studied_is_refused(study):
    with pytest.raises(InputError, match="has no equation 'w'; it has ydot"):
        overview(study, "w")

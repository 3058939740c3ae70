"""Pages and figures of outputs: no rate is spoken of, as there is none."""

import re
from dataclasses import replace

import numpy as np
import pytest
from fabricated import shown
from static_map import KNOWN, drag_study, rig

import bayes_greybox as bg
from bayes_greybox.report.pages.fit_page import fit_page
from bayes_greybox.report.pages.page import render
from bayes_greybox.report.pages.study_page import study_page
from bayes_greybox.report.plots.studies import ranking, rounds

RATE = re.compile(r"d\(R\)|derivative|\brates?\b", re.IGNORECASE)


def words(page):
    """What a page says, texts of its pictures included; not what its settings are called."""
    page = replace(page, sections=[section for section in page.sections if section.anchor != "settings"])
    html = re.sub(r"<style.*?</style>|<script.*?</script>|data:image[^\"']*", "", render(page), flags=re.DOTALL)
    return html.replace("\u00a0", " ")


def test_the_page_of_a_study_speaks_of_the_output():
    text = words(study_page(drag_study()))
    assert not RATE.search(text)
    for said in (
        "equations: R<", "Unexplained part of R", "Error of the predicted R", "Mean square error over the variance of "
        "the measured R.", "Gap in R over x and v", "The gap is what the measured R has beyond the model",
        "Probabilities of the hypotheses about R", "Delay of R",
    ):  # fmt: skip
        assert said in text


def test_figures_of_a_study_are_titled_by_the_output():
    study = drag_study()
    titles = [figure.axes[0].get_title(loc="left") for figure in (ranking(study, "R"), rounds(study, "R"))]
    assert titles == ["Hypotheses about R", "Likeliest sets of each size, R"]


@pytest.fixture(scope="module")
def fit():
    model = bg.GreyBox({"R": ["v*abs(v)"]}, simulation=KNOWN, discrepancy=None)
    always = np.ones((2, 20, 1))
    return shown(model, rig(0), gamma=always, inclusion=always)


def test_the_page_of_a_fit_speaks_of_the_output(fit):
    text = words(fit_page(fit))
    assert not RATE.search(text)
    for said in ("In R, v·abs(v) matters", "Where the variance of the measured R goes", "Predicted and measured R"):
        assert said in text

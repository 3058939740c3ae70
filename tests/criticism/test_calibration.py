"""The shipped sampler is calibrated, and a broken one is not.

Every calibration is judged at the level 0.01 over all its tests together, so a right sampler fails one in a hundred
seeds; the seeds are fixed. All variants: python -m pytest -n 0 -m slow tests/criticism/test_calibration.py -s
"""

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.criticism.calibration.coverage import places
from bayes_greybox.inference.sampler import draws
from bayes_greybox.model.program import Program
from bayes_greybox.running.errors import InputError
from benchmarks.calibration import problem, variants

DEFAULT = "spike-and-slab_projected"


class TooWide(Program):
    """The likelihood takes 1.3 times the noise it says."""

    def _sample(self, design):
        hyper, scales = super()._sample(design)
        return hyper._replace(sigma=1.3 * hyper.sigma), scales


def _too_sure(monkeypatch):
    """Coefficients drawn with half their standard deviation."""
    ridge = draws.ridge
    monkeypatch.setattr(draws, "ridge", lambda *a: ridge(*a)._replace(L=2 * ridge(*a).L))


def _run(model, replicates, **options):
    return bg.calibrate(model, problem(), replicates=replicates, progress=False, seed=1, **options)


@pytest.fixture(scope="module")
def shipped():
    return _run(variants()[DEFAULT], 40, draws=100, tune=100)


@pytest.mark.slow
def test_the_shipped_defaults_are_calibrated(shipped):
    assert shipped.verdict.ok, shipped
    assert "Calibrated" in repr(shipped) and "40 replicates" in repr(shipped)
    expected = {"x_theta[x]", "x_length_scale[x]", "x_amplitude", "x_sigma", "x_tau", "x_pi", "x_log_likelihood"}
    assert expected <= set(shipped.pit) and "x_noise" not in shipped.pit
    assert list(shipped.tests["kind"].unique()) == ["rank", "inclusion", "reliability"]
    np.testing.assert_array_less(shipped.tests["p"], shipped.tests["adjusted"] + 1e-12)
    assert shipped.ranks.shape == shipped.kept.shape == shipped.pit.shape == (40, len(shipped.ess))


@pytest.mark.slow
def test_bands_of_f_hold_it_at_the_data_away_from_them_and_beyond(shipped):
    table = shipped.coverage.loc["x"]
    assert list(table.index.get_level_values("region").unique()) == ["data", "box", "beyond"]
    # Six shares: |z| < 4.5 for all of them fails once in 10,000 seeds, were they normal.
    nominal = table.index.get_level_values("level").to_numpy(float)
    assert (np.abs(table["coverage"] - nominal) < 4.5 * np.maximum(table["se"], 0.02)).all()


def test_a_likelihood_with_the_wrong_noise_is_caught():
    model = variants()[DEFAULT]
    broken = TooWide(model.dictionary, prior=model.prior, discrepancy=bg.OrthogonalGP(features=4))
    found = _run(broken, 40, draws=100, tune=100)
    assert not found.verdict.ok
    assert not found.tests.loc["x_sigma", "passed"]
    assert "the ranks of x_sigma are not uniform" in str(found.verdict)


def test_the_places_of_the_regions_are_where_they_should_be():
    data = problem()
    frame = variants()[DEFAULT].assemble(data)["x"].frame
    where = places(frame, data)
    assert np.array_equal(np.bincount(where.region), [12, 12, 12])
    assert np.all((where.row >= 0) == (where.region == 0))
    np.testing.assert_allclose(where.Psi[:12], frame.rows(data.columns)[1][where.row[:12]])


@pytest.mark.parametrize(
    ("options", "words"), [({"replicates": 5}, "replicates=5"), ({"level": 1.0}, "level=1"), ({"draws": 0}, "draws=0")]
)
def test_useless_settings_are_refused(options, words):
    with pytest.raises(InputError, match=words):
        bg.calibrate(variants()[DEFAULT], problem(), **options)


@pytest.mark.slow
def test_coefficients_drawn_too_narrowly_are_caught(monkeypatch):
    _too_sure(monkeypatch)
    found = _run(variants()[DEFAULT], 200)
    assert not found.verdict.ok
    assert not found.tests.filter(like="x_theta", axis=0)["passed"].all()


@pytest.mark.slow
@pytest.mark.parametrize("name", variants())
def test_every_prior_with_every_kernel_is_calibrated(name, capsys):
    found = _run(variants()[name], 500)
    with capsys.disabled():
        print(f"\n{name}, {found.seconds:.0f} s\n{found}\n{found.coverage}")
    assert found.verdict.ok

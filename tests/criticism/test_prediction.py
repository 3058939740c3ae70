"""Bands of predictions."""

import numpy as np

from bayes_greybox.criticism.bands import Band


def test_bands_of_draws_that_end_one_by_one():
    draws = np.random.default_rng(3).normal(size=(9, 40))
    draws[2, 10:], draws[4:, 25:], draws[:, 33:] = np.nan, np.nan, np.nan
    band = Band.surviving(draws, 0.9)
    np.testing.assert_allclose(band.lower[:33], np.nanquantile(draws[:, :33], 0.05, axis=0))
    np.testing.assert_allclose(band.mean[:33], np.nanmean(draws[:, :33], axis=0))
    assert np.isnan(band.mean[33:]).all()
    assert np.isnan(band.upper[33:]).all()

"""Rows of an equation: what they are asked for, and a kind of rows of one's own."""

from dataclasses import dataclass

import numpy as np
import pytest

from bayes_greybox.data.noise.weighted import WhiteNoise
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampling import sample_posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.priors import Normal
from bayes_greybox.model.program import Program
from bayes_greybox.model.rows.derivative_rows import DerivativeRows
from bayes_greybox.model.rows.equation_rows import EquationRows
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.running.errors import InputError


def measured(n=24):
    rng = np.random.default_rng(1)
    y, v = rng.uniform(-1, 1, (2, n))
    half = n // 2
    return Trajectories.from_arrays(
        [np.arange(half) * 0.1] * 2,
        states={"y": [y[:half], y[half:]], "v": [v[:half], v[half:]]},
        derivatives={"v": [-y[:half], -y[half:]]},
    )


def filtered(method):
    t = np.linspace(0, 3, 40)
    data = Trajectories.from_arrays([t, t], states={"y": [np.sin(3 * t), np.cos(2 * t)]})
    return data.differentiate(method=method, rates={"y": "v"})


DATA = {"measured": measured, "savgol": lambda: filtered("savgol"), "spectral": lambda: filtered("spectral")}


@pytest.fixture(params=DATA)
def rows(request) -> EquationRows:
    model = Program({"v": ["y"]}, simulation={"v": "-0.5*y"})
    return model.equation_rows(DATA[request.param](), "v")


def test_the_target_is_what_was_measured_less_what_is_simulated(rows):
    known = rows.operate(rows.columns["y"][:, None])[:, 0]
    np.testing.assert_allclose(rows.target, rows.measured + 0.5 * known, rtol=1e-12)
    assert rows.scale == pytest.approx(np.sqrt(np.mean(rows.target**2)), rel=1e-14)


def test_whitening_by_index_is_whitening(rows):
    table = np.random.default_rng(3).standard_normal((rows.n_row, 3))
    white = rows.whitened(lambda index: table[index])(np.arange(rows.n_white))
    np.testing.assert_allclose(white, rows.noise.whiten(table), rtol=1e-12)
    if rows.noise.square:
        covariance = rows.whiten(rows.whiten(rows.noise.covariance()).T)
        np.testing.assert_allclose(covariance, np.eye(rows.n_row), atol=1e-8)


def test_weighted_rows_are_those_of_the_inverse_covariance(rows):
    table = np.random.default_rng(3).standard_normal((rows.n_row, 2))
    values, precision = rows.weighted(lambda index: table[index])
    index = np.array([2, 5, 11])
    if rows.noise.square:
        inverse = np.linalg.inv(rows.noise.covariance())
        np.testing.assert_allclose(values(index), (inverse @ table)[index], rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(precision(index)[:, 0], np.diag(inverse)[index], rtol=1e-8)
        folds = np.array([[4, 5, 6], [9, 10, 11]])
        blocks = rows.precision_blocks(list(folds))(folds)
        np.testing.assert_allclose(blocks[1], inverse[9:12, 9:12], rtol=1e-7, atol=1e-10)
        np.testing.assert_allclose(rows.noise.precision_at(index), inverse[np.ix_(index, index)], rtol=1e-7, atol=1e-9)
    else:
        np.testing.assert_allclose(values(index), rows.noise.whiten(table)[index], rtol=1e-12)
        np.testing.assert_array_equal(rows.noise.precision_at(index), np.eye(3))


def test_leaving_rows_out_keeps_the_determinant_of_the_rest(rows):
    for out in (np.array([3, 4, 9]), np.arange(rows.noise.white_lengths[0] - 2, rows.noise.white_lengths[0])):
        removal = rows.without(out)
        np.testing.assert_array_equal(removal.kept, np.setdiff1d(np.arange(rows.n_white), out))
        if not rows.noise.square:
            assert removal.log_det == 0.0
            continue
        R = rows.noise.covariance()
        left = np.linalg.slogdet(R[np.ix_(removal.kept, removal.kept)])[1]
        assert rows.noise.log_det + removal.log_det == pytest.approx(left, abs=1e-7)


def test_white_rows_are_independent():
    noise = measured().row_noise("v")
    assert isinstance(noise, WhiteNoise) and noise.local and noise.square and noise.log_det == 0.0
    assert noise.restrict([(0, 5), (0, 0)]).run_lengths == (5,)
    np.testing.assert_array_equal(noise.precision_band(2), np.tile([1.0, 0.0], (24, 1)))
    np.testing.assert_array_equal(noise.covariance(), np.eye(24))


@dataclass(frozen=True)
class StaticRows(RowKind):
    """A force that is measured at each row, with no rate in it: what the smallest kind of rows looks like."""

    column: str

    def rows(self, data, equation, simulation):
        columns = {name: values for name, values in data.columns.items() if name != self.column}
        return EquationRows(
            equation=equation,
            columns=columns,
            measured=data.columns[self.column],
            simulated=np.zeros(data.n_obs),
            noise=WhiteNoise(data.run_lengths),
            time=data.time,
            run=data.run,
        )


@pytest.mark.slow
def test_a_kind_of_rows_of_ones_own_is_fitted():
    rng = np.random.default_rng(0)
    y = rng.uniform(-1, 1, 50)
    force = 3.0 * y**3 + 0.05 * rng.standard_normal(50)
    data = Trajectories.from_arrays(np.arange(50.0), states={"y": y}, inputs={"force": force})
    kind = StaticRows("force")
    assert isinstance(kind, RowKind)
    gp = OrthogonalGP(features=5, variables=("y",))
    model = Program({"y": ["y", "y**3"]}, prior=Normal(), discrepancy=gp, rows=kind)
    posterior = sample_posterior(model, data, Sampling(100, 100, 1), progress=False)
    draws = posterior.draws("y")
    theta = draws.theta @ np.diag(posterior.equations["y"].frame.coefficient_scale)
    mean, sd = theta.mean(axis=0), theta.std(axis=0)
    assert abs(mean[1] - 3.0) < 5 * max(sd[1], 0.02)


def test_a_class_in_place_of_a_kind_of_rows_is_refused():
    model = Program({"y": ["y"]})
    object.__setattr__(model, "rows", DerivativeRows)
    with pytest.raises(InputError, match="must be a kind of rows"):
        model.__post_init__()

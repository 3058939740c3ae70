"""The information of predictions, against dense matrices and closed forms."""

import numpy as np
import pytest

from bayes_greybox.discovery.next_experiment.predicted import Response, distance, information, together


def response(rng: np.random.Generator, n: int, k: int, start: int = 1) -> Response:
    return Response(*(rng.standard_normal(shape) for shape in ((n,), (k, n), (start, n))))


def dense(one: Response, other: Response) -> float:
    S = [np.eye(len(r.mean)) + r.load.T @ r.load + r.start.T @ r.start for r in (one, other)]
    middle, d = (S[0] + S[1]) / 2, one.mean - other.mean
    logs = [np.linalg.slogdet(each)[1] for each in (middle, *S)]
    return d @ np.linalg.solve(middle, d) / 8 + logs[0] / 2 - (logs[1] + logs[2]) / 4


@pytest.mark.parametrize(("n", "k"), [(7, 2), (3, 4), (5, 0)])
def test_the_distance_is_that_of_dense_normals(n, k):
    rng = np.random.default_rng(n)
    one, other = response(rng, n, k), response(rng, n, k + 1)
    assert distance(one, other) == pytest.approx(dense(one, other), rel=1e-9)


def test_two_known_laws_tell_what_the_distance_of_their_means_leaves():
    """Two hypotheses without uncertainty at 2 noise standard deviations: C = ⅛ · 4."""
    one, other = (Response(np.array([x]), np.zeros((0, 1)), np.zeros((0, 1))) for x in (0.0, 2.0))
    expected = -np.log2((1 + np.exp(-0.5)) / 2)
    assert information([[one, other]] * 2, np.array([0.5, 0.5])) == pytest.approx(expected)


def test_what_a_coefficient_can_take_up_tells_nothing():
    rng = np.random.default_rng(0)
    x, y = rng.standard_normal((2, 20))
    free = 1e4 * x[None]
    one, other = (Response(mean, free, np.zeros((0, 20))) for mean in (0 * x, 30 * x))
    assert distance(one, other) == pytest.approx(0.0, abs=1e-3)
    apart = y - x * (x @ y) / (x @ x)
    other = Response(30 * x + apart, free, np.zeros((0, 20)))
    assert distance(one, other) == pytest.approx(apart @ apart / 8, rel=1e-3)


def test_rows_that_are_not_finite_or_hardly_known_do_not_count():
    one = Response(np.array([0.0, np.nan, 0.0]), np.array([[0.1, 0.1, 1e30]]), np.zeros((0, 3)))
    other = Response(np.array([1.0, 0.0, 5.0]), np.zeros((0, 3)), np.zeros((0, 3)))
    alone = [Response(r.mean[:1], r.load[:, :1], r.start[:, :1]) for r in (one, other)]
    assert distance(one, other) == pytest.approx(dense(*alone))


def test_experiments_share_coefficients_and_not_their_starts():
    rng = np.random.default_rng(1)
    first, second = response(rng, 4, 2), response(rng, 3, 2)
    both = together([first, second])
    S = both.load.T @ both.load + both.start.T @ both.start
    np.testing.assert_allclose(S[:4, 4:], first.load.T @ second.load)
    np.testing.assert_allclose(S[:4, :4], first.load.T @ first.load + first.start.T @ first.start)

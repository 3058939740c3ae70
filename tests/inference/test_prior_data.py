"""Truths against dense algebra, and the design of a replicate against the one a fit would build."""

import jax
import numpy as np
import pytest
from numpyro.handlers import seed, substitute, trace

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampler.prior_data import draw_truths, open_equation
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.priors import Laplace, Normal, SpikeAndSlab
from bayes_greybox.model.program import Program


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, 30)
    return Trajectories.from_arrays(np.arange(30.0), states={"x": x}, derivatives={"x": rng.standard_normal(30)})


GPS = [
    OrthogonalGP(features=8),
    OrthogonalGP(features=40),
    OrthogonalGP(features=8, variant="conditioned"),
    OrthogonalGP(features=8, variant="none", kernel="matern32"),
    OrthogonalGP(path="exact"),
    None,
]


@pytest.mark.parametrize(
    "gp", GPS, ids=["projected", "more-features-than-rows", "conditioned", "none", "exact", "no-f"]
)
def test_a_replicate_has_the_likelihood_of_a_fit_to_the_same_target(data, gp):
    program = Program({"x": ["x", "x**3"]}, prior=SpikeAndSlab(), discrepancy=gp)
    equation = program.assemble(data)["x"]
    rows = open_equation(equation)
    y = data.derivatives["x"] / equation.frame.target_scale
    ours = rows.equation.design.with_target(jax.numpy.asarray(rows.compress(y[None])[0]))
    values = {"x_noise": 0.3, "x_amplitude": 0.6, "x_length_scale": np.array([0.5]), "x_pi": 0.4, "x_tau": 0.9}
    log_p = []
    for design in (equation.design, ours):
        sites = trace(seed(substitute(program.numpyro_model, data=values), 0)).get_trace({"x": design})
        log_p.append(float(sites["x_y"]["fn"].log_prob(design.y)))
    assert log_p[1] == pytest.approx(log_p[0], rel=1e-9)


@pytest.mark.parametrize("gp", GPS[:4], ids=["projected", "more-features", "conditioned", "none"])
def test_f_is_orthogonal_where_it_should_be(data, gp):
    program = Program({"x": ["x", "x**3"]}, prior=Laplace(), discrepancy=gp)
    rows = {name: open_equation(part) for name, part in program.assemble(data).items()}
    truths, _ = draw_truths(program, rows, 50, jax.random.key(0), np.random.default_rng(0))
    f = truths["x_weight"] @ rows["x"].Psi.T
    overlap = (
        np.abs(f @ rows["x"].Phi) / np.linalg.norm(f, axis=1, keepdims=True) / np.linalg.norm(rows["x"].Phi, axis=0)
    )
    assert (overlap.max() < 1e-6) == (gp.variant != "none")


def test_targets_are_the_sum_of_their_parts_and_terms_left_out_are_zero(data):
    program = Program({"x": ["x", "x**3"]}, prior=SpikeAndSlab(), discrepancy=GPS[0])
    rows = {name: open_equation(part) for name, part in program.assemble(data).items()}
    truths, targets = draw_truths(program, rows, 400, jax.random.key(1), np.random.default_rng(1))
    design = rows["x"].equation.design
    signal = truths["x_theta"] @ np.asarray(design.Phi).T + truths["x_weight"] @ np.asarray(design.Psi).T
    scaled = (targets["x"] - signal)[:, :-1] / truths["x_sigma"][:, None]
    # 400 × 10 standard normals: a mean above 4.5/√n has probability 7e-6, as has such a mean of squares.
    n = scaled.size
    assert abs(scaled.mean()) < 4.5 / np.sqrt(n)
    assert abs(np.mean(scaled**2) - 1) < 4.5 * np.sqrt(2 / n)
    assert np.all((truths["x_theta"] == 0) == (truths["x_gamma"] == 0))
    # P(γ = 1) = E π = 1/2; the two terms of a replicate share π, so Var(mean of two) = 1/8 + cov/2, cov = 1/12.
    assert abs(truths["x_gamma"].mean() - 0.5) < 4.5 * np.sqrt((1 / 8 + 1 / 24) / 400)


def test_the_exact_path_has_the_covariance_of_its_kernel(data):
    program = Program(
        {"x": ["x", "x**3"]}, prior=Normal(), discrepancy=OrthogonalGP(path="exact", length_scale_spread=1e-6)
    )
    rows = {name: open_equation(part) for name, part in program.assemble(data).items()}
    truths, _ = draw_truths(program, rows, 300, jax.random.key(2), np.random.default_rng(2))
    x = np.asarray(rows["x"].equation.frame.position(data.columns))
    residual = np.eye(30) - rows["x"].Phi @ np.linalg.pinv(rows["x"].Phi)
    K = residual @ np.exp(-0.5 * (x - x.T) ** 2) @ residual
    unit = truths["x_f"] / truths["x_amplitude"][:, None]
    values, vectors = np.linalg.eigh(K)
    score = np.mean((unit @ vectors[:, -4:]) ** 2, axis=0) / values[-4:] - 1
    assert np.max(np.abs(score)) < 4.5 * np.sqrt(2 / 300)

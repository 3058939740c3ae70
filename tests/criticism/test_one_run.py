"""Blocks, trajectories and the future from one run against integrals over the hyperparameters, fold by fold.

Against NUTS without each fold: python -m pytest -n 0 -m slow tests/criticism/test_one_run.py -s
"""

import itertools

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import betaln, logsumexp

from bayes_greybox.criticism.cross_validation import cross_validate as module
from bayes_greybox.criticism.cross_validation.cross_validate import cross_validate
from bayes_greybox.criticism.cross_validation.folds import make_folds
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampling import sample_posterior
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.kernels import KERNELS, log_spectral_density
from bayes_greybox.model.priors import SpikeAndSlab
from bayes_greybox.model.program import Program

# The length scale has next to no prior spread, so that three hyperparameters are left to integrate over.
GP = OrthogonalGP(features=6, variables=("y",), length_scale_spread=1e-3)
START = 0.65
TERMS = ["v", "v**3"]


def runs() -> Trajectories:
    """Seven runs of four rows, one after the other in time."""
    rng = np.random.default_rng(4)
    y, v = rng.uniform(-1, 1, (2, 7, 4))
    rate = 0.4 * np.sin(3 * y) - 0.3 * v + 0.15 * rng.standard_normal((7, 4))
    return Trajectories.from_arrays(
        list(np.arange(28.0).reshape(7, 4)), states={"y": list(y), "v": list(v)}, derivatives={"v": list(rate)}
    )


@pytest.fixture(scope="module")
def posterior():
    model = Program(dictionary={"v": TERMS}, prior=SpikeAndSlab(), discrepancy=GP)
    return sample_posterior(model, runs(), Sampling(3000, 300, 4, seed=0), progress=False)


def log_evidence(posterior, nodes, kept, gamma):
    """Log p(y_kept | η, γ) at log (noise, amplitude, τ) [n_node, 3], by dense algebra."""
    frame = posterior.equations["v"].frame
    Phi, Psi = (np.asarray(part)[kept] for part in frame.rows(posterior.data.columns))
    y = posterior.data.derivatives["v"][kept] / frame.target_scale
    noise, amplitude, tau = np.exp(nodes).T
    unit = log_spectral_density(KERNELS[GP.kernel], frame.basis.frequency, jnp.ones(()), jnp.full(1, GP.length_scale))
    floor = float(posterior.equations["v"].design.noise_floor)
    # y = Q z beside what no column reaches: of orthogonal rows the algebra is dense in as many as there are columns.
    Q, R = np.linalg.qr(np.hstack([Phi * gamma, Psi]))
    n, (R_phi, R_psi) = R.shape[0], np.split(R, [len(gamma)], axis=1)
    z, sigma2 = Q.T @ y, noise**2 + floor**2
    C = amplitude[:, None, None] ** 2 * ((R_psi * np.exp(np.asarray(unit))) @ R_psi.T)
    C = C + sigma2[:, None, None] * np.eye(n) + tau[:, None, None] ** 2 * (R_phi @ R_phi.T)
    L = np.linalg.cholesky(C)
    z = np.linalg.solve(L, np.broadcast_to(z[:, None], (len(L), n, 1)))[..., 0]
    log_det = 2 * np.log(np.diagonal(L, axis1=1, axis2=2)).sum(axis=1) + (len(y) - n) * np.log(sigma2)
    square = np.sum(z**2, axis=1) + (y @ y - np.sum((Q.T @ y) ** 2)) / sigma2
    return -0.5 * (log_det + square + len(y) * np.log(2 * np.pi))


def integrator(posterior):
    """Log ∫ p(y_A | η) p(η) dη of rows A, up to a constant, by a trapezoid rule in log η.

    π is integrated out, p(γ) = B(1 + |γ|, 1 + K − |γ|), and the patterns are summed.
    """
    patterns = [np.array(gamma) for gamma in itertools.product((0.0, 1.0), repeat=len(TERMS))]
    group, hyper = posterior.idata["posterior"], posterior.draws("v").hyper
    noise = np.sqrt(hyper.sigma**2 - float(posterior.equations["v"].design.noise_floor) ** 2)
    sampled = np.log(np.column_stack([noise, hyper.amplitude, group["v_tau"].to_numpy().ravel()]))
    centre, sd = sampled.mean(axis=0), sampled.std(axis=0)

    def integral(kept, shift=0.0):
        # Half of the data leave η wider, and a scale that they do not ask for falls off slowly towards log 0.
        axes = [np.arange(-9, 9), np.arange(-16, 9), np.arange(-16, 9)]
        steps = np.array(list(itertools.product(*axes))) + shift
        nodes = centre + steps * np.array([0.9 * sd[0], 0.45, 0.45])
        half_normal = nodes[:, :2] - 0.5 * np.exp(2 * nodes[:, :2])
        prior = half_normal.sum(axis=1) - 0.5 * (nodes[:, 2] / 0.5) ** 2  # τ is log-normal
        given = [
            betaln(1 + gamma.sum(), 1 + len(TERMS) - gamma.sum()) + log_evidence(posterior, nodes, kept, gamma)
            for gamma in patterns
        ]
        return logsumexp(prior + np.array(given))

    return integral


SCHEMES = pytest.mark.parametrize(("scheme", "block"), [("block", 3), ("trajectory", None), ("future", 3)])


@pytest.mark.slow
@SCHEMES
def test_one_run_equals_the_integral_over_the_hyperparameters(posterior, scheme, block):
    """p(y_F | y_A) = p(y_F, y_A)/p(y_A): the exact value of what a refit to A estimates, without its error.

    The bounds are those asked for: 0.1 nat in total. The Monte Carlo error of 12,000 draws is smaller,
    as in the test of single rows.
    """
    integral = integrator(posterior)
    folds = make_folds(posterior, scheme, block, START)
    members = folds.members["v"]
    everything = np.arange(28)
    if scheme == "future":
        known = [np.concatenate([folds.past["v"], *members[:j]]) for j in range(len(members) + 1)]
        exact = np.diff([integral(np.sort(rows)) for rows in known])
        assert integral(known[0], 0.5) == pytest.approx(integral(known[0]), abs=5e-3)
    else:
        whole = integral(everything)
        exact = np.array([whole - integral(np.setdiff1d(everything, fold)) for fold in members])
    exact -= np.array([len(fold) for fold in members]) * np.log(posterior.equations["v"].frame.target_scale)
    result = cross_validate(posterior, scheme, block=block, start=START, progress=False)
    worst = np.abs(result.pointwise - exact).max()
    print(f"{scheme}: off by {result.elpd - exact.sum():+.3f} nat in total, by {worst:.3f} in the worst fold")
    assert result.refits == 0 and result.worst_k < result.threshold
    assert abs(result.elpd - exact.sum()) < 0.1
    np.testing.assert_allclose(result.pointwise, exact, atol=0.05)
    # Averaged over p(η | y) without weights the densities would be off by p_eff.
    assert result.p_eff > 0.1


@pytest.mark.slow
@SCHEMES
def test_one_run_equals_exact_refits(posterior, scheme, block, monkeypatch, capsys):
    settings = {"block": block, "start": START, "max_refits": 100, "progress": False}
    once = cross_validate(posterior, scheme, **settings)
    monkeypatch.setattr(module, "khat_threshold", lambda n_draw: -np.inf)
    refitted = cross_validate(posterior, scheme, **settings)
    worst = np.abs(refitted.pointwise - once.pointwise).max()
    with capsys.disabled():
        print(f"\n{scheme}, {refitted.refits} refits: {once.elpd - refitted.elpd:+.3f} nat, worst fold {worst:.3f}")
    assert refitted.refitted.all() and not once.refitted.any()
    assert abs(once.elpd - refitted.elpd) < 0.1

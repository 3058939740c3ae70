"""Fits whose terms state their coefficients: posteriors under every prior against sums on a grid, and what is shown."""

import json
from functools import partial
from io import StringIO

import jax
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from fabricated import fabricate, shown
from numpyro.handlers import seed
from scipy.special import ndtr
from scipy.stats import norm

import bayes_greybox as bg
from bayes_greybox.report.folders.record import run_record
from bayes_greybox.report.terminal.fit import fit_tables

Z = 4.5
"""Standard errors allowed; a true difference of zero exceeds them once in 150,000 comparisons."""

RUN = {"draws": 500, "tune": 300, "chains": 2, "seed": 1, "progress": False}
FIXED = {"y": -0.13, "y**3": -0.8}
PRIOR, CEILING = (-0.2, 0.1), 0.0
LOW, HIGH = -0.5, 0.1
PRIORS = {
    "normal": bg.Normal(),
    "laplace": bg.Laplace(),
    "horseshoe": bg.RegularisedHorseshoe(),
    "slab": bg.SpikeAndSlab(),
    "custom": bg.CustomPrior(lambda n: numpyro.sample("sd", dist.HalfNormal(0.5).expand([n]).to_event(1))),
}


@pytest.fixture(scope="module")
def data():
    return bg.systems.oscillator().simulate(np.linspace(0, 12, 60), noise=0.2, seed=2)


def stating_model(prior, **parts):
    """One term under the model's prior between bounds, one with a signed prior of its own, and two that are fixed."""
    terms = [
        *(bg.Term(name, fixed=value) for name, value in FIXED.items()),
        bg.Term("ydot", prior=PRIOR, sign="-"),
        bg.Term("ydot**3", bounds=(LOW, HIGH)),
    ]
    return bg.GreyBox({"ydot": terms}, prior=prior, **({"discrepancy": None} | parts))


@partial(jax.jit, static_argnums=(0, 2))
def drawn_scales(prior, sigma, n_obs, keys):
    def scale(key):
        with seed(rng_seed=key):
            drawn = prior.scales(1, n_obs, sigma)
        return drawn.sd[0], jax.nn.sigmoid(drawn.log_odds[0]) if drawn.log_odds is not None else 1.0

    return jax.vmap(scale)(keys)


def prior_on_grid(prior, sigma, grid, n_obs, key, n=1000):
    """Density of the bounded coefficient on a grid, and P(in): the mean over draws of its scale, restricted each."""
    sd, inside = (np.asarray(x)[:, None] for x in drawn_scales(prior, sigma, n_obs, jax.random.split(key, n)))
    mass = np.sqrt(2 * np.pi) * sd * (ndtr(grid[-1] / sd) - ndtr(grid[0] / sd))
    return np.mean(inside / mass * np.exp(-0.5 * (grid / sd) ** 2), axis=0), float(np.mean(inside))


def summed(prior, data, batch):
    """E[θ] of both coefficients in user's units and P(γ = 1), by sums over both coefficients and σ."""
    columns = {name: data.columns[name] for name in ("y", "ydot")}
    rate = data.derivatives["ydot"] - sum(v * columns["y"] ** (3 if "3" in n else 1) for n, v in FIXED.items())
    size, n_obs = np.sqrt(np.mean(rate**2)), len(rate)
    Phi = np.column_stack([columns["ydot"], columns["ydot"] ** 3])
    scale = size / np.sqrt(np.mean(Phi**2, axis=0))
    y, X = rate / size, Phi * scale / size
    own = np.linspace(PRIOR[0] - 6 * PRIOR[1], CEILING, 80) / scale[0]
    shared = np.linspace(LOW, HIGH, 240) / scale[1]
    log_own = norm.logpdf(own, PRIOR[0] / scale[0], PRIOR[1] / scale[0])
    log_joint, out = [], []
    s = np.linspace(0.6, 1.4, 17)
    for k, each in enumerate(s):
        sigma = np.hypot(1e-4, each)
        density, inside = prior_on_grid(
            prior, sigma, shared, float(n_obs), jax.random.fold_in(jax.random.key(batch), k)
        )
        common = norm.logpdf(each) - n_obs * np.log(sigma)

        def fitted(theta, sigma=sigma, common=common):
            square = (
                y @ y
                - 2 * (X[:, 0] @ y) * own[:, None]
                - 2 * (X[:, 1] @ y) * theta
                + (X[:, 0] @ X[:, 0]) * own[:, None] ** 2
                + 2 * (X[:, 0] @ X[:, 1]) * own[:, None] * theta
                + (X[:, 1] @ X[:, 1]) * theta**2
            )
            return common + log_own[:, None] - square / (2 * sigma**2)

        log_joint.append(fitted(shared) + np.log(density))
        # The point at zero weighs as the grid's spacing would.
        out.append(fitted(np.zeros(1)) + np.log(max(1 - inside, 1e-300) / (shared[1] - shared[0])))
    log_joint, out = np.array(log_joint), np.array(out)
    top = max(log_joint.max(), out.max())
    # Trapezium in the bounded coefficient: both ends of the grid are ends of its range.
    ends = np.ones(len(shared))
    ends[[0, -1]] = 0.5
    first = np.ones((len(own), 1))
    first[-1] = 0.5
    inside, outside = np.exp(log_joint - top) * ends * first, np.exp(out - top) * first
    total = inside.sum() + outside.sum()
    mean_own = ((inside.sum(axis=(0, 2)) + outside.sum(axis=(0, 2))) @ own) / total * scale[0]
    mean_shared = (inside.sum(axis=(0, 1)) @ shared) / total * scale[1]
    return np.array([mean_own, mean_shared, inside.sum() / total])


@pytest.mark.slow
@pytest.mark.parametrize("name", PRIORS)
def test_the_posterior_is_that_of_sums_on_a_grid(name, data):
    """Four batches of scales of the prior say how exact the sums are; where no term can be out, P(γ) is one."""
    from arviz_stats.base.array import array_stats

    batches = np.array([summed(PRIORS[name], data, batch) for batch in range(4)])
    expected, error = batches.mean(axis=0), batches.std(axis=0, ddof=1) / 2
    fit = stating_model(PRIORS[name]).fit(data, **RUN)
    theta = fit.idata["posterior"]["ydot_theta"].to_numpy()
    assert np.all(theta[..., 0] <= CEILING) and np.all((theta[..., 1] >= LOW) & (theta[..., 1] <= HIGH))
    for quantity, exact, spread in zip([*np.moveaxis(theta, -1, 0), theta[..., 1] != 0], expected, error, strict=True):
        values = quantity.astype(float)
        if np.ptp(values) == 0:
            assert values.flat[0] == pytest.approx(exact, abs=1e-12)
            continue
        ess = float(np.asarray(array_stats.ess(values, chain_axis=0, draw_axis=1, method="mean")))
        assert abs(values.mean() - exact) <= Z * np.hypot(spread, values.std() / np.sqrt(ess))


@pytest.fixture(scope="module")
def fit(data):
    """Draws within the bounds; the bounded term is in at two in three."""
    model = stating_model(bg.SpikeAndSlab(), simulation={"y": "ydot", "ydot": "0.05*y"})
    rng, scale = np.random.default_rng(0), model.assemble(data)["ydot"].frame.coefficient_scale
    gamma = np.ones((2, 20, 2))
    gamma[..., ::3, 1] = 0
    theta = np.stack([rng.uniform(-0.4, CEILING, (2, 20)), rng.uniform(LOW, HIGH, (2, 20))], axis=-1)
    inclusion = np.tile([1.0, 2 / 3], (2, 20, 1))
    made = shown(model, data, theta=gamma * theta / scale, gamma=gamma, inclusion=inclusion)
    return bg.Fit(made.model, made.data, made.sampling, made.idata)


def test_what_is_fixed_is_written_exactly_and_marked_as_given(fit):
    text, latex = repr(fit), fit.to_latex()
    # Beside the simulation's own 0.05 y, not summed with it.
    assert "= 0.05·y − 0.13(given) [1/s²] y − 0.8(given) [1/(m²·s²)] y³" in text
    assert "Numbers marked (given) were not estimated." in text
    assert r"- 0.13 \,(\mathrm{given})\, \,[\mathrm{1/s^{2}}]\, y" in latex
    (equation,) = [each for each in json.loads(fit.to_json())["equations"] if each["name"] == "ydot"]
    assert [(each["name"], each["mean"], each["stated"]) for each in equation["given"]] == [
        ("y", -0.13, {"fixed": -0.13}),
        ("y**3", -0.8, {"fixed": -0.8}),
    ]
    learned = {each["name"]: each["stated"] for each in (*equation["terms"], *equation["left_out"])}
    assert learned == {
        "ydot": {"mean": -0.2, "sd": 0.1, "sign": -1},
        "ydot**3": {"lower": -0.5, "upper": 0.1},
    }
    rate = fit.to_callable()(0.0, np.array([0.7, 0.0]))[1]
    assert rate == pytest.approx(0.05 * 0.7 - 0.13 * 0.7 - 0.8 * 0.7**3, rel=1e-12)


def test_tables_say_what_was_stated(fit, tmp_path):
    table = fit.inclusion().loc["ydot"]
    assert table["stated"].to_dict() == {
        "ydot": "N(-0.2, 0.1²), ≤ 0",
        "ydot**3": "≥ -0.5, ≤ 0.1",
        "y": "= -0.13",
        "y**3": "= -0.8",
    }
    row = fit.summary().loc[("ydot", "y")]
    assert (row["mean"], row["sd"]) == (-0.13, 0.0) and np.isnan(row["r_hat"])
    from rich.console import Console

    console = Console(width=80, record=True, file=StringIO())
    for part in fit_tables(fit, None):
        console.print(part)
    lines: dict[str, list[str]] = {}
    shown = console.export_text()
    for words in map(str.split, shown.splitlines()):
        lines.setdefault(words[0] if words else "", words)
    assert lines["y"] == ["y", "given", "−0.13", "–", "1/s²"]
    # That a term with a normal prior of its own is in was not learned.
    assert lines["ydot"][1] == "given" and "given" not in lines["ydot³"]
    said = "Stated: ydot N(−0.2, 0.1²), ≤ 0; ydot³ ≥ −0.5, ≤ 0.1; y = −0.13; y³ = −0.8"
    assert said in " ".join(shown.split())
    record = run_record(fit, {}, 1.0, None)
    assert [row["stated"] for row in record["coefficients"]] == list(table["stated"])
    fit.to_html(tmp_path / "fit.html")
    page = (tmp_path / "fit.html").read_text(encoding="utf-8")
    assert "−0.13 1/s²" in page and "N(−0.2, 0.1²), ≤ 0" in page and "<mtext>(given)</mtext>" in page


def test_a_fit_without_statements_has_no_such_column(data):
    made = fabricate(bg.GreyBox({"ydot": ["y", "ydot"]}, prior=bg.Normal(), discrepancy=None), data, draws=20)
    fit = bg.Fit(made.model, made.data, made.sampling, made.idata)
    assert "stated" not in fit.inclusion() and "given" not in repr(fit)


def test_a_file_of_a_fit_has_them(fit, tmp_path):
    fit.save(tmp_path / "fit.nc")
    loaded = bg.load(tmp_path / "fit.nc")
    assert loaded.model.coefficients == fit.model.coefficients
    assert bg.GreyBox(loaded.model.dictionary).coefficients == fit.model.coefficients
    assert repr(loaded) == repr(fit)

"""Orthogonal kernels: symmetric, positive semi-definite, orthogonal under their measure."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.algebra.linalg import require_independent
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.gp.kernels import KERNELS, box_nodes, gram, orthogonal_gram, orthonormalise
from bayes_greybox.model.program import Program
from bayes_greybox.physics.experiments.systems import oscillator
from bayes_greybox.running.errors import InputError

SIX_TERMS = ["y", "ydot", "y**2", "ydot**2", "y**3", "ydot**3"]
MEASURES = ["empirical", "box", "box-monte-carlo"]


@pytest.fixture(scope="module")
def record():
    data = oscillator().simulate()
    rows = np.linspace(0, data.n_obs - 1, 400).astype(int)
    take = {name: column[rows] for name, column in data.columns.items()}
    return Trajectories.from_arrays(data.time[rows], states=take, derivatives={"ydot": data.derivatives["ydot"][rows]})


@pytest.fixture(scope="module")
def few():
    rng = np.random.default_rng(0)
    y, v = rng.uniform(-1, 1, 80), rng.uniform(-2, 3, 80)
    return Trajectories.from_arrays(
        np.arange(80.0),
        states={"y": y, "ydot": v},
        derivatives={"ydot": -(y**3) - 0.2 * v**3 + np.sin(3 * y)},
    )


def _measure_columns(data, measure, gp):
    """Nodes of the measure in the user's units, from its definition."""
    y, v = data.columns["y"], data.columns["ydot"]
    if measure == "empirical":
        return {"y": y, "ydot": v}, np.full(len(y), 1 / len(y))
    nodes, weights = box_nodes(2, monte_carlo=gp.monte_carlo if measure != "box" else None, seed=gp.seed)
    columns = {
        name: (x.max() + x.min()) / 2 + (x.max() - x.min()) / 2 * node
        for name, x, node in zip(("y", "ydot"), (y, v), nodes.T, strict=True)
    }
    return columns, weights


def _kernel_between(equation, left, right, hyper):
    """k⊥ between two sets of points on either path."""
    frame, design = equation.frame, equation.design
    if frame.basis is not None:
        log_root, U = design.weight_prior(hyper)
        root = np.exp(np.asarray(log_root))
        factors = []
        for columns in (left, right):
            rows = np.asarray(frame.rows(columns)[1]) * root
            factors.append(rows if U is None else rows - (rows @ np.asarray(U)) @ np.asarray(U).T)
        return factors[0] @ factors[1].T
    points = [
        (frame.position(columns), frame.dictionary_rows(columns) @ frame.orthonormal) for columns in (left, right)
    ]
    kernel = KERNELS[design.kernel]
    compute = jax.jit(
        lambda a, b: orthogonal_gram(design.variant, kernel, hyper.amplitude, hyper.length_scale, a, b, design.nodes)
    )
    return np.asarray(compute(*points))


@pytest.mark.parametrize("kernel", list(KERNELS))
@pytest.mark.parametrize("path", ["hsgp", "exact"])
@pytest.mark.parametrize("measure", MEASURES)
@pytest.mark.parametrize("variant", ["projected", "conditioned"])
def test_invariants(few, variant, measure, path, kernel):
    gp = OrthogonalGP(variant=variant, measure=measure, path=path, kernel=kernel, features=8, monte_carlo=300)
    equation = Program({"ydot": SIX_TERMS}, discrepancy=gp).assemble(few)["ydot"]
    hyper = Hyperparameters(jnp.asarray(0.1), jnp.asarray(0.8), jnp.asarray([1.0, 0.7]))
    K = _kernel_between(equation, few.columns, few.columns, hyper)
    eigenvalues = np.linalg.eigvalsh(K)
    assert np.abs(K - K.T).max() <= 1e-12 * np.abs(K).max()
    assert eigenvalues[0] >= -1e-10 * eigenvalues[-1]

    columns, weights = _measure_columns(few, measure, gp)
    Phi = np.stack([columns[n] ** p for p in (1, 2, 3) for n in ("y", "ydot")], axis=1)
    Phi /= np.sqrt(np.sum(weights[:, None] * Phi**2, axis=0))
    inner = (weights[:, None] * Phi).T @ _kernel_between(equation, columns, few.columns, hyper)
    # Relative to the same integral of the base kernel.
    x, at = (jnp.asarray(equation.frame.position(c)) for c in (columns, few.columns))
    base = (weights[:, None] * Phi).T @ np.asarray(gram(KERNELS[kernel], x, at, hyper.amplitude, hyper.length_scale))
    assert np.linalg.norm(inner) <= 1e-8 * np.linalg.norm(base)
    # The discrepancy is not orthogonal because there is none of it.
    assert np.trace(K) > 1e-3 * len(K) * float(hyper.amplitude) ** 2


def _filtered(method):
    """A sampled velocity whose rate is a linear filter of it: rows with correlated noise."""
    t = np.arange(60) * (2 * np.pi / 60)
    v = np.sin(t) + 0.5 * np.cos(2 * t) + 0.01 * np.random.default_rng(3).standard_normal(60)
    data = Trajectories.from_arrays(t, states={"v": v, "y": np.cos(3 * t)})
    return data.differentiate(method, **({"window": 9, "polyorder": 3} if method == "savgol" else {}))


@pytest.mark.parametrize("method", ["savgol", "spectral"])
@pytest.mark.parametrize("path", ["hsgp", "exact"])
@pytest.mark.parametrize("variant", ["projected", "conditioned"])
def test_on_correlated_rows_empirical_is_the_metric_that_the_likelihood_has(variant, path, method):
    """Φᵀ R⁻¹ k⊥ = 0: what the rows say of θ is then the weighted least squares that they say without f."""
    data = _filtered(method)
    gp = OrthogonalGP(variant=variant, path=path, features=6)
    equation = Program({"v": ["y", "v", "y**3"]}, discrepancy=gp).assemble(data)["v"]
    hyper = Hyperparameters(jnp.asarray(0.1), jnp.asarray(0.8), jnp.asarray([1.0, 0.7]))
    columns = equation.rows.columns

    def W(table):
        return equation.rows.whiten(equation.rows.operate(np.asarray(table)))

    Phi = W(equation.frame.dictionary_rows(columns))
    K = W(W(_kernel_between(equation, columns, columns, hyper)).T)
    assert np.linalg.norm(Phi.T @ K) <= 1e-8 * np.linalg.norm(Phi) * np.linalg.norm(K)
    # Generalised least squares, with f as noise or without it.
    y = equation.rows.whiten(equation.target[:, None])[:, 0]
    C = K + 0.1**2 * np.eye(len(K))
    with_f = np.linalg.solve(Phi.T @ np.linalg.solve(C, Phi), Phi.T @ np.linalg.solve(C, y))
    np.testing.assert_allclose(with_f, np.linalg.lstsq(Phi, y, rcond=None)[0], rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("path", ["hsgp", "exact"])
def test_unweighted_is_the_plain_mean_over_the_training_states_on_correlated_rows_too(path):
    data = _filtered("savgol")
    gp = OrthogonalGP(measure="unweighted", path=path, features=6)
    equation = Program({"v": ["y", "v", "y**3"]}, discrepancy=gp).assemble(data)["v"]
    hyper = Hyperparameters(jnp.asarray(0.1), jnp.asarray(0.8), jnp.asarray([1.0, 0.7]))
    columns, V = equation.rows.columns, equation.rows.operate
    Phi = V(np.asarray(equation.frame.dictionary_rows(columns)))
    K = V(V(_kernel_between(equation, columns, columns, hyper)).T)
    assert np.linalg.norm(Phi.T @ K) <= 1e-8 * np.linalg.norm(Phi) * np.linalg.norm(K)


def test_on_white_rows_the_metric_is_the_plain_mean_over_the_training_states(few):
    equation = Program({"ydot": SIX_TERMS}, discrepancy=OrthogonalGP(features=8)).assemble(few)["ydot"]
    Phi, psi = equation.frame.dictionary_rows(few.columns), equation.frame.plain_features(few.columns)
    Phi_o = np.asarray(Phi @ equation.frame.orthonormal)
    np.testing.assert_allclose(Phi_o.T @ Phi_o / len(Phi_o), np.eye(6), atol=1e-12)
    np.testing.assert_allclose(equation.frame.moments, Phi_o.T @ np.asarray(psi) / len(Phi_o), atol=1e-12)


@pytest.mark.parametrize("length_scale", [0.3, 3.0, 10.0])
def test_conditioned_kernel_stays_orthogonal_where_its_constraints_degenerate(few, length_scale):
    """⟨Φ, k, Φ⟩ loses rank to rounding as the length scale grows."""
    hyper = Hyperparameters(jnp.asarray(0.1), jnp.asarray(1.0), jnp.full(2, length_scale))
    Phi = np.stack([few.columns[n] ** p for p in (1, 2, 3) for n in ("y", "ydot")], axis=1)
    Phi /= np.sqrt(np.mean(Phi**2, axis=0))
    for path in ("hsgp", "exact"):
        gp = OrthogonalGP(variant="conditioned", path=path)
        equation = Program({"ydot": SIX_TERMS}, discrepancy=gp).assemble(few)["ydot"]
        K = _kernel_between(equation, few.columns, few.columns, hyper)
        assert np.linalg.norm(Phi.T @ K / len(K)) <= 1e-8 * np.linalg.norm(Phi) / np.sqrt(len(K))
        eigenvalues = np.linalg.eigvalsh(K)
        assert eigenvalues[0] >= -1e-10


def test_projected_is_conditioned_when_the_kernel_is_orthogonal_already():
    """Under a periodic measure cosines of other frequencies are orthogonal to the dictionary: C = 0."""
    # Midpoints of a uniform grid on the features' whole domain: ψ are exactly orthonormal under this measure.
    n, L = 64, 2.0
    x = -L + 2 * L * (np.arange(n) + 0.5) / n
    data = Trajectories.from_arrays(np.arange(float(n)), states={"x": x}, derivatives={"x": np.sin(x)})
    # Data fill [−1, 1] in scaled units, so boundary 1 + tiny puts the domain's edge at the outermost half
    # cell.
    edge = 1 / (1 - 1 / n)
    half = np.abs(x).max()
    # The dictionary is the 9th and 11th feature, which the basis of 8 does not contain.
    terms = [f"cos({j} * {np.pi} / (2 * {edge * half}) * (x + {edge * half}))" for j in (9, 11)]
    hyper = Hyperparameters(jnp.asarray(0.1), jnp.asarray(0.7), jnp.asarray([0.4]))
    kernels = {}
    for variant in ("projected", "conditioned", "none"):
        gp = OrthogonalGP(variant=variant, features=8, boundary=edge)
        equation = Program({"x": terms}, discrepancy=gp).assemble(data)["x"]
        kernels[variant] = _kernel_between(equation, data.columns, data.columns, hyper)
    size = np.abs(kernels["none"]).max()
    assert np.abs(kernels["projected"] - kernels["none"]).max() <= 1e-10 * size
    assert np.abs(kernels["projected"] - kernels["conditioned"]).max() <= 1e-10 * size


def test_printed_formula_is_no_covariance(record):
    """Six terms, unit hyperparameters, 400 points of the oscillator."""
    x = jnp.asarray(np.stack([record.columns["y"], record.columns["ydot"]], axis=1))
    low, high = np.asarray(x).min(0), np.asarray(x).max(0)
    nodes, weights = box_nodes(2)
    nodes = (low + high) / 2 + (high - low) / 2 * nodes

    def dictionary(points):
        return np.stack([np.asarray(points)[:, d] ** p for p in (1, 2, 3) for d in (0, 1)], axis=1)

    def smallest(variant, weights, rows):
        T = orthonormalise(dictionary(rows), weights)
        at_points = (x, jnp.asarray(dictionary(x) @ T))
        at_nodes = (jnp.asarray(rows), jnp.asarray(weights[:, None] * (dictionary(rows) @ T)))
        kernel = KERNELS["squared_exponential"]
        K = orthogonal_gram(variant, kernel, 1.0, jnp.ones(2), at_points, at_points, at_nodes)
        return float(np.linalg.eigvalsh(np.asarray(K))[0])

    empirical = np.full(len(x), 1 / len(x))
    area = float(np.prod(high - low))
    # -496 under the uniform probability measure on the box, -205 under Lebesgue measure, and -400 = −n, the
    # least possible, under the empirical one.
    assert -1000 < smallest("printed", weights, nodes) < -250
    assert -400 < smallest("printed", weights * area, nodes) < -100
    assert -400 < smallest("printed", empirical, np.asarray(x)) < -399
    for variant in ("projected", "conditioned"):
        for measure in ((weights, nodes), (empirical, np.asarray(x))):
            assert smallest(variant, *measure) > -1e-11


@pytest.mark.parametrize("measure", MEASURES)
def test_printed_formula_is_refused_with_its_eigenvalue(record, measure):
    gp = OrthogonalGP(variant="printed", path="exact", measure=measure)
    with pytest.raises(InputError, match=r"smallest eigenvalue is -\d+.*variant='projected'"):
        Program({"ydot": SIX_TERMS}, discrepancy=gp).assemble(record)


def test_printed_formula_can_be_built_where_it_is_a_covariance(few):
    # One term and a large amplitude: k − φ φ'/⟨φ, φ⟩ is positive semi-definite.
    gp = OrthogonalGP(variant="printed", path="exact", amplitude=30.0, length_scale=2.0)
    design = Program({"ydot": ["y"]}, discrepancy=gp).assemble(few)["ydot"].design
    hyper = Hyperparameters(jnp.asarray(0.1), jnp.asarray(30.0), jnp.full(2, 2.0))
    assert np.linalg.eigvalsh(np.asarray(design.covariance(hyper)))[0] > -1e-7


def test_orthonormalise_reveals_the_rank():
    rng = np.random.default_rng(1)
    Phi = rng.standard_normal((50, 4))
    Phi[:, 3] = Phi[:, 0] - 2 * Phi[:, 1]
    weights = rng.dirichlet(np.ones(50))
    T = orthonormalise(Phi, weights)
    assert T.shape == (4, 3)
    np.testing.assert_allclose((Phi @ T).T @ (weights[:, None] * (Phi @ T)), np.eye(3), atol=1e-12)


def test_collinear_terms_are_named_and_others_left_alone():
    rng = np.random.default_rng(2)
    columns = rng.standard_normal((40, 4))
    require_independent(columns, ("a", "b", "c", "d"), "v")
    columns[:, 2] = 1e6 * columns[:, 0] + 1e-5 * columns[:, 2]
    require_independent(columns[:, [0, 1, 3]], ("a", "b", "d"), "v")
    with pytest.raises(InputError, match="Collinear terms in equation 'v'") as caught:
        require_independent(columns, ("a", "b", "c", "d"), "v")
    assert "'a'" in str(caught.value) and "'c'" in str(caught.value)
    assert "'b'" not in str(caught.value) and "'d'" not in str(caught.value)

"""The package beside the machine itself: a gradient beside LAPACK's share of it, a pass over rows beside a product.

A gradient of the sampler, with M features, factorises A = I + diag(s) G diag(s), solves with it for K + 1 columns on
its way there and again on its way back, and needs diag(A⁻¹), for which LAPACK inverts the triangle: dpotrf, twice
dpotrs, dtrtri, called from SciPy. The pass over rows [Φ Ψ y] gives their triangular factor; the product is FᵀG of two
matrices of the same shapes by NumPy, block by block. Seconds are those of the processor, of one thread, the least of
many.
"""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy.linalg

from .contenders.here import asked_of
from .drawn import FEATURES
from .problems import BOX, Data, Problem, measured

LARGE = 20
"""Features along each of two variables, of the largest basis that a fit is given without being asked."""

PASS_ROWS, PASS_COLUMNS = 2**20, 107
"""Shape of the pass: K + M + 1 columns of the oscillator."""

LEAST_OF, GRADIENTS = 15, 100
"""Repeats of which the least counts; gradients in each."""


def floor(name: str) -> dict[str, float]:
    """Measure `here` and `machine`, seconds, and `times`, the one over the other, of an entry of `FLOORS`."""
    here, machine = FLOORS[name]()
    return {"here": here, "machine": machine, "times": here / machine}


def gradient(n_var: int, along: int, n_term: int = 6) -> tuple[float, float]:
    """Return seconds of a gradient of the log density that NUTS sees, and of LAPACK alone."""
    import jax

    from bayes_greybox.running.compiling import compiled

    log_density, start, design = _density(measured(Problem(BOX, 1000, n_term, n_var), 1), along)

    def ascended(z: Any, design: Any, times: Any) -> Any:
        # One after the other within one program, as in a trajectory: what a call costs is not counted.
        def body(_: Any, z: Any) -> Any:
            slope = jax.grad(log_density(design))(z)
            return jax.tree.map(lambda a, b: a + 1e-12 * b, z, slope)

        return jax.lax.fori_loop(0, times, body, z)

    run = compiled(ascended)
    run(start, design, 1)
    here = least(lambda: jax.block_until_ready(run(start, design, GRADIENTS))) / GRADIENTS
    return here, lapack(design["a"].Psi.shape[1], n_term + 1)


def lapack(n_basis: int, n_column: int) -> float:
    """Return seconds of dpotrf, twice dpotrs and dtrtri, of order M and with K + 1 right-hand sides."""
    generator = np.random.default_rng(0)
    root = generator.standard_normal((n_basis, n_basis))
    A = np.asfortranarray(np.eye(n_basis) + root @ root.T / n_basis)
    right = np.asfortranarray(generator.standard_normal((n_basis, n_column)))
    potrf, potrs, trtri = scipy.linalg.get_lapack_funcs(("potrf", "potrs", "trtri"), (A,))

    def once() -> None:
        for _ in range(GRADIENTS):
            L, _ = potrf(A, lower=1)
            potrs(L, right, lower=1)
            potrs(L, right, lower=1)
            trtri(L, lower=1)

    return least(once) / GRADIENTS


def row_pass(n_row: int, n_column: int) -> tuple[float, float]:
    """Return seconds of the triangular factor of rows, and of a product of matrices of the same shapes."""
    from bayes_greybox.model.algebra.compression import FACTOR_CHUNK, triangular_factor

    left, right = np.random.default_rng(0).standard_normal((2, FACTOR_CHUNK, n_column))

    def product() -> None:
        total = np.zeros((n_column, n_column))
        for _ in range(n_row // FACTOR_CHUNK):
            total += left.T @ right

    here = least(lambda: triangular_factor(lambda index: left[: len(index)], n_row))
    return here, least(product)


def least(once: Callable[[], object]) -> float:
    """Return the least processor seconds of several calls."""
    times = []
    for _ in range(LEAST_OF):
        start = time.process_time()
        once()
        times.append(time.process_time() - start)
    return min(times)


def _density(data: Data, along: int) -> tuple[Callable[[Any], Callable], Any, Any]:
    """Return the negative log density by design, where to begin, and the designs."""
    import jax
    from numpyro.infer.util import initialize_model

    model, rows = asked_of(data, along)
    designs = model.designs(rows)
    program: Any = model.bare.numpyro_model
    found = initialize_model(jax.random.PRNGKey(0), program, model_args=(designs,), dynamic_args=True)
    return found.potential_fn, found.param_info.z, designs


FLOORS: dict[str, Callable[[], tuple[float, float]]] = {
    **{
        f"a gradient, {n_var} variables, {along} features each": partial(gradient, n_var, along)
        for n_var, along in (*((n, FEATURES[n]) for n in (1, 2, 4)), (2, LARGE))
    },
    f"a pass over {PASS_ROWS} rows of {PASS_COLUMNS} columns": partial(row_pass, PASS_ROWS, PASS_COLUMNS),
}
"""Comparisons by name."""

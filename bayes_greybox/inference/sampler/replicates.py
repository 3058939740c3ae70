"""Posteriors of many data sets that share everything but the target: one compilation, one chain for each."""

import threading
from collections.abc import Callable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.design import Design
from bayes_greybox.model.program import Program

from .draws import conditional_draw
from .kernel import posterior_kernel
from .nuts import hmc_record, in_threads


def sample_replicates(
    model: Program, designs: Mapping[str, Design], targets: Mapping[str, Float[np.ndarray, "n_replicate n_row"]],
    keys: Array, sampling: Sampling, done: Callable[[int], None] = lambda _: None,
) -> tuple[dict[str, np.ndarray], np.ndarray]:  # fmt: skip
    """Sample the posterior of each compressed target with the kernel and the conditional draws of a fit.

    Only the target changes between replicates, and it is an argument of the compiled chain. Chains run one by one in as
    many threads as there are cores, not in a batch: a batched NUTS makes every chain wait for the longest tree of all.
    Each replicate has a random key of its own. `done` is called with the number of replicates that have just been
    finished, from any thread.

    Returns:
        Scaled draws of each replicate, [n_replicate, n_draw, ...], and the number of its divergences after warm-up.
    """

    def chain(target: dict[str, Array], key: Array) -> dict[str, Array]:
        argument = {name: design.with_target(target[name]) for name, design in designs.items()}
        kernel = posterior_kernel(model, argument, sampling.target_accept)
        run_key, draw_key = jax.random.split(key)
        state = kernel.init(run_key, sampling.tune, None, (argument,), {})

        def step(state: tuple, _: None) -> tuple[tuple, dict[str, Array]]:
            state = kernel.sample(state, (argument,), {})
            return state, hmc_record(state)

        # Warm-up is recorded too and thrown away: a loop of its own would compile the sampler twice.
        _, record = jax.lax.scan(step, state, length=sampling.tune + sampling.draws)
        record = {name: value[sampling.tune :] for name, value in record.items()}
        position = {name[2:]: value for name, value in record.items() if name.startswith("z:")}
        values = jax.vmap(kernel.postprocess_fn((argument,), {}))(position)
        drawn = jax.lax.map(
            lambda item: conditional_draw(model.numpyro_model, argument, item[0], item[1]),
            (values, jax.random.split(draw_key, sampling.draws)),
        )
        return {**values, **drawn, "diverging": record["diverging"]}

    rows = [{name: jnp.asarray(target[i]) for name, target in targets.items()} for i in range(len(keys))]
    compiled = jax.jit(chain).lower(rows[0], keys[0]).compile()
    stop = threading.Event()

    def one(i: int) -> dict[str, np.ndarray]:
        if stop.is_set():
            return {}
        out = {name: np.asarray(value) for name, value in compiled(rows[i], keys[i]).items()}
        done(1)
        return out

    samples = in_threads(one, len(keys), stop)
    return samples, samples.pop("diverging").sum(axis=1)

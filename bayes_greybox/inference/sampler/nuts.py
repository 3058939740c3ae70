"""NUTS on a NumPyro model: chains in parallel threads, one compilation, a display of both, explicit keys."""

import os
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpyro.handlers import mask
from numpyro.infer.hmc import HMCState

from bayes_greybox.running.stages import stage, stages
from bayes_greybox.running.traces import kept

from .chain_file import ChainFile, SoFar, name_of

ITERATIONS_PER_CHUNK, SECONDS_PER_CHUNK, CHUNK_GROWTH = 100, 1.0, 4
"""Most iterations in a chunk, duration that chunks aim at, and the most by which one is longer than the one before.

Between chunks the progress bar, the chain's file and a stop signal are served.
"""

SAMPLING_LABEL = "Sampling"
"""Default text of the progress bar."""

Files = Callable[[int, str], ChainFile]
"""(number of a chain, digest of what it samples) -> the file that keeps it."""


@dataclass(frozen=True)
class Chains:
    """Draws of sites and deterministics, constrained, and statistics under ArviZ's names, [n_chain, n_draw, ...]."""

    samples: dict[str, np.ndarray]
    stats: dict[str, np.ndarray]


class Sampler:
    """An MCMC kernel of NumPyro around a model with one argument, compiled for any argument of the same shapes.

    NumPyro's `MCMC` runs chains in parallel only over several XLA devices, which a library cannot ask for once JAX is
    awake, and compiles once a chain otherwise. XLA releases the interpreter lock, so plain threads on one compiled
    step do the same; a chain's draws depend on its own key alone.
    """

    def __init__(self, make_kernel: Callable[[Any], Any], tune: int, identity: Any = None) -> None:
        """Compile nothing yet.

        `make_kernel` goes from the model's argument, traced, to `NUTS` or `HMCGibbs` around the model. With an
        `identity` of the kernel, `tune` included, traces are kept (see `traces.kept`).
        """
        self._tune = tune

        def start(key: Array, argument: Any) -> tuple[Any, Any]:
            kernel = make_kernel(argument)
            return kernel, kernel.init(key, tune, None, (argument,), {})

        def started(argument: Any) -> tuple[Any, Any]:
            # A kernel has to be started before it does anything. Only the structure of this start is used, so its
            # density and gradient are masked and need not be traced.
            with mask(mask=False):
                return start(jax.random.PRNGKey(0), argument)

        # Programs exchange states as leaves, because a kept trace has none of NumPyro's classes.
        def first(key: Array, argument: Any) -> list[Array]:
            return _leaves(start(key, argument)[1])

        def advance(leaves: list[Array], argument: Any, length: Array | int) -> tuple[list[Array], dict[str, Array]]:
            kernel, like = started(argument)
            state = jax.tree.unflatten(jax.tree.structure(like), leaves)
            buffers = hmc_record(state)
            record = jax.tree.map(lambda leaf: jnp.zeros((ITERATIONS_PER_CHUNK, *leaf.shape), leaf.dtype), buffers)

            def body(i: Array, carry: tuple) -> tuple:
                state, record = carry
                state = kernel.sample(state, (argument,), {})
                return state, jax.tree.map(lambda buffer, leaf: buffer.at[i].set(leaf), record, hmc_record(state))

            state, record = jax.lax.fori_loop(0, length, body, (state, record))
            return _leaves(state), record

        def constrain(values: Any, argument: Any) -> dict[str, Array]:
            kernel, _ = started(argument)
            return jax.vmap(jax.vmap(kernel.postprocess_fn((argument,), {})))(values)

        self._start = kept(first, identity, "start", once=True)
        self._advance = kept(advance, identity, "advance")
        self._constrain = kept(constrain, identity, "constrain", once=True)

    def run(
        self, argument: Any, *, draws: int, chains: int, key: Array, progress: bool, label: str = SAMPLING_LABEL,
        files: Files | None = None,
    ) -> Chains:  # fmt: skip
        """Run all chains; the key is split into one for each.

        Files keep the chains, which are resumed from there; InputError is raised if they keep other chains.
        """
        stop, total = threading.Event(), self._tune + draws
        with stages(progress):
            with stage("Compiling the sampler"):
                states = [self._start(key, argument) for key in jax.random.split(key, chains)]
                # A run of no iterations compiles the program once, before the threads need it.
                self._advance(states[0], argument, 0)
                begun = [SoFar(state, 0) for state in states]
                chain_files: list[ChainFile | None] = [None] * chains
                if files is not None:
                    chain_files = [files(k, name_of(argument, states[k], self._tune, draws)) for k in range(chains)]
                    begun = [(file and file.read()) or chain for file, chain in zip(chain_files, begun, strict=True)]

            with stage(label, chains * total) as line:
                divergences = np.array([chain.divergences for chain in begun])
                line.advance(sum(chain.done for chain in begun))

                def one_chain(k: int) -> dict[str, np.ndarray]:
                    chain, file, most = begun[k], chain_files[k], 1
                    while chain.done < total and not stop.is_set():
                        start, begin = chain.done, time.perf_counter()
                        length = min(most, (self._tune if start < self._tune else total) - start)
                        state, record = self._advance(chain.state, argument, length)
                        records = chain.records
                        if start >= self._tune:
                            # A copy, since a view would keep the whole buffer alive.
                            record = {name: np.asarray(value)[:length].copy() for name, value in record.items()}
                            records = (*records, record)
                            divergences[k] += int(record["diverging"].sum())
                        chain = SoFar(jax.block_until_ready(state), start + length, records)
                        if file is not None:
                            file.write(chain)
                        count = int(divergences.sum())
                        line.advance(length, f"{count} divergences" if count else "")
                        most = _next_length(length, time.perf_counter() - begin)
                    if file is not None and chain.done > begun[k].done:
                        file.write(chain, now=True)
                    return chain.record() if chain.done == total else {}

                stacked = in_threads(one_chain, chains, stop)

            unconstrained = {name[2:]: stacked.pop(name) for name in list(stacked) if name.startswith("z:")}
            samples = {name: np.asarray(value) for name, value in self._constrain(unconstrained, argument).items()}
        return Chains(samples, stacked)


def in_threads(
    one: Callable[[int], dict[str, np.ndarray]], number: int, stop: threading.Event
) -> dict[str, np.ndarray]:
    """Run `number` chains in threads, and stack their records; an error or interrupt sets `stop` for the others."""
    with ThreadPoolExecutor(min(number, os.cpu_count() or 1)) as pool:
        try:
            records = list(pool.map(one, range(number)))
        except BaseException:
            stop.set()
            raise
    return {name: np.stack([record[name] for record in records]) for name in records[0]}


def hmc_record(state: Any) -> dict[str, Array]:
    """Return position (sites as "z:name", unconstrained) and statistics of a sampler's state."""
    is_hmc = lambda node: isinstance(node, HMCState)  # noqa: E731
    hmc = next(leaf for leaf in jax.tree.leaves(state, is_leaf=is_hmc) if is_hmc(leaf))
    return {
        **{f"z:{name}": value for name, value in state.z.items()},
        "diverging": hmc.diverging,
        "acceptance_rate": hmc.accept_prob,
        "energy": hmc.energy,
        "lp": -hmc.potential_energy,
        "n_steps": hmc.num_steps,
        "tree_depth": jnp.ceil(jnp.log2(hmc.num_steps + 1.0)).astype(int),
        "step_size": hmc.adapt_state.step_size,
    }


def _leaves(state: Any) -> list[Array]:
    """Return the leaves with the types that arrays from a file have, so that one program takes both."""
    return [jax.lax.convert_element_type(leaf, jnp.result_type(leaf)) for leaf in jax.tree.leaves(state)]


def _next_length(length: int, seconds: float) -> int:
    """Return the length of the next chunk; how iterations are divided changes no draw."""
    paced = int(length * SECONDS_PER_CHUNK / max(seconds, 1e-9))
    return max(1, min(ITERATIONS_PER_CHUNK, CHUNK_GROWTH * length, paced))

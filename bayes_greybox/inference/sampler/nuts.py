"""NUTS on a NumPyro model: chains in parallel threads, one compilation, a display of both, explicit keys."""

import os
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array
from numpyro.handlers import mask
from numpyro.infer.hmc import HMCState

from bayes_greybox.running.stages import stage, stages
from bayes_greybox.running.traces import kept

from .chain_file import ChainFile, SoFar, name_of

CHUNK = 100
"""Most iterations between two looks at the progress bar, at the clock and at whether to stop."""

PACE, GROWTH = 1.0, 4
"""Seconds that such iterations are to take, and how many times as many they are at most as those before."""

SAMPLING = "Sampling"
"""What the bar says, by default."""


@dataclass(frozen=True)
class Chains:
    """What a run of NUTS returns.

    Attributes:
        samples: Sites and deterministics in constrained space, each [n_chain, n_draw, ...].
        stats: Sampler statistics under ArviZ's names, each [n_chain, n_draw].
    """

    samples: dict[str, np.ndarray]
    stats: dict[str, np.ndarray]


@runtime_checkable
class Files(Protocol):
    """Where chains are kept while they run."""

    def chain(self, chain: int, name: str) -> ChainFile:
        """The file of a chain of what has this name."""
        ...


class Sampler:
    """An MCMC kernel of NumPyro around a model with one argument, compiled for any argument of the same shapes.

    NumPyro's `MCMC` runs chains in parallel only over several XLA devices, which a library cannot ask for once JAX is
    awake, and compiles once a chain otherwise. XLA releases the interpreter lock, so plain threads on one compiled
    step do the same; a chain's draws depend on its own key alone.
    """

    def __init__(self, make_kernel: Callable[[Any], Any], tune: int, identity: Any = None) -> None:
        """Compile nothing yet.

        Args:
            make_kernel: From the model's argument, traced, to `NUTS` or `HMCGibbs` around the model.
            tune: Iterations of warm-up.
            identity: What the kernel depends on beside its argument, `tune` included, for `traces.kept`; None: keep no
                traces.
        """
        self._tune = tune

        def start(key: Array, argument: Any) -> tuple[Any, Any]:
            kernel = make_kernel(argument)
            return kernel, kernel.init(key, tune, None, (argument,), {})

        def started(argument: Any) -> tuple[Any, Any]:
            # A kernel can do nothing before it was started. Of this start only the structure is used, so that no
            # density and no gradient of it need be traced, lowered and thrown away.
            with mask(mask=False):
                return start(jax.random.PRNGKey(0), argument)

        # Between two programs a state is its leaves: a trace that is kept knows nothing of NumPyro's classes.
        def first(key: Array, argument: Any) -> list[Array]:
            return _leaves(start(key, argument)[1])

        def advance(leaves: list[Array], argument: Any, length: Array | int) -> tuple[list[Array], dict[str, Array]]:
            kernel, like = started(argument)
            state = jax.tree.unflatten(jax.tree.structure(like), leaves)
            record = jax.tree.map(lambda leaf: jnp.zeros((CHUNK, *leaf.shape), leaf.dtype), hmc_record(state))

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
        self,
        argument: Any,
        *,
        draws: int,
        chains: int,
        key: Array,
        progress: bool,
        what: str = SAMPLING,
        files: Files | None = None,
    ) -> Chains:
        """Run all chains.

        Args:
            argument: The model's argument, a pytree of arrays.
            draws: Draws kept in each chain.
            chains: Number of chains.
            key: Random key, split into one for each chain.
            progress: Whether to show a progress bar.
            what: What the bar says.
            files: Where chains are kept, and go on if they are there.

        Raises:
            InputError: The files hold other chains.
        """
        with stages(progress):
            return self._run(argument, draws, chains, key, what, files)

    def _run(self, argument: Any, draws: int, chains: int, key: Array, what: str, files: Files | None) -> Chains:
        with stage("Compiling the sampler"):
            states = [self._start(key, argument) for key in jax.random.split(key, chains)]
            # Compiled here, by a run of no iterations, so that the threads do not each do it.
            self._advance(states[0], argument, 0)
            begun = [SoFar(state, 0) for state in states]
            own: list[ChainFile | None] = [None] * chains
            if files is not None:
                own = [files.chain(k, name_of(argument, states[k], self._tune, draws)) for k in range(chains)]
                begun = [(file and file.read()) or chain for file, chain in zip(own, begun, strict=True)]
        stop, total = threading.Event(), self._tune + draws

        with stage(what, chains * total) as line:
            divergences = np.array([chain.divergences for chain in begun])
            line.advance(sum(chain.done for chain in begun))

            def one_chain(k: int) -> dict[str, np.ndarray]:
                chain, file, most = begun[k], own[k], 1
                while chain.done < total and not stop.is_set():
                    start, begin = chain.done, time.perf_counter()
                    length = min(most, (self._tune if start < self._tune else total) - start)
                    state, record = self._advance(chain.state, argument, length)
                    records = chain.records
                    if start >= self._tune:
                        # Copied, for a part keeps the whole, which may be a hundred times as much.
                        record = {name: np.asarray(value)[:length].copy() for name, value in record.items()}
                        records = (*records, record)
                        divergences[k] += int(record["diverging"].sum())
                    chain = SoFar(jax.block_until_ready(state), start + length, records)
                    if file is not None:
                        file.write(chain)
                    found = int(divergences.sum())
                    line.advance(length, f"{found} divergences" if found else "")
                    most = _paced(length, time.perf_counter() - begin)
                if file is not None and chain.done > begun[k].done:
                    file.write(chain, now=True)
                return chain.record() if chain.done == total else {}

            with ThreadPoolExecutor(min(chains, os.cpu_count() or 1)) as pool:
                try:
                    records = list(pool.map(one_chain, range(chains)))
                except BaseException:
                    stop.set()
                    raise

        stacked = {name: np.stack([record[name] for record in records]) for name in records[0]}
        unconstrained = {name[2:]: stacked.pop(name) for name in list(stacked) if name.startswith("z:")}
        samples = {name: np.asarray(value) for name, value in self._constrain(unconstrained, argument).items()}
        return Chains(samples, stacked)


def hmc_record(state: Any) -> dict[str, Array]:
    """Position (sites as "z:name", unconstrained) and statistics of a sampler's state."""
    is_hmc = lambda node: isinstance(node, HMCState)  # noqa: E731
    hmc = next(leaf for leaf in jax.tree.leaves(state, is_leaf=is_hmc) if is_hmc(leaf))
    positions: Mapping[str, Array] = state.z
    return {
        **{f"z:{name}": value for name, value in positions.items()},
        "diverging": hmc.diverging,
        "acceptance_rate": hmc.accept_prob,
        "energy": hmc.energy,
        "lp": -hmc.potential_energy,
        "n_steps": hmc.num_steps,
        "tree_depth": jnp.ceil(jnp.log2(hmc.num_steps + 1.0)).astype(int),
        "step_size": hmc.adapt_state.step_size,
    }


def _leaves(state: Any) -> list[Array]:
    """Leaves whose types are what arrays from a file have, so that both are input of one program."""
    return [jax.lax.convert_element_type(leaf, jnp.result_type(leaf)) for leaf in jax.tree.leaves(state)]


def _paced(length: int, seconds: float) -> int:
    """How many iterations come next; how they are divided changes no draw."""
    return max(1, min(CHUNK, GROWTH * length, int(length * PACE / max(seconds, 1e-9))))

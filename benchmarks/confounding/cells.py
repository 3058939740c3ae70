"""All replicates of one situation under one kernel, from one compilation."""

import time
from dataclasses import asdict, dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from bayes_greybox.criticism.convergence import MAX_R_HAT, MIN_ESS, array_stats
from bayes_greybox.criticism.trade_off import trade_offs
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampler.prior_data import open_equation
from bayes_greybox.inference.sampler.replicates import sample_replicates
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.model.design import EquationDraws
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.gp.kernels import Measure, Variant
from bayes_greybox.model.priors import Normal
from bayes_greybox.model.program import Program
from bayes_greybox.model.sites import EquationSites

from .situations import SITUATIONS, Records, records

KERNELS: tuple[tuple[Variant, Measure], ...] = (
    ("none", "empirical"),
    ("projected", "empirical"),
    ("projected", "box"),
    ("conditioned", "empirical"),
    ("conditioned", "box"),
)
"""Kernels compared; the measure plays no part in `none`."""

CELL_CHAINS, CELL_FEATURES, LEVEL = 2, 7, 0.9
"""Chains of a replicate, features along each variable, and probability of intervals."""


@dataclass(frozen=True)
class Cell:
    """One situation under one kernel.

    Attributes:
        situation: Name of the situation.
        variant: Kernel.
        measure: Measure with respect to which f is orthogonal.
        replicates: Data sets.
        draws: Draws kept of each chain.
        tune: Warm-up iterations of each chain.
        seed: Seed of data and sampler.
    """

    situation: str
    variant: Variant
    measure: Measure
    replicates: int
    draws: int
    tune: int
    seed: int

    @property
    def key(self) -> str:
        """Name of the cell, with everything that its result depends on."""
        return " ".join(map(str, asdict(self).values()))


def measure_cell(cell: Cell) -> dict[str, Any]:
    """Fit every replicate of a cell.

    Returns:
        `mean`, `lower`, `upper` [replicate][term] in user's units; `correlation` (largest |corr(θ_j, j-th coefficient
        of f projected on Φ)|), `r_hat`, `ess` (worst over θ and the hyperparameters) and `divergences` by replicate;
        `seconds`, of sampling, for one replicate; the truth: `theta`, `projected` (addition of δ to it), `overlap`.
    """
    situation = next(s for s in SITUATIONS if s.name == cell.situation)
    data = records(situation, cell.replicates, cell.seed)
    model = Program(
        dictionary={"v": list(situation.theta)},
        simulation={"v": "F"},
        prior=Normal(),
        discrepancy=OrthogonalGP(
            variant=cell.variant, measure=cell.measure, variables=("y", "v"), features=CELL_FEATURES
        ),
    )
    equation, targets = _compressed(model, data)
    ends: list[float] = []
    samples, divergences = sample_replicates(
        model,
        {"v": equation.design},
        {"v": np.repeat(targets, CELL_CHAINS, axis=0)},
        jax.random.split(jax.random.PRNGKey(cell.seed), CELL_CHAINS * cell.replicates),
        Sampling(cell.draws, cell.tune),
        done=lambda _: ends.append(time.perf_counter()),
    )
    # From the first chain that ended to the last: compilation is left out.
    seconds = CELL_CHAINS * (ends[-1] - ends[0]) / max(len(ends) - 1, 1)
    rows = [_judged(equation, samples, range(CELL_CHAINS * i, CELL_CHAINS * (i + 1))) for i in range(cell.replicates)]
    added = data.projected("empirical" if cell.variant == "none" else cell.measure)
    return {
        **asdict(cell),
        "theta": list(situation.theta.values()),
        "projected": added.tolist(),
        "overlap": data.overlap(),
        "seconds": seconds,
        "divergences": divergences.reshape(-1, CELL_CHAINS).sum(axis=1).tolist(),
        **{name: [row[name] for row in rows] for name in rows[0]},
    }


def converged(r_hat: float, ess: float, divergences: int) -> bool:
    """Return True if a replicate passes a fit's criteria for R̂, effective sample size and divergences."""
    return r_hat <= MAX_R_HAT and ess >= MIN_ESS and divergences == 0


def _compressed(model: Program, data: Records) -> tuple[Equation, np.ndarray]:
    """Return the equation, and the compressed target of every replicate, on rows that all replicates share.

    One factorisation [Φ Ψ̃] = Q T serves all: the rows are T, the targets Qᵀy with the norm of the rest of y below.
    """
    first = Trajectories.from_arrays(
        data.t, states={"y": data.y, "v": data.v}, derivatives={"v": data.rates[0]}, inputs={"F": data.force}
    )
    opened = open_equation(model.assemble(first)["v"])
    frame = opened.equation.frame
    targets = opened.compress((data.rates - data.force) / frame.target_scale)
    design = opened.equation.design.with_target(jnp.asarray(targets[0]))
    return replace(opened.equation, design=design), targets


def _judged(equation: Equation, samples: dict[str, np.ndarray], chains: range) -> dict[str, Any]:
    """Return intervals, trade-off and chain behaviour of one replicate."""
    stats = array_stats()
    own = EquationSites("v")
    parts = {name: samples[own[name]][list(chains)] for name in ("theta", "sigma", "amplitude", "length_scale")}
    columns = [parts["sigma"][..., None], parts["amplitude"][..., None], parts["length_scale"], parts["theta"]]
    judged = np.concatenate(columns, axis=-1)
    judged = np.moveaxis((judged - judged.mean(axis=(0, 1))) / judged.std(axis=(0, 1)), -1, 0)
    flat = {name: value.reshape(-1, *value.shape[2:]) for name, value in parts.items()}
    draws = EquationDraws(
        Hyperparameters(*(jnp.asarray(flat[name]) for name in ("sigma", "amplitude", "length_scale"))),
        flat["theta"],
        samples[own.theta_sd][list(chains)].reshape(flat["theta"].shape),
        samples[own.weight][list(chains)].reshape(len(flat["theta"]), -1),
        np.zeros((len(flat["theta"]), 0)),
        mean=np.zeros(flat["theta"].shape),
        spread=samples[own.theta_sd][list(chains)].reshape(flat["theta"].shape),
    )
    theta = flat["theta"] * equation.frame.coefficient_scale
    tail = (1 - LEVEL) / 2
    return {
        "mean": theta.mean(axis=0).tolist(),
        "sd": theta.std(axis=0).tolist(),
        "lower": np.quantile(theta, tail, axis=0).tolist(),
        "upper": np.quantile(theta, 1 - tail, axis=0).tolist(),
        "correlation": float(np.abs(trade_offs(equation, draws).correlation).max()),
        "r_hat": max(float(stats.rhat(column, method="rank")) for column in judged),
        "ess": min(float(stats.ess(column, method="bulk")) for column in judged),
    }

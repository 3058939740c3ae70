"""The posterior: one NUTS run and its exact conditional draws, kept as an ArviZ DataTree in user's units."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import xarray as xr
from jaxtyping import Bool

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.design import EquationDraws
from bayes_greybox.model.equation import Equation
from bayes_greybox.model.frame import Frame
from bayes_greybox.model.gp.hyper import Hyperparameters
from bayes_greybox.model.priors import Scales
from bayes_greybox.model.program import Program
from bayes_greybox.model.sites import Sites
from bayes_greybox.model.streams.statistics import RowStatistics, equations_of
from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.errors import InputError

from .kept.groups import drawn, row_dimension
from .sampler.programs import Programs, programs_for
from .settings import Sampling

MOST_NUMBERS = 10_000_000
"""Largest size of a group with one number for each observation and draw."""

SLAB = "slab"
"""Group with the scales and odds of a user-defined prior, which a file cannot hold."""


@dataclass(frozen=True)
class Posterior:
    """A fitted model.

    Attributes:
        model: The model that was fitted.
        data: Training data.
        sampling: Settings of the run.
        idata: DataTree in the InferenceData schema. For each equation e the `posterior` group has `e_theta` (user's
            units), `e_sigma`, `e_amplitude`, `e_length_scale` (user's units) and the scales of the prior (scaled
            units). The group `posterior_details`, of the same chains and draws, has `e_prior_sd` (scaled units),
            `e_weight` or `e_f`, and under a spike-and-slab prior `e_gamma` and `e_inclusion`.
        made: Equations and programs of the run; None for a posterior read from a file.
        whole: Statistics of all rows, by equation, if `data` are only a sample of them; else None.
        memory: Results of `remembered` functions.
    """

    model: Program
    data: Trajectories
    sampling: Sampling
    idata: xr.DataTree
    made: "Made | None" = field(default=None, repr=False, compare=False)
    whole: Mapping[str, RowStatistics] | None = field(default=None, repr=False, compare=False)
    memory: dict[str, Any] = field(default_factory=dict, init=False, repr=False, compare=False)

    @cached_property
    def equations(self) -> Mapping[str, Equation]:
        """Rows, frames and designs by equation, or by block of equations that share their rows."""
        if self._made is not None:
            return self._made.equations
        return self.model.assemble(self.data) if self.whole is None else equations_of(self.model, self.data, self.whole)

    @property
    def n_obs(self) -> int:
        """Number of rows that the draws are conditioned on."""
        return self.data.n_obs if self.whole is None else max(each.n_row for each in self.whole.values())

    @property
    def rows_in_words(self) -> str:
        """Number and kind of the rows, and how many of them are looked at one by one."""
        kind = self.model.rows.in_words(self.data)
        if self.whole is None:
            return f"{self.data.n_obs} rows ({kind})"
        return f"{self.n_obs:,} rows ({kind}), of which {self.data.n_obs} are looked at one by one"

    @cached_property
    def programs(self) -> Programs:
        """Compiled programs of this fit, for fits to other data of the same shapes."""
        if self._made is not None:
            return self._made.programs
        return programs_for(self.model, {name: entry.design for name, entry in self.equations.items()}, self.sampling)

    @property
    def sites(self) -> Sites:
        """Names of the variables of each equation."""
        return self.model.sites

    def drawn(self, group_name: str = "posterior") -> xr.Dataset:
        """Return every variable of a group of draws, details included."""
        return drawn(self.idata, group_name)

    def draws(self, equation: str, at_most: int | None = None, group_name: str = "posterior") -> EquationDraws:
        """Return draws of one equation in scaled units, chains flattened, evenly thinned to `at_most`."""
        frame, design = self.equations[equation].frame, self.equations[equation].design
        values = self.values(equation, at_most, group_name)
        n_draw = len(values["theta"])
        # Without a discrepancy there is neither amplitude nor length scale; the placeholders multiply no features.
        absent = {"amplitude": np.ones(n_draw), "length_scale": np.zeros((n_draw, len(frame.variables)))}
        values = {**absent, "weight": np.zeros((n_draw, 0)), "f": np.zeros((n_draw, 0)), **values}
        sigma, amplitude, weight, f = (
            values[quantity] / frame.target_scale for quantity in ("sigma", "amplitude", "weight", "f")
        )
        theta, length_scale = values["theta"] / frame.coefficient_scale, values["length_scale"] / frame.half_width
        hyper = Hyperparameters(*on_device((sigma, amplitude, length_scale)))
        given = design.coefficients.given(theta, values["prior_sd"])
        return EquationDraws(hyper, theta, values["prior_sd"], weight, f, *given)

    def summed(self, equation: str, at_most: int | None = None) -> Scales | None:
        """Return the `slab` of each draw, None if coefficients have bounds: then drawn patterns are conditioned on."""
        return None if self.equations[equation].design.coefficients.bounded else self.slab(equation, at_most)

    def slab(self, equation: str, at_most: int | None = None) -> Scales | None:
        """Return slab standard deviations and log prior odds [n_draw, n_term] if the sampler summed over the patterns.

        InputError is raised if the odds of inclusion do not follow from the draws.
        """
        values, entry = self.values(equation, at_most, "posterior"), self.equations[equation]
        if "gamma" not in values:
            return None
        if SLAB in self.idata.children:
            slab = self.values(equation, at_most, SLAB)
            mean = jnp.broadcast_to(entry.design.coefficients.mean, slab["theta_sd"].shape)
            return Scales(jnp.asarray(slab["theta_sd"]), jnp.asarray(slab["log_odds"]), mean)
        return self.model.slab(entry.design, values, values["sigma"] / entry.frame.target_scale)

    def require_rows(self, what: str) -> None:
        """Require linear rows, not exact paths; `what` begins the error message, such as "Checks are made"."""
        if self.sampling.exact:
            raise InputError(
                f"{what} from the rows of a fit, which are linear, and these draws are of exact paths: ask the fit "
                "that was refined."
            )

    def likeliest_pattern(self, equation: str) -> Bool[np.ndarray, " n_term"]:
        """Return the most frequent inclusion pattern of the draws; all terms under a prior without inclusion."""
        patterns, count = np.unique(self.patterns(equation), axis=0, return_counts=True)
        return patterns[np.argmax(count)]

    def patterns(self, equation: str) -> Bool[np.ndarray, "n_draw n_term"]:
        """Return the inclusion pattern of each draw; all terms under a prior without inclusion."""
        values = self.values(equation)
        return values.get("gamma", np.ones(values["theta"].shape)).astype(bool)

    def add_group(self, name: str, values: Mapping[str, np.ndarray], draw: np.ndarray | None = None) -> None:
        """Add a group with variables [n_chain, n_draw, n_obs] to `idata`.

        `draw` are the numbers of the draws, if not all were kept.
        """
        n_chain, n_draw = next(iter(values.values())).shape[:2]
        rows = {self.sites[key].rate: row_dimension(entry) for key, entry in self.equations.items()}
        variables, numbers = {}, {}
        for key, value in values.items():
            dimension, number = rows[key]
            if value.shape[2] == len(number):
                numbers[dimension] = number
            else:
                # Under spectral noise the observations are whitened coefficients, fewer than rows and without a time.
                dimension = f"{key}_coefficient"
            variables[key] = (("chain", "draw", dimension), value)
        coords = {"chain": np.arange(n_chain), "draw": np.arange(n_draw) if draw is None else draw}
        self.idata[name] = xr.DataTree(xr.Dataset(variables, coords=coords | numbers))

    def learned(self) -> dict[str, "Learned"]:
        """Return equation and frame of each learned state, also of those that share their rows."""
        return {
            state: Learned(name, equation, share.frame, share.columns)
            for name, equation in self.equations.items()
            for state, share in equation.frame.shares().items()
        }

    @property
    def _made(self) -> "Made | None":
        """Equations and programs of the run, unless `dataclasses.replace` changed the model or the data."""
        made = self.made
        return made if made is not None and made.model is self.model and made.data is self.data else None

    def values(self, equation: str, at_most: int | None = None, group_name: str = "posterior") -> dict[str, np.ndarray]:
        """Return the variables of one equation by quantity, chains flattened, evenly thinned."""
        group = self.drawn(group_name)
        n_draw = group.sizes["chain"] * group.sizes["draw"]
        index = np.arange(n_draw)
        if at_most is not None and n_draw > at_most:
            index = np.linspace(0, n_draw - 1, at_most).round().astype(int)
        values = {}
        for quantity, name in self.sites.owned(equation, map(str, group)).items():
            value = group[name].to_numpy()
            values[quantity] = value.reshape(n_draw, *value.shape[2:])[index]
        return values


class Learned(NamedTuple):
    """A learned state: the block of equations that share its rows, its own frame, and its columns of Φ in the block."""

    block: str
    equation: Equation
    frame: Frame
    columns: slice

    def of(self, draws: EquationDraws) -> EquationDraws:
        """Return the part of the draws of the block that belongs to this state."""
        return draws._replace(theta=draws.theta[:, self.columns], prior_sd=draws.prior_sd[:, self.columns])


@dataclass(frozen=True, eq=False)
class Made:
    """Sampled equations and compiled programs of a run of a model on data."""

    model: Program
    data: Trajectories
    equations: Mapping[str, Equation]
    programs: Programs

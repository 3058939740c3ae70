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

from .kept.groups import drawn
from .sampler.programs import Programs, programs_for
from .settings import Sampling

MOST_NUMBERS = 10_000_000
"""Groups with a number for each observation and draw are kept up to so many numbers."""

SLAB = "slab"
"""Group with the scales and odds that only a prior of the user's own can tell: a file cannot hold that prior."""


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
        made: What the run left beside its draws; None for a posterior read from a file.
        whole: What all rows say, by equation, where `data` are some of them that are looked at; else None.
        memory: What `remembered` functions found of it.
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
        """Rows, frames and designs by equation, or by block of equations that share their rows.

        They are rebuilt from the data if the posterior was read from a file.
        """
        if self._own is not None:
            return self._own.equations
        return self.model.assemble(self.data) if self.whole is None else equations_of(self.model, self.data, self.whole)

    @property
    def n_obs(self) -> int:
        """Rows that the draws are of."""
        return self.data.n_obs if self.whole is None else max(each.n_row for each in self.whole.values())

    @property
    def rows_in_words(self) -> str:
        """How many rows the draws are of, how many of them are looked at, and what they are."""
        said = self.model.rows.in_words(self.data)
        if self.whole is None:
            return f"{self.data.n_obs} rows ({said})"
        return f"{self.n_obs:,} rows ({said}), of which {self.data.n_obs} are looked at one by one"

    @cached_property
    def programs(self) -> Programs:
        """The compiled programs of this fit, for fits to other data of the same shapes."""
        if self._own is not None:
            return self._own.programs
        return programs_for(self.model, {name: entry.design for name, entry in self.equations.items()}, self.sampling)

    @property
    def sites(self) -> Sites:
        """Names of the variables of each equation."""
        return self.model.sites

    def drawn(self, group_name: str = "posterior") -> xr.Dataset:
        """Every variable that was drawn, details among them.

        Args:
            group_name: "posterior", "prior", or another group of draws.
        """
        return drawn(self.idata, group_name)

    def draws(self, equation: str, at_most: int | None = None, group_name: str = "posterior") -> EquationDraws:
        """Draws of one equation in scaled units, chains flattened, evenly thinned to `at_most`.

        Args:
            equation: A key of `equations`.
            at_most: Most draws; None: all.
            group_name: "posterior" or "prior".
        """
        frame = self.equations[equation].frame
        values = self.values(equation, at_most, group_name)
        n_draw = len(next(iter(values.values())))

        def flat(quantity: str, n_column: int | None = None) -> np.ndarray:
            if quantity in values:
                return values[quantity]
            return np.ones(n_draw) if n_column is None else np.zeros((n_draw, n_column))

        coefficients, theta = self.equations[equation].design.coefficients, values["theta"] / frame.coefficient_scale
        # Without a discrepancy there is neither amplitude nor length scale; the placeholders multiply no features.
        return EquationDraws(
            Hyperparameters(
                on_device(flat("sigma") / frame.target_scale),
                on_device(flat("amplitude") / frame.target_scale),
                on_device(flat("length_scale", len(frame.variables)) / frame.half_width),
            ),
            theta,
            values["prior_sd"],
            flat("weight", 0) / frame.target_scale,
            flat("f", 0) / frame.target_scale,
            *coefficients.given(theta, values["prior_sd"]),
        )

    def summed(self, equation: str, at_most: int | None = None) -> Scales | None:
        """Slab standard deviations and log prior odds [n_draw, n_term] where criticism may sum over the patterns.

        Args:
            equation: Learned state.
            at_most: As for `draws`.

        Returns:
            The scales of each draw; None where there is no closed form for the sum, as Gibbs moves drew the patterns or
            coefficients have bounds: then the drawn pattern is given with η.

        Raises:
            InputError: The prior's odds of inclusion cannot be told from the draws.
        """
        return None if self.equations[equation].design.coefficients.bounded else self.slab(equation, at_most)

    def slab(self, equation: str, at_most: int | None = None) -> Scales | None:
        """Slab standard deviations and log prior odds [n_draw, n_term] where the sampler summed over the patterns.

        Args:
            equation: Learned state.
            at_most: As for `draws`.

        Raises:
            InputError: The prior's odds of inclusion cannot be told from the draws.
        """
        values, entry = self.values(equation, at_most, "posterior"), self.equations[equation]
        if "gamma" not in values:
            return None
        if SLAB in self.idata.children:
            kept = self.values(equation, at_most, SLAB)
            mean = jnp.broadcast_to(entry.design.coefficients.mean, kept["theta_sd"].shape)
            return Scales(jnp.asarray(kept["theta_sd"]), jnp.asarray(kept["log_odds"]), mean)
        return self.model.slab(entry.design, values, values["sigma"] / entry.frame.target_scale)

    def require_rows(self, what: str) -> None:
        """Refuse what is found from linear rows of draws that are not theirs.

        Args:
            what: That is asked for.

        Raises:
            InputError: Draws of `Fit.refine`.
        """
        if self.sampling.exact:
            raise InputError(
                f"{what} from the rows of a fit, which are linear, and these draws are of exact paths: ask the fit "
                "that was refined."
            )

    def likeliest_pattern(self, equation: str) -> Bool[np.ndarray, " n_term"]:
        """Terms that are in, in the commonest pattern of the draws; all of them under a prior without inclusion.

        Args:
            equation: A key of `equations`.
        """
        values = self.values(equation)
        if "gamma" not in values:
            return np.ones(values["theta"].shape[1], bool)
        patterns, count = np.unique(values["gamma"], axis=0, return_counts=True)
        return patterns[np.argmax(count)].astype(bool)

    def learned(self) -> dict[str, "Learned"]:
        """Frames by learned state, also of those that share their rows with others."""
        return {
            state: Learned(name, equation, share.frame, share.columns)
            for name, equation in self.equations.items()
            for state, share in equation.frame.shares().items()
        }

    @property
    def _own(self) -> "Made | None":
        """What the run left, unless `dataclasses.replace` put another model or other data in its place."""
        made = self.made
        return made if made is not None and made.model is self.model and made.data is self.data else None

    def values(self, equation: str, at_most: int | None = None, group_name: str = "posterior") -> dict[str, np.ndarray]:
        """Variables of one equation by quantity, chains flattened, evenly thinned."""
        group = self.drawn(group_name)
        n_draw = group.sizes["chain"] * group.sizes["draw"]
        index = np.arange(n_draw)
        if at_most is not None and n_draw > at_most:
            index = np.linspace(0, n_draw - 1, at_most).round().astype(int)
        found = {}
        for quantity, name in self.sites.owned(equation, map(str, group)).items():
            value = group[name].to_numpy()
            found[quantity] = value.reshape(n_draw, *value.shape[2:])[index]
        return found


class Learned(NamedTuple):
    """A learned state and where its coefficients are.

    Attributes:
        block: What its equation, or those that share its rows, are called.
        equation: Rows, frame and design of that.
        frame: Of this state alone.
        columns: Its columns of Φ.
    """

    block: str
    equation: Equation
    frame: Frame
    columns: slice

    def of(self, draws: EquationDraws) -> EquationDraws:
        """Its part of the draws of the block."""
        return draws._replace(theta=draws.theta[:, self.columns], prior_sd=draws.prior_sd[:, self.columns])


@dataclass(frozen=True, eq=False)
class Made:
    """What a run of a model on data leaves beside its draws: the sampled equations, and the compiled programs."""

    model: Program
    data: Trajectories
    equations: Mapping[str, Equation]
    programs: Programs

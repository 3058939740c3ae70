"""Terms of equations and of blocks that share their rows, and priors of single coefficients, as stated and scaled."""

import difflib
import math
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from bayes_greybox.physics.coefficient import Coefficient
from bayes_greybox.physics.formula.expressions import parse_expression, symbol_names
from bayes_greybox.physics.terms import Dictionary, Term, stating, terms_of
from bayes_greybox.running.arrays import on_device
from bayes_greybox.running.errors import InputError

from .algebra.collapsed import Ridge
from .algebra.truncated import BoundedPatterns, Bounds, bounded_patterns, log_mass, standardised, truncated_quantile
from .priors import Scales


class StatedTerms(NamedTuple):
    """The terms of one equation, and the priors of single ones by name.

    `known` terms are in the simulation: the `fixed` ones, which are not learned, and means that are taken off.
    """

    all: Dictionary
    learned: tuple[Term, ...]
    fixed: list[tuple[Term, float]]
    known: list[tuple[Term, float]]
    priors: dict[str, Coefficient]


def stated_terms(terms: Any, stated: Mapping[str, Coefficient], names: Sequence[str], equation: str) -> StatedTerms:
    """Read the terms of one equation and the priors of their coefficients."""
    dictionary = Dictionary.of(terms, names)
    priors = matched(stated, dictionary.names, equation)
    learned = tuple(t for t in dictionary.terms if t.name not in priors or priors[t.name].learned)
    known = [(t, priors[t.name].known) for t in dictionary.terms if t.name in priors]
    fixed = [(t, value) for t, value in known if t not in learned]
    return StatedTerms(dictionary, learned, fixed, [(t, value) for t, value in known if value != 0], priors)


def read_coefficients(stated: Any, dictionary: Mapping[str, Any]) -> dict[str, dict[str, Coefficient]]:
    """Read the priors of single coefficients that a model was given, and those that terms of its dictionary state."""
    example = "{'ydot': {'y**3': bg.priors.Coefficient(sign=-1)}}"
    if not isinstance(stated, Mapping):
        raise InputError(f"GreyBox(coefficients={stated!r}) must map equations to terms, for example {example}.")
    by_equation: dict[str, dict[str, Coefficient]] = {}
    for equation, terms in stated.items():
        if equation not in dictionary:
            raise InputError(
                f"GreyBox(coefficients=...) has priors for {equation!r}, which has no equation in the dictionary; "
                f"equations: {', '.join(dictionary) or 'none'}."
            )
        if not isinstance(terms, Mapping):
            raise InputError(f"GreyBox(coefficients={{{equation!r}: ...}}) must map terms, for example {example}.")
        for term, prior in terms.items():
            if not isinstance(prior, Coefficient):
                raise InputError(
                    f"GreyBox(coefficients=...) has {prior!r} for {term!r} of {equation!r}: give "
                    "bg.priors.Coefficient(...)."
                )
        by_equation[equation] = dict(terms)
    for equation, terms in dictionary.items():
        for term in stating(terms):
            assert term.stated is not None
            priors = by_equation.setdefault(str(equation), {})
            if priors.setdefault(term.name, term.stated) != term.stated:
                raise InputError(
                    f"The coefficient of the term {term.name!r} of {equation!r} is stated twice, {term.stated} and "
                    f"{priors[term.name]}: state it once, in the term or in coefficients=...."
                )
    return by_equation


def matched(stated: Mapping[str, Coefficient], names: Sequence[str], equation: str) -> dict[str, Coefficient]:
    """Return priors by the names of the dictionary's terms, which blanks in a key do not change."""
    by_term: dict[str, Coefficient] = {}
    for key, prior in stated.items():
        name = key if key in names else "".join(str(key).split())
        if name not in names:
            near = difflib.get_close_matches(name, names, n=1)
            hint = f" (did you mean {near[0]!r}?)" if near else ""
            raise InputError(
                f"GreyBox(coefficients=...) has a prior for {key!r}, which is no term of the dictionary of "
                f"{equation!r}{hint}; terms: {', '.join(names)}."
            )
        if name in by_term:
            raise InputError(f"The term {name!r} of {equation!r} has two priors of its coefficient: state it once.")
        by_term[name] = prior
    return by_term


def centred(stated: Mapping[str, Mapping[str, Coefficient]]) -> dict[str, dict[str, Coefficient]]:
    """Return the priors beside a simulation that has every term with its mean; coefficients with bounds are refused."""
    for equation, terms in stated.items():
        for term, prior in terms.items():
            if prior.bounded:
                raise InputError(
                    f"The evidence of a model has no closed form with bounds on a coefficient, as on {term!r} of "
                    f"{equation!r}: for a study give it mean and sd, or fixed, or leave its prior out; GreyBox.fit "
                    "takes it as it is."
                )
    return {name: {term: prior.centred() for term, prior in terms.items()} for name, terms in stated.items()}


def by_block(blocks: Mapping[str, tuple[str, ...]], dictionaries: Mapping[str, Dictionary]) -> dict[str, Dictionary]:
    """Return dictionaries by block, from those by learned state; equations that share their rows have a joint one."""
    return {
        name: dictionaries[name]
        if name in dictionaries
        else Dictionary.joined({each: dictionaries[each] for each in equations})
        for name, equations in blocks.items()
    }


def used_states(
    dictionary: Mapping[str, Any], simulation: Mapping[str, str], columns: Container[str]
) -> tuple[str, ...]:
    """Return learned states without data that another equation uses; one that nothing uses is a slip of the pen."""
    unknown = [name for name in dictionary if name not in columns and name not in simulation]
    if not unknown:
        return ()
    formulas = {name: parse_expression(str(text)) for name, text in simulation.items()}
    used: dict[str, set[str]] = {name: set(symbol_names(formula)) for name, formula in formulas.items()}
    for name, terms in dictionary.items():
        used.setdefault(name, set()).update(*(term.symbols for term in terms_of(terms)))
    return tuple(name for name in unknown if any(name in each for state, each in used.items() if state != name))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CoefficientPriors:
    """Priors of single terms of one equation in scaled units; every term of the dictionary has an entry.

    `shared` terms are under the model's prior, with the mean zero and an `sd` of one that nothing asks for; `certain`
    ones are in whatever the data say.
    """

    mean: Float[Array, " n_term"]
    sd: Float[Array, " n_term"]
    lower: Float[Array, " n_term"]
    upper: Float[Array, " n_term"]
    shared: tuple[int, ...] = field(metadata={"static": True})
    certain: tuple[int, ...] = field(default=(), metadata={"static": True})
    bounded: tuple[int, ...] = field(default=(), metadata={"static": True})

    @classmethod
    def of(cls, stated: Sequence[Coefficient | None], scale: Float[np.ndarray, " n_term"]) -> "CoefficientPriors":
        """Return scaled priors of the terms of an equation; `scale` is user's coefficient per scaled coefficient."""
        everything = (-math.inf, math.inf)
        limits = np.array([everything if c is None else c.interval for c in stated]).reshape(-1, 2) / scale[:, None]
        has_mean = [c is not None and c.mean is not None for c in stated]
        numbers = [(c.mean, c.sd) if c is not None and c.mean is not None else (0.0, 0.0) for c in stated]
        mean, sd = np.array(numbers, float).reshape(-1, 2).T / scale
        return cls(
            *on_device((mean, np.where(has_mean, sd, 1.0), limits[:, 0], limits[:, 1])),
            shared=tuple(j for j, stands in enumerate(has_mean) if not stands),
            certain=tuple(j for j, c in enumerate(stated) if c is not None and c.certain),
            bounded=tuple(j for j, c in enumerate(stated) if c is not None and c.bounded),
        )

    @property
    def stated(self) -> bool:
        """True if any term has more than the model's prior."""
        return bool(self.certain or self.bounded)

    def complete(self, shared: Scales | None) -> Scales:
        """Return the scales of all terms, given a draw of the model's prior for its terms; None where it has none."""
        if not self.stated and shared is not None:
            return shared
        if shared is None:
            return Scales(self.sd, None, self.mean)
        index = np.array(self.shared, int)
        # Log odds of a term that is in whatever the data say.
        odds, certainly = None, 1e3
        if shared.log_odds is not None:
            odds = jnp.full(self.mean.shape, certainly).at[index].set(shared.log_odds)
            odds = odds.at[np.array(self.certain, int)].set(certainly)
        return Scales(self.sd.at[index].set(shared.sd), odds, self.mean)

    def limits(self, scales: Scales) -> tuple[Float[Array, " n_bounded"], Float[Array, " n_bounded"]]:
        """Return the bounds of u = (θ − mean)/sd of the bounded terms."""
        index = np.array(self.bounded, int)
        sd, mean = scales.sd[index], self.mean[index]
        return standardised(self.lower[index], mean, sd), standardised(self.upper[index], mean, sd)

    def placed(self, full: Ridge, scales: Scales) -> BoundedPatterns:
        """Return the inclusion patterns, or the only one without odds, with the bounded coefficients placed."""
        assert scales.uniform is not None
        bounds = Bounds(*self.limits(scales), scales.uniform)
        return bounded_patterns(full.mean, full.covariance, scales.log_odds, bounds, self.bounded, self.certain)

    def draw(
        self, scales: Scales, key_gamma: Array, key_theta: Array
    ) -> tuple[Float[Array, " n_term"], Float[Array, " n_term"]]:
        """Draw θ from its prior, and return it with its standard deviations, zero where a term is out."""
        sd = scales.sd
        if scales.log_odds is not None:
            included = jax.random.bernoulli(key_gamma, jax.nn.sigmoid(scales.log_odds))
            sd = sd * included.at[np.array(self.certain, int)].set(True)
        z = jax.random.normal(key_theta, sd.shape)
        if self.bounded:
            index = np.array(self.bounded, int)
            uniform = jax.random.uniform(jax.random.fold_in(key_theta, 1), index.shape)
            z = z.at[index].set(truncated_quantile(uniform, *self.limits(scales)))
        mean = 0.0 if scales.mean is None else scales.mean
        # An excluded term is exactly zero, not minus zero.
        return jnp.where(sd > 0, mean + sd * z, 0.0), sd

    def log_restriction(self, sd: Float[Array, "*draws n_term"], power: float = 1.0) -> Float[Array, "*draws"]:
        """Return −Σ_j log P(lower_j ≤ θ_j ≤ upper_j), θ_j ~ N(mean_j, sd_j²/power), over the bounded terms with sd > 0.

        This is what restricting a normal prior adds to its log density inside the bounds.
        """
        total = jnp.zeros(sd.shape[:-1])
        for j in self.bounded:
            inside = sd[..., j] > 0
            scale = jnp.where(inside, sd[..., j], 1.0) / math.sqrt(power)
            mass = log_mass(*(standardised(limit[j], self.mean[j], scale) for limit in (self.lower, self.upper)))
            total = total - jnp.where(inside, mass, 0.0)
        return total

    def given(
        self, theta: Float[np.ndarray, "n_draw n_term"], sd: Float[np.ndarray, "n_draw n_term"]
    ) -> tuple[Float[np.ndarray, "n_draw n_term"], Float[np.ndarray, "n_draw n_term"]]:
        """Return mean and standard deviation of θ a priori given the bounded coefficients, which leave y normal."""
        mean, spread = np.broadcast_to(np.asarray(self.mean), theta.shape).copy(), np.array(sd)
        index = list(self.bounded)
        mean[:, index], spread[:, index] = theta[:, index], 0.0
        return mean, spread

"""The likeliest set of an equation's terms, in closed form: the model that rows are taken near, before any sampling.

In each set θ ~ N(0, I) in scaled units, and σ is integrated out (see `evidence`). Sets of k of the K terms have the
prior of π ~ Beta(1, K), B(1 + k, 2K − k)/B(1, K): one term or so is expected, however many there are to choose from
(Castillo & van der Vaart 2012, Ann. Statist. 40:2069). From the best set on the way from all terms to none, and from
none, the search goes by one more, one less and one other, and last by one more in the place of several.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.special import betaln

from bayes_greybox.model.equation import Equation
from bayes_greybox.model.gp.hyper import NoisePrior
from bayes_greybox.physics.terms import Term

from .evidence import Spectrum, coefficients, marginal

Set = tuple[int, ...]
"""Terms of a set by number, in order."""

MOST_EXCHANGED = 12
"""Largest set that is improved by exchanging one term for another: on the way larger ones are passed."""

LEFT_OUT_NATS = 12.0
"""Sets more than so many nats below the best do not count."""

BETTER = 1e-9
"""Nats by which another set is better."""


@dataclass(frozen=True)
class Likeliest:
    """The likeliest set: terms with posterior means and standard deviations, user's units, and what each `acts_on`.

    Sets near it are `weighed`, the likeliest first.
    """

    terms: tuple[tuple[Term, float], ...]
    acts_on: tuple[str, ...]
    sd: Float[np.ndarray, " n_in"]
    weighed: dict[Set, float]


def likeliest(equation: Equation, thorough: bool = True) -> Likeliest:
    """Find the likeliest set of terms of an equation without f; all of them where single coefficients have priors.

    If `thorough`, one term is tried in the place of several, and sets nearby are weighed.
    """
    frame, design = equation.frame, equation.design
    Phi, y = np.asarray(design.Phi), np.asarray(design.y)
    if design.coefficients.stated:
        values = equation.ridge()
        sd = np.sqrt(np.diag(np.linalg.pinv(Phi.T @ Phi)) * equation.variance)
        every = tuple(range(len(values)))
        scale = np.asarray(frame.coefficient_scale)
        return Likeliest(tuple(values), tuple(frame.dictionary.acts_on), sd * scale, {every: 1.0})
    search = _Search(Phi.T @ Phi, Phi.T @ y, float(y @ y), int(design.n_obs), float(design.noise_floor))
    best = search.best(thorough)
    weights = search.near(best) if thorough else {best: 1.0}
    mean, covariance = search.coefficients(best)
    scale = np.broadcast_to(frame.coefficient_scale, (search.n_term,))[list(best)]
    acts_on = tuple(frame.dictionary.acts_on)
    return Likeliest(
        terms=tuple((frame.dictionary.terms[i], float(v)) for i, v in zip(best, mean * scale, strict=True)),
        acts_on=tuple(acts_on[i] for i in best) if acts_on else (),
        sd=np.sqrt(np.diag(covariance)) * scale,
        weighed=weights,
    )


class _Search:
    """A search among sets of terms, by ΦᵀR⁻¹Φ, ΦᵀR⁻¹y, yᵀR⁻¹y, the number of observations and the least σ."""

    def __init__(self, gram: np.ndarray, product: np.ndarray, square: float, n_obs: int, floor: float) -> None:
        self.gram, self.product, self.square, self.n_obs = gram, product, square, n_obs
        self.noise = NoisePrior(floor, 1.0)
        self._known: dict[Set, float] = {}

    @cached_property
    def n_term(self) -> int:
        return len(self.product)

    def best(self, thorough: bool = True) -> Set:
        """Return the likeliest set that the search finds."""
        path = self._from_all()
        starts = dict.fromkeys((path[int(np.argmax(self._weigh(path)))], ()))
        best_set = max((self._climbed(start) for start in starts), key=lambda one: self._known[one])
        while thorough:
            merged = self._merged(best_set)
            if self._known[merged] <= self._known[best_set] + BETTER:
                break
            best_set = self._climbed(merged)
        return best_set

    def near(self, best: Set) -> dict[Set, float]:
        """Return the probabilities of the sets near the best one, the likeliest first."""
        self._weigh([*self._by_one(best), *self._exchanged(best)])
        inside = {one: log for one, log in self._known.items() if log > self._known[best] - LEFT_OUT_NATS}
        total = np.logaddexp.reduce(list(inside.values()))
        return {one: float(np.exp(log - total)) for one, log in sorted(inside.items(), key=lambda item: -item[1])}

    def coefficients(self, one: Set) -> tuple[np.ndarray, np.ndarray]:
        """Return posterior mean and covariance of a set's coefficients, scaled units."""
        if not one:
            return np.zeros(0), np.zeros((0, 0))
        spectrum = self._spectrum(np.array([one]))
        mean, covariance = coefficients(spectrum, marginal(spectrum, self.noise))
        return mean[0], covariance[0]

    def _climbed(self, start: Set) -> Set:
        self._weigh([start])
        while True:
            better = self._best_of(start, self._by_one(start))
            if better == start and len(start) <= MOST_EXCHANGED:
                better = self._best_of(start, self._exchanged(start))
            if better == start:
                return start
            start = better

    def _best_of(self, start: Set, others: Sequence[Set]) -> Set:
        if not others:
            return start
        logs = self._weigh(others)
        k = int(np.argmax(logs))
        return others[k] if logs[k] > self._known[start] + BETTER else start

    def _by_one(self, one: Set) -> list[Set]:
        more = [tuple(sorted((*one, j))) for j in range(self.n_term) if j not in one]
        return more + [tuple(i for i in one if i != j) for j in one]

    def _exchanged(self, one: Set) -> list[Set]:
        out = [j for j in range(self.n_term) if j not in one]
        return [tuple(sorted((*(i for i in one if i != j), k))) for j in one for k in out]

    def _merged(self, one: Set) -> Set:
        """Return the best set with one more term, less all that are better left out beside it."""
        if len(one) > MOST_EXCHANGED:
            return one
        reduced = []
        for j in range(self.n_term):
            if j in one:
                continue
            grown = tuple(sorted((*one, j)))
            self._weigh([grown])
            while len(grown) > 1:
                fewer = [tuple(i for i in grown if i != k) for k in grown if k != j]
                logs = self._weigh(fewer)
                best = int(np.argmax(logs))
                # Of terms that stand in for one, the first that leaves may cost a little.
                if logs[best] < self._known[grown] - LEFT_OUT_NATS:
                    break
                grown = fewer[best]
                reduced.append(grown)
        return self._best_of(one, reduced)

    def _from_all(self) -> list[Set]:
        """Return sets on the way from all terms to none, the least certain ones left out first."""
        kept, path, ridge = np.arange(self.n_term), list[Set]([()]), 1e-10
        while len(kept):
            path.append(tuple(kept.tolist()))
            gram = self.gram[np.ix_(kept, kept)]
            # With σ as large as the target no term is certain, and none is lost in rounding errors.
            variance = np.linalg.inv(gram + ridge * np.diag(np.diag(gram)) + ridge * self.square * np.eye(len(kept)))
            z = np.abs(variance @ self.product[kept]) / np.sqrt(np.diag(variance))
            kept = np.delete(kept, int(np.argmin(z)))
        return path

    def _weigh(self, sets: Sequence[Set]) -> Float[np.ndarray, " n_set"]:
        """Return log evidence and prior of each set, up to a constant."""
        by_size: dict[int, list[Set]] = {}
        for one in dict.fromkeys(sets):
            if one not in self._known:
                by_size.setdefault(len(one), []).append(one)
        for size, fresh in by_size.items():
            prior = float(betaln(1 + size, 2 * self.n_term - size))
            # So many sets that their matrices have some two million numbers.
            step = max(1, int(2e6 / max(size, 1) ** 2 / 4))
            for start in range(0, len(fresh), step):
                part = fresh[start : start + step]
                logs = marginal(self._spectrum(np.array(part, int).reshape(len(part), size)), self.noise).log_evidence
                self._known.update(zip(part, (logs + prior).tolist(), strict=True))
        return np.array([self._known[one] for one in sets])

    def _spectrum(self, sets: np.ndarray) -> Spectrum:
        sd = np.ones(sets.shape)
        if not sets.shape[1]:
            # A column with no size stands for none.
            sets, sd = np.zeros((len(sets), 1), int), np.zeros((len(sets), 1))
        gram = self.gram[sets[:, :, None], sets[:, None, :]]
        return Spectrum.of(gram, self.product[sets], self.square, self.n_obs, sd)

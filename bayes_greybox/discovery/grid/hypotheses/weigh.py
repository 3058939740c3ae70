"""The table of hypotheses: sets of regressors with their probability, coefficients, what they leave, and agreement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from bayes_greybox.discovery.grid.evidence.gram import Gram, gram
from bayes_greybox.discovery.grid.evidence.log_evidence import RIDGE, log_evidences, modes
from bayes_greybox.discovery.grid.evidence.ranges import log_ranges
from bayes_greybox.discovery.grid.evidence.search import Reach, Sets, search
from bayes_greybox.discovery.grid.evidence.set_prior import SetPrior, Window
from bayes_greybox.discovery.grid.noise.latent_force import LatentForce
from bayes_greybox.discovery.grid.noise.points import KINDS, LAW, RATIOS, REMAINS, TIME, noise_points
from bayes_greybox.discovery.grid.table import FREE, RegressorTable
from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.ties import ranked

from .agreement import bagged
from .band import Band
from .residuals import Pieces

LEAST_NOISE = 1e-6
"""Least first guess of the noise, over the RMS of the gap."""

FAR = 30.0
"""Nats behind the likeliest set from which on signs and limits are not asked: far beyond the window of the search."""


@dataclass(frozen=True)
class Hypothesis:
    """One set of regressors, with everything that may remain beside it summed over.

    Attributes:
        members: Its regressors.
        log_weight: Log posterior weight.
        probability: Posterior probability.
        agreement: Probability averaged over bagged records.
        kinds: Probability of each kind of discrepancy beside it, given the set.
        memories: Probability of each memory beside it, likewise.
        points: Probability of each noise point, given the set.
        point: Number of its likeliest noise point.
        noise: Standard deviation of the sensor's noise there.
        mean: Posterior means of its coefficients there.
        covariance: Their posterior covariance.
        sizes: RMS of what each regressor contributes that the others of the set could not.
        left: RMS of the smoothed discrepancy, times the root of the probability that there is one.
        beside: RMS of the part of that discrepancy in the band of each regressor, times the same root.
        against: Mean product of what each regressor contributes so with the whole discrepancy, times that probability:
            below zero where the two cancel.
    """

    members: tuple[int, ...]
    log_weight: float
    probability: float
    agreement: float
    kinds: Mapping[str, float]
    memories: Mapping[str, float]
    points: Float[np.ndarray, " n_point"]
    point: int
    noise: float
    mean: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    sizes: Float[np.ndarray, " k"]
    left: float
    beside: Float[np.ndarray, " k"]
    against: Float[np.ndarray, " k"]

    def keeping(self, places: Sequence[int]) -> "Hypothesis":
        """Return the hypothesis without some of its regressors, its other coefficients as they are.

        Args:
            places: Of the regressors that stay, among its members.
        """
        own = list(places)
        members = tuple(self.members[k] for k in own)
        return replace(
            self, members=members, mean=self.mean[own], covariance=self.covariance[np.ix_(own, own)],
            sizes=self.sizes[own], beside=self.beside[own], against=self.against[own],
        )  # fmt: skip

    @property
    def sd(self) -> Float[np.ndarray, " k"]:
        """Return the posterior standard deviations of its coefficients."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


@dataclass(frozen=True, eq=False)
class Weighed:
    """All hypotheses of one table.

    Attributes:
        table: Target and regressors.
        forces: The rows under each shape of the noise.
        grid: Products under every noise point.
        precision: Prior precisions of the coefficients.
        floor: Least variance of the noise.
        hypotheses: Likeliest first.
        blocks: Log likelihood of each block of the record at each hypothesis's mode.
        prior: Prior probability of sets.
    """

    table: RegressorTable
    forces: tuple[LatentForce, ...]
    grid: Gram
    precision: Float[np.ndarray, " n_column"]
    floor: float
    hypotheses: tuple[Hypothesis, ...]
    blocks: Float[np.ndarray, "n_hypothesis n_block"]
    prior: SetPrior

    def told(self, more: Sequence[float], seed: int) -> "Weighed":
        """Return the hypotheses where their log weights are known better.

        Args:
            more: What is added to the log weight of each.
            seed: Of the bagged records.
        """
        if not np.any(more):
            return self
        weights = np.array([h.log_weight for h in self.hypotheses]) + np.asarray(more, float)
        probability = np.exp(weights - np.logaddexp.reduce(weights))
        agreement = bagged(self.blocks, probability, seed)
        order = ranked(range(len(weights)), lambda k: float(weights[k]))
        hypotheses = tuple(
            replace(
                self.hypotheses[k], log_weight=float(weights[k]), probability=float(probability[k]),
                agreement=float(agreement[k]),
            )
            for k in order
        )  # fmt: skip
        return replace(self, hypotheses=hypotheses, blocks=self.blocks[order])

    @property
    def gap_square(self) -> float:
        """Return the mean square of the gap as a force, in scaled units."""
        return float(np.mean(self.table.target**2)) * self.table.force.gap**2

    def residual(self, hypothesis: Hypothesis) -> Float[np.ndarray, " n_row"]:
        """Return the target less what a hypothesis's regressors explain at its mode."""
        return self.table.target - self.table.columns[:, list(hypothesis.members)] @ hypothesis.mean

    def white(self, hypothesis: Hypothesis) -> Float[np.ndarray, " n_white"]:
        """Return the whitened residual of a hypothesis at its likeliest point whose noise is white and normal.

        It is white and of unit variance where the model is right.
        """
        number, residual, v = self._likeliest(hypothesis, [point.shape == 0 for point in self.grid.points])
        return self._pieces.white(number, residual)[0][:, 0] / np.sqrt(v)

    def standardised(self, hypothesis: Hypothesis) -> Float[np.ndarray, " n_white"]:
        """Return leave-one-out residuals at a hypothesis's mode, each over its predictive standard deviation.

        z_i = e_i / (√v √(1 − h_i)), e the whitened residual and h the leverage of the columns.
        """
        rows = np.column_stack([self.residual(hypothesis), self.table.columns[:, list(hypothesis.members)]])
        white = self._pieces.white(hypothesis.point, rows)[0]
        X = white[:, 1:]
        leverage = np.clip(np.einsum("ij,jk,ik->i", X, hypothesis.covariance, X) / hypothesis.noise**2, 0.0, 0.99)
        return white[:, 0] / (hypothesis.noise * np.sqrt(1 - leverage))

    def latent_force(self, hypothesis: Hypothesis) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return the smoothed latent force beside a hypothesis at the samples, mean and standard deviation, scaled.

        It is that of the likeliest noise point with a force in time: a law of the states is one, too.
        """
        kinds = [point.kind for point in self.grid.points]
        number, residual, v = self._likeliest(hypothesis, [kind == (TIME if TIME in kinds else LAW) for kind in kinds])
        mean, variance = self._pieces.smoothed(number, residual)
        return mean[:, 0], np.sqrt(v * variance)

    @cached_property
    def _pieces(self) -> Pieces:
        return Pieces(self.table, self.forces, self.grid.points, {})

    def _likeliest(self, hypothesis: Hypothesis, able: Sequence[bool]) -> tuple[int, Float[np.ndarray, "n 1"], float]:
        """Return the likeliest of the noise points that may be, with the residual and v at the mode there."""
        number = int(np.argmax(np.where(able, hypothesis.points, -1.0)))
        found = modes(self.grid, self.precision, [hypothesis.members], np.array([number]), self.floor)
        residual = self.table.target - self.table.columns[:, list(hypothesis.members)] @ found.mean[0]
        return number, residual[:, None], float(found.v[0])

    @property
    def before(self) -> Hypothesis:
        """Return the hypothesis with the user's own terms alone."""
        free = self.table.of_kind(FREE)
        return next(h for h in self.hypotheses if h.members == free)


def weigh(
    table: RegressorTable, odds: Odds, reach: Reach, floor: float, shapes: Sequence[tuple[LatentForce, float]] = (),
    seed: int = 0, window: Window | None = None,
) -> Weighed:  # fmt: skip
    """Return the hypotheses of a table.

    Args:
        table: Target and regressors at the rows.
        odds: Prior probabilities.
        reach: How far the search goes.
        floor: Least variance of the noise, in units of the target's.
        shapes: Rows under further shapes of the noise, each with the log prior that it adds.
        seed: Of the bagged records.
        window: What the regressors are some of; None if they are all.
    """
    forces = (table.force, *(force for force, _ in shapes))
    force = table.force
    noise = max(force.noise, np.sqrt(floor), LEAST_NOISE * force.gap)
    ratios: np.ndarray = RATIOS * force.gap / noise
    memories = tuple(table.memories) if window is None else window.memories
    points = noise_points(
        force.period, force.step, ratios, table.law.rows.shape[1] > 0, memories,
        (0.0, *(log_prior for _, log_prior in shapes)),
        odds.noise if force.forced else None, RATIOS / noise,
    )  # fmt: skip
    kinds = len({point.kind for point in points} & set(REMAINS))
    points = tuple(point for point in points if not point.memory or point.memory in table.memories)
    every = table.regressors
    prior = SetPrior.of(every, odds, reach.effects) if window is None else window.prior.among(every)
    weight = _Weight(
        table, gram(table, points, forces), np.array([each.sd**-2.0 for each in every]), prior, floor, kinds
    )  # fmt: skip
    sets = search(table.regressors, weight.total, reach)
    # The model before is one of them, however unlikely: the gap is what it leaves.
    before = table.of_kind(FREE)
    sets += [before] if before not in sets else []
    logs = weight.by_point(sets)
    totals = np.logaddexp.reduce(logs, axis=1)
    probability = np.exp(totals - np.logaddexp.reduce(totals))
    best = np.argmax(logs, axis=1)
    found = modes(weight.products, weight.precision, sets, best, floor)
    residuals = np.column_stack(
        [table.target - table.columns[:, list(s)] @ m for s, m in zip(sets, found.mean, strict=True)]
    )
    pieces = Pieces(table, forces, points, {})
    in_blocks = pieces.block_logs(best, residuals, found.v)
    agreement = bagged(in_blocks, probability, seed)
    remainder = pieces.remainder(logs, residuals)
    left, with_left = np.sqrt(np.mean(remainder**2, axis=0)), table.acting.T @ remainder / len(remainder)
    band = Band(table.acting, remainder)
    of_kind = {kind: np.array([p.kind == kind for p in points]) for kind in KINDS}
    of_memory = {memory: np.array([p.memory == memory for p in points]) for memory in table.memories}
    hypotheses = []
    for k, members in enumerate(sets):
        share = np.exp(logs[k] - totals[k])
        kinds = {kind: float(share[own].sum()) for kind, own in of_kind.items()}
        memories = {memory: float(share[own].sum()) for memory, own in of_memory.items()}
        apart, alone = _apart(weight.products.products[0], members)
        remains = sum(kinds[kind] for kind in REMAINS)
        hypotheses.append(
            Hypothesis(
                members, float(totals[k]), float(probability[k]), float(agreement[k]), kinds, memories, share,
                int(best[k]), float(np.sqrt(found.v[k])), found.mean[k], found.covariance[k],
                np.abs(found.mean[k]) * apart, float(left[k] * np.sqrt(remains)),
                left[k] * np.sqrt(remains * band.of(k, members, alone)),
                remains * found.mean[k] * (alone @ with_left[list(members), k]),
            )
        )  # fmt: skip
    return Weighed(table, forces, weight.products, weight.precision, floor, tuple(hypotheses), in_blocks, prior)


@dataclass(frozen=True)
class _Weight:
    """Log posterior weights of sets."""

    table: RegressorTable
    products: Gram
    precision: np.ndarray
    prior: SetPrior
    floor: float
    kinds: int

    @cached_property
    def _on_grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the log prior of each point given whether something remains, and whether it does at each."""
        points = self.products.points
        remains = np.array([point.remains for point in points])
        every = np.array([point.log_prior for point in points]) - np.where(remains, np.log(max(self.kinds, 1)), 0.0)
        return every - np.logaddexp.reduce(every[~remains]), remains

    def by_point(self, sets: Sets) -> Float[np.ndarray, "n_set n_point"]:
        """Return the log weight of each set under each point."""
        on_grid, remains = self._on_grid
        beside = self.prior.logs(sets)
        logs = log_evidences(self.products, self.precision, sets, self.floor)
        logs = logs + on_grid + np.where(remains, beside[:, 1:], beside[:, :1])
        return logs + self._ranges(sets, logs)[:, None]

    def total(self, sets: Sets) -> Float[np.ndarray, " n_set"]:
        """Return the log weight of each set."""
        return np.logaddexp.reduce(self.by_point(sets), axis=1)

    def _ranges(self, sets: Sets, logs: np.ndarray) -> np.ndarray:
        """Return what signs and limits add to the log weight of each set, at its likeliest point."""
        every, added = self.table.regressors, np.zeros(len(sets))
        totals = np.logaddexp.reduce(logs, axis=1)
        open_ = np.array([any(every[i].ranged for i in each) for each in sets], dtype=bool)
        while True:
            # What makes the likeliest set impossible brings others near.
            own = np.flatnonzero(open_ & (totals + added > np.max(totals + added) - FAR))
            if not len(own):
                return added
            added[own] = self._ranged([sets[k] for k in own.tolist()], np.argmax(logs[own], axis=1))
            open_[own] = False

    def _ranged(self, sets: Sets, best: Int[np.ndarray, " n_set"]) -> Float[np.ndarray, " n_set"]:
        """Return what signs and limits add, each set at a point of its own."""
        every, added = self.table.regressors, np.zeros(len(sets))
        found = modes(self.products, self.precision, sets, best, self.floor)
        places: dict[int, list[tuple[int, float, float]]] = {}
        for k, (members, mean, covariance) in enumerate(zip(sets, found.mean, found.covariance, strict=True)):
            for place, i in enumerate(members):
                if every[i].ranged:
                    sd = float(np.sqrt(max(covariance[place, place], 0.0)))
                    places.setdefault(i, []).append((k, float(mean[place]), sd))
        for i, items in places.items():
            rows, mean, sd = (np.array(x) for x in zip(*items, strict=True))
            np.add.at(added, rows, log_ranges((every[i],), mean[:, None], sd[:, None])[:, 0])
        return added


def _apart(products: np.ndarray, members: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of each member's size that the other members cannot take over, and the sums that are that part.

    √(1 − R²), 1 − R² = 1/(G_ii (G⁻¹)_ii), and x_i less its projection on the others, Σ_j x_j (G⁻¹)_ij/(G⁻¹)_ii. Columns
    that nearly cancel each other are large and say little.

    Args:
        products: Of the columns under white noise, the target first.
        members: Regressors of a set.
    """
    at = np.array(members, dtype=int) + 1
    G = products[np.ix_(at, at)]
    root = 1 / np.sqrt(np.diag(G))
    inverse = np.linalg.inv(G * np.outer(root, root) + RIDGE * np.eye(len(at)))
    own = np.diag(inverse)
    return np.sqrt(np.clip(1 / own, 0.0, 1.0)), inverse * np.outer(1 / (root * own), root)

"""The table of hypotheses: inclusion sets with their probability, coefficients, discrepancy and agreement."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from bayes_greybox.discovery.odds import Odds
from bayes_greybox.discovery.ties import ranked

from .latent_force import LatentForce
from .log_evidence import UNIT_RIDGE, Gram, gram, log_evidences, modes
from .points import DISCREPANCIES, GAP_RATIOS, LATENT_FORCE, LAW, UNNAMED, NoiseGrid
from .residuals import Band, Residuals, bagged
from .sets import Reach, Set, SetPrior, Sets, Window, log_ranges, search
from .table import FREE, RegressorTable

LEAST_NOISE, RANGES_WINDOW = 1e-6, 30.0
"""Least first guess of the noise over the RMS of the gap; nats within which signs and limits are weighed."""


@dataclass(frozen=True)
class Hypothesis:
    """One inclusion set, summed over every discrepancy that may be beside it.

    Attributes:
        agreement: Probability averaged over bagged records.
        kinds, memories, points: Probabilities of each discrepancy, memory and noise point, given the set.
        point: Its likeliest noise point, where `noise`, `mean` and `covariance` are taken.
        sizes: RMS of the part of each regressor's contribution that the others of the set cannot explain.
        left: RMS of the smoothed discrepancy, apart from the user's own terms of any size, times the root of the
            probability that there is one.
        beside: RMS of the part of that discrepancy in the band of each regressor, times the same root.
        against: Mean product of the contribution in `sizes` and the whole discrepancy, times that probability; negative
            where the two cancel.
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
        """Return the hypothesis with only the regressors at these places, and unchanged coefficients."""
        kept = list(places)
        members = tuple(self.members[k] for k in kept)
        return replace(
            self, members=members, mean=self.mean[kept], covariance=self.covariance[np.ix_(kept, kept)],
            sizes=self.sizes[kept], beside=self.beside[kept], against=self.against[kept],
        )  # fmt: skip

    @property
    def complete(self) -> bool:
        """Return true if it probably has no unnamed discrepancy beside it."""
        return sum(self.kinds[kind] for kind in UNNAMED) < 0.5

    @property
    def sd(self) -> Float[np.ndarray, " k"]:
        """Return the posterior standard deviations of its coefficients."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))


@dataclass(frozen=True, eq=False)
class Weighed:
    """All hypotheses of one table, with the log likelihood of each block of the record at each one's mode.

    Attributes:
        outside: Upper bound of the log weight of a hypothesis that was weighed and is not kept.
    """

    table: RegressorTable
    forces: tuple[LatentForce, ...]
    grid: Gram
    precision: Float[np.ndarray, " n_column"]
    floor: float
    hypotheses: tuple[Hypothesis, ...]
    blocks: Float[np.ndarray, "n_hypothesis n_block"]
    prior: SetPrior
    outside: float = -np.inf

    def reweighted(self, shifts: Sequence[float], seed: int) -> "Weighed":
        """Return the hypotheses with shifted log weights; the seed is that of the bagged records."""
        if not np.any(shifts):
            return self
        weights = np.array([h.log_weight for h in self.hypotheses]) + np.asarray(shifts, float)
        probability = np.exp(weights - np.logaddexp.reduce(weights))
        agreement = bagged(self.blocks, probability, seed)
        order = ranked(range(len(weights)), lambda k: float(weights[k]))
        ordered = [(self.hypotheses[k], float(weights[k]), float(probability[k]), float(agreement[k])) for k in order]
        hypotheses = tuple(replace(h, log_weight=w, probability=p, agreement=a) for h, w, p, a in ordered)
        return replace(self, hypotheses=hypotheses, blocks=self.blocks[order])

    def without_discrepancy(self, reach: Reach, seed: int) -> "Weighed":
        """Return the hypotheses that leave nothing without a name, weighed among themselves on the same products."""
        return _weighed(self._complete, self.forces, reach, seed)

    def likeliest_among(self, regressors: Sequence[int], reach: Reach) -> tuple[Set, float]:
        """Return the likeliest set of some regressors that leaves nothing without a name, with its log weight."""
        weight = self._complete
        members = search(self.table.regressors, weight.total, reach, regressors)[0]
        return members, float(weight.total([members])[0])

    @cached_property
    def _complete(self) -> "_Weight":
        grid, kept = self.grid, [k for k, point in enumerate(self.grid.points) if not point.unnamed]
        points = tuple(grid.points[k] for k in kept)
        products = replace(grid, points=points, products=grid.products[kept], log_det=grid.log_det[kept])
        return _Weight(self.table, products, self.precision, self.prior, self.floor, 0)

    @property
    def gap_square(self) -> float:
        """Return the mean square of the gap as a force, in scaled units."""
        return float(np.mean(self.table.target**2)) * self.table.force.gap**2

    @property
    def before(self) -> Hypothesis:
        """Return the hypothesis with the user's own terms alone."""
        free = self.table.of_kind(FREE)
        return next(h for h in self.hypotheses if h.members == free)

    def white(self, hypothesis: Hypothesis) -> Float[np.ndarray, " n_white"]:
        """Return the whitened residual of a hypothesis at its likeliest noise point with white, normal noise."""
        number, residual, v = self._likeliest(hypothesis, [point.shape == 0 for point in self.grid.points])
        return self._residuals.white(number, residual)[0][:, 0] / np.sqrt(v)

    def standardised(self, hypothesis: Hypothesis) -> Float[np.ndarray, " n_white"]:
        """Return leave-one-out residuals at a hypothesis's mode, each over its predictive standard deviation.

        z_i = e_i / (√v √(1 − h_i)), e the whitened residual and h the leverage of the columns.
        """
        columns = self.table.columns[:, list(hypothesis.members)]
        residual = self.table.target - columns @ hypothesis.mean
        white = self._residuals.white(hypothesis.point, np.column_stack([residual, columns]))[0]
        X = white[:, 1:]
        leverage = np.clip(np.einsum("ij,jk,ik->i", X, hypothesis.covariance, X) / hypothesis.noise**2, 0.0, 0.99)
        return white[:, 0] / (hypothesis.noise * np.sqrt(1 - leverage))

    def latent_force(self, hypothesis: Hypothesis) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
        """Return mean and SD of the smoothed force beside a hypothesis (a law, where none is weighed), scaled."""
        kinds = [point.kind for point in self.grid.points]
        wanted = LATENT_FORCE if LATENT_FORCE in kinds else LAW
        number, residual, v = self._likeliest(hypothesis, [kind == wanted for kind in kinds])
        mean, variance = self._residuals.smoothed(number, residual)
        return mean[:, 0], np.sqrt(v * variance)

    @cached_property
    def _residuals(self) -> Residuals:
        return Residuals(self.table, self.forces, self.grid.points)

    def _likeliest(self, hypothesis: Hypothesis, allowed: Sequence[bool]) -> tuple[int, np.ndarray, float]:
        """Return the likeliest of the allowed noise points, with the residual and v at the mode there."""
        number = int(np.argmax(np.where(allowed, hypothesis.points, -1.0)))
        mode = modes(self.grid, self.precision, [hypothesis.members], np.array([number]), self.floor)
        residual = self.table.target - self.table.columns[:, list(hypothesis.members)] @ mode.mean[0]
        return number, residual[:, None], float(mode.v[0])


def weigh(
    table: RegressorTable, odds: Odds, reach: Reach, floor: float, shapes: Sequence[tuple[LatentForce, float]] = (),
    seed: int = 0, window: Window | None = None,
) -> Weighed:  # fmt: skip
    """Return the hypotheses of a table; `shapes` are forces and log priors of noise shapes, `floor` the least v."""
    forces, regressors = (table.force, *(force for force, _ in shapes)), table.regressors
    prior = SetPrior.of(regressors, odds, reach.effects) if window is None else window.prior
    # Fewer effects and sensor errors have the prior of all.
    prior = replace(prior, regressors=regressors)
    points = _noise_grid(table, odds, floor, window).points((0.0, *(log_prior for _, log_prior in shapes)))
    if window is not None and window.complete:
        points = tuple(point for point in points if not point.unnamed)
    n_unnamed = len({point.kind for point in points} & set(UNNAMED))
    points = tuple(point for point in points if not point.memory or point.memory in table.memories)
    precision = np.array([each.sd**-2.0 for each in regressors])
    weight = _Weight(table, gram(table, points, forces), precision, prior, floor, n_unnamed)
    return _weighed(weight, forces, reach, seed)


def _weighed(weight: "_Weight", forces: tuple[LatentForce, ...], reach: Reach, seed: int) -> Weighed:
    table, precision, floor, prior = weight.table, weight.precision, weight.floor, weight.prior
    regressors, points = table.regressors, weight.products.points
    sets = search(regressors, weight.total, reach)
    n_kept = len(sets)
    # The user's model is always one of them: the gap is its residual.
    before = table.of_kind(FREE)
    sets += [before] if before not in sets else []
    logs = weight.by_point(sets)
    totals = np.logaddexp.reduce(logs, axis=1)
    full = n_kept >= reach.kept
    outside = float(np.min(totals[:n_kept]) if full else np.max(totals[:n_kept]) - reach.window)
    probability = np.exp(totals - np.logaddexp.reduce(totals))
    best = np.argmax(logs, axis=1)
    mode = modes(weight.products, precision, sets, best, floor)
    fitted = [table.columns[:, list(members)] @ mean for members, mean in zip(sets, mode.mean, strict=True)]
    residuals = np.column_stack([table.target - each for each in fitted])
    split = Residuals(table, forces, points)
    block_logs = split.block_logs(best, residuals, mode.v)
    agreement = bagged(block_logs, probability, seed)
    discrepancy = split.discrepancies(logs, residuals)
    # What the terms of any size can explain is no discrepancy.
    own = table.acting[:, list(table.own)]
    discrepancy = discrepancy - own @ np.linalg.lstsq(own, discrepancy, rcond=1e-12)[0]
    left, overlap = np.sqrt(np.mean(discrepancy**2, axis=0)), table.acting.T @ discrepancy / len(discrepancy)
    band = Band(table.acting, discrepancy)
    of_kind = {kind: np.array([p.kind == kind for p in points]) for kind in DISCREPANCIES}
    of_memory = {memory: np.array([p.memory == memory for p in points]) for memory in table.memories}
    hypotheses = []
    for k, members in enumerate(sets):
        share, mean = np.exp(logs[k] - totals[k]), mode.mean[k]
        kinds = {kind: float(share[there].sum()) for kind, there in of_kind.items()}
        memories = {memory: float(share[there].sum()) for memory, there in of_memory.items()}
        apart, alone = _apart(weight.products.products[0], members)
        unnamed = sum(kinds[kind] for kind in UNNAMED)
        hypotheses.append(
            Hypothesis(
                members, float(totals[k]), float(probability[k]), float(agreement[k]), kinds, memories, share,
                int(best[k]), float(np.sqrt(mode.v[k])), mean, mode.covariance[k], sizes=np.abs(mean) * apart,
                left=float(left[k] * np.sqrt(unnamed)),
                beside=left[k] * np.sqrt(unnamed * band.share(k, members, alone)),
                against=unnamed * mean * (alone @ overlap[list(members), k]),
            )
        )  # fmt: skip
    return Weighed(table, forces, weight.products, precision, floor, tuple(hypotheses), block_logs, prior, outside)


def _noise_grid(table: RegressorTable, odds: Odds, floor: float, window: Window | None) -> NoiseGrid:
    """Return the noise grid of a table; its ratios are relative to a first guess of the noise."""
    force = table.force
    noise = max(force.noise, np.sqrt(floor), LEAST_NOISE * force.gap)
    return NoiseGrid(
        force.period, force.step, GAP_RATIOS * force.gap / noise, GAP_RATIOS / noise,
        odds.noise if force.forced else None, table.law.rows.shape[1] > 0,
        tuple(table.memories) if window is None else window.memories, force.sensor_scales,
    )  # fmt: skip


@dataclass(frozen=True)
class _Weight:
    table: RegressorTable
    products: Gram
    precision: np.ndarray
    prior: SetPrior
    floor: float
    n_unnamed: int

    @cached_property
    def _on_grid(self) -> tuple[np.ndarray, np.ndarray]:
        """Return each log prior, given whether the point has an unnamed discrepancy, and true where it has."""
        points = self.products.points
        unnamed = np.array([point.unnamed for point in points])
        log_prior = np.array([point.log_prior for point in points])
        log_prior = log_prior - np.where(unnamed, np.log(max(self.n_unnamed, 1)), 0.0)
        return log_prior - np.logaddexp.reduce(log_prior[~unnamed]), unnamed

    def by_point(self, sets: Sets) -> Float[np.ndarray, "n_set n_point"]:
        on_grid, unnamed = self._on_grid
        log_prior = self.prior.logs(sets)
        logs = log_evidences(self.products, self.precision, sets, self.floor)
        logs = logs + on_grid + np.where(unnamed, log_prior[:, 1:], log_prior[:, :1])
        return logs + self._ranges(sets, logs)[:, None]

    def total(self, sets: Sets) -> Float[np.ndarray, " n_set"]:
        return np.logaddexp.reduce(self.by_point(sets), axis=1)

    def _ranges(self, sets: Sets, logs: np.ndarray) -> np.ndarray:
        """Return the change of each log weight due to signs and limits, at the set's likeliest point."""
        regressors, added = self.table.regressors, np.zeros(len(sets))
        totals = np.logaddexp.reduce(logs, axis=1)
        waiting = np.array([any(regressors[i].ranged for i in each) for each in sets], dtype=bool)
        while True:
            # If the likeliest set proves impossible, others come within reach.
            places = np.flatnonzero(waiting & (totals + added > np.max(totals + added) - RANGES_WINDOW))
            if not len(places):
                return added
            chosen = [sets[k] for k in places.tolist()]
            mode = modes(self.products, self.precision, chosen, np.argmax(logs[places], axis=1), self.floor)
            by_regressor: dict[int, list[tuple[int, float, float]]] = {}
            for k, members, mean, covariance in zip(places.tolist(), chosen, mode.mean, mode.covariance, strict=True):
                for place, i in enumerate(members):
                    if regressors[i].ranged:
                        sd = float(np.sqrt(max(covariance[place, place], 0.0)))
                        by_regressor.setdefault(i, []).append((k, float(mean[place]), sd))
            for i, items in by_regressor.items():
                rows, mean, sd = (np.array(x) for x in zip(*items, strict=True))
                added[rows] += log_ranges(regressors[i], mean, sd)
            waiting[places] = False


def _apart(products: np.ndarray, members: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of each member's size that the others cannot explain, and the weights of that part.

    √(1 − R²), 1 − R² = 1/(G_ii (G⁻¹)_ii), and x_i less its projection on the others, Σ_j x_j (G⁻¹)_ij/(G⁻¹)_ii. Columns
    that nearly cancel each other are large and say little. The products are those under white noise, the target first.
    """
    at = np.array(members, dtype=int) + 1
    G = products[np.ix_(at, at)]
    root = 1 / np.sqrt(np.diag(G))
    inverse = np.linalg.inv(G * np.outer(root, root) + UNIT_RIDGE * np.eye(len(at)))
    diagonal = np.diag(inverse)
    return np.sqrt(np.clip(1 / diagonal, 0.0, 1.0)), inverse * np.outer(1 / (root * diagonal), root)

"""Predictions of every hypothesis for candidates, and what these say about which hypothesis holds, in closed form.

Near its mean, hypothesis i predicts y ~ N(m_i, S_i), S_i = I + A_iᵀA_i, over the noise; A_i has one row for each latent
of its coefficients' posterior, so that only differences beyond a refit count. The information about the hypothesis is
at least (Kolchinsky & Tracey 2017, eq. 10, with the Bhattacharyya distance)

    I(M; y) ≥ −Σ_i p_i log Σ_j p_j exp(−C_ij),   C_ij = ⅛ dᵀS⁻¹d + ½ log|S| − ¼ log|S_i| − ¼ log|S_j|,

d = m_i − m_j, S = (S_i + S_j)/2.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from bayes_greybox.data.columns import derivative_label
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.answer.explained import Component, Explained
from bayes_greybox.discovery.answer.interval import INTERVAL, INTERVAL_ENDS
from bayes_greybox.physics.experiments.candidate import Candidate
from bayes_greybox.physics.integration.side_by_side import Added, run_with, stage_times, steps_needed
from bayes_greybox.physics.simulation.protocol import Simulation
from bayes_greybox.physics.units import derivative_unit

TOO_UNCERTAIN = 1e6
"""Noise standard deviations at which residuals are cut off, and from which on uncertain rows do not count."""


class Information(NamedTuple):
    """An expected information in bits, with its standard error: zero, where it is a closed form."""

    bits: float
    error: float = 0.0


class Response(NamedTuple):
    """Prediction of one hypothesis: m, rows of A of coefficients, and rows of A of an experiment's own start."""

    mean: Float[np.ndarray, " n_row"]
    load: Float[np.ndarray, "n_latent n_row"]
    start: Float[np.ndarray, "n_start n_row"]


def together(each: Sequence[Response]) -> Response:
    """Return the prediction of several experiments."""
    means, loads, starts = zip(*each, strict=True)
    return Response(np.concatenate(means), np.hstack(loads), np.asarray(block_diag(*starts)))


def distance(one: Response, other: Response) -> float:
    """Return the Bhattacharyya distance C of two predictions, in nats."""
    A, B = (np.vstack([each.load, each.start]) for each in (one, other))
    d = one.mean - other.mean
    sure = np.isfinite(d) & np.all(np.abs(np.vstack([A, B])) < TOO_UNCERTAIN, axis=0)
    A, B, d = A[:, sure], B[:, sure], np.clip(d[sure], -TOO_UNCERTAIN, TOO_UNCERTAIN)
    # Along right singular vectors of both loads S is 1 + s², and 1 elsewhere.
    _, s, V = np.linalg.svd(np.vstack([A, B]) / np.sqrt(2), full_matrices=False)
    left, logs = d - (V @ d) @ V, [np.linalg.slogdet(np.eye(len(L)) + L @ L.T)[1] for L in (A, B)]
    squares = left @ left + np.sum((V @ d) ** 2 / (1 + s**2))
    return float(squares / 8 + np.sum(np.log1p(s**2)) / 2 - sum(logs) / 4)


def information(responses: Sequence[Sequence[Response]], p: Float[np.ndarray, " n"]) -> float:
    """Return the information in bits, of predictions of all hypotheses along the path of each, by probabilities p."""
    overlaps = [[np.exp(-distance(each[i], other)) for other in each] for i, each in enumerate(responses)]
    return float(-p @ np.log2(np.array(overlaps) @ p))


SMALL_STEP, UNSEEN_START = 0.1, 0.05
"""Standard deviations over which derivatives are taken; deviation of an unseen start, over its range in the data."""

FAILED_SIZE, SIDE_BY_SIDE = 1e3, 4_000_000
"""Size of a state that has failed, over its largest in the data; most samples simulated side by side: memory."""


@dataclass(frozen=True)
class Responses:
    """One experiment under each explanation.

    Attributes:
        bands: Quantiles 5, 50 and 95 % of each channel without noise; NaN where runs have failed.
        labels: State that each channel shows, or its rate.
        fails: Largest share of runs that fail under an explanation.
        reach: Distance of runs from the middle of the data's range, over half of it (95 % quantile), by column.
        resolved: True if the steps follow its paths.
    """

    candidate: Candidate
    names: tuple[str, ...]
    probability: Float[np.ndarray, " n_explanation"]
    bands: Mapping[str, Float[np.ndarray, "n_explanation 3 n_row"]]
    labels: Mapping[str, str]
    units: Mapping[str, str]
    predictions: Sequence[Sequence[Response]] = field(repr=False)
    fails: float
    reach: Mapping[str, float]
    resolved: bool


@dataclass(frozen=True)
class Predictor:
    """Predicts candidates under explanations, each by its likeliest hypothesis with `outcomes` runs.

    With `rates` sensors show rates, from known starts; else samples of states, from starts that they show.
    """

    explanations: Sequence[Explained]
    simulation: Simulation
    data: Trajectories
    rates: bool
    outcomes: int
    seed: int

    @cached_property
    def hypotheses(self) -> list[Component]:
        """Return the likeliest hypothesis of each explanation."""
        return [max(e.components, key=lambda c: c.weight) for e in self.explanations]

    @property
    def probability(self) -> Float[np.ndarray, " n_explanation"]:
        """Return the probabilities of the explanations among each other."""
        p = np.array([e.probability for e in self.explanations])
        return p / np.sum(p)

    def predict(self, candidates: Sequence[Candidate]) -> list[Responses]:
        """Return predictions of candidates; those that are sampled at the same times are simulated side by side."""
        found, latents = {}, [self._latents(h) for h in range(len(self.hypotheses))]
        range_ = np.array([np.ptp(self.data.states[name]) or 1.0 for name in self.simulation.states])
        for length in dict.fromkeys((c.duration, c.rows) for c in candidates):
            left = [i for i, c in enumerate(candidates) if (c.duration, c.rows) == length]
            while left:
                n = max(1, SIDE_BY_SIDE // (length[1] * sum(map(len, latents))))
                own, left = left[:n], left[n:]
                follow = partial(self._follow, [candidates[i] for i in own])
                means = partial(follow, latents=[z[:1] for z in latents])
                steps, resolved = steps_needed(lambda n, means=means: np.stack(means(n), axis=1), range_)
                paths = follow(steps, latents)
                for k, i in enumerate(own):
                    with np.errstate(all="ignore"):
                        found[i] = self._predicted(candidates[i], [each[k] for each in paths], resolved[k])
        return [found[i] for i in range(len(candidates))]

    def _latents(self, h: int) -> np.ndarray:
        """Return runs in standard deviations of coefficients and of the start: the mean, small steps, draws."""
        k = len(self.hypotheses[h].root) + len(self.simulation.states)
        draws = np.random.default_rng([self.seed, h]).standard_normal((self.outcomes, k))
        return np.vstack([np.zeros((1, k)), SMALL_STEP * np.eye(k), draws])

    def _added(self, h: int, latents: np.ndarray) -> Added:
        c, names = self.hypotheses[h], self.simulation.states
        terms = [term.rounded(self.data.columns) for term in c.terms]
        theta = c.mean + latents[:, : len(c.root)] @ c.root
        return Added(list(zip(map(names.index, c.equations), terms, strict=True)), theta.T)

    def _follow(self, candidates: Sequence[Candidate], steps: int, latents: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Return paths [n_candidate, n_run, n_row, d] under each hypothesis; NaN from where a run has failed."""
        names, times, values = self.simulation.states, candidates[0].times, self.data.states
        stages = stage_times(times, steps)
        inputs = np.zeros((len(candidates), len(stages), len(self.simulation.inputs)))
        for i, candidate in enumerate(candidates):
            for j, name in enumerate(self.simulation.inputs):
                inputs[i, :, j] = candidate.inputs[name].value(stages)
        first = np.array([[c.start[name] for name in names] for c in candidates], float)[:, None]
        sd = np.array([[c.sensors.get(n, UNSEEN_START * np.ptp(values[n])) for n in names] for c in candidates])
        moved = 0.0 if self.rates else sd[:, None]
        starts = [first + moved * z[:, len(c.root) :] for c, z in zip(self.hypotheses, latents, strict=True)]
        limit = np.array([FAILED_SIZE * (float(np.max(np.abs(values[name]))) or 1.0) for name in names])
        systems = [self._added(h, z) for h, z in enumerate(latents)]
        return run_with(self.simulation, systems, starts, times, inputs, limit)

    def _shown(self, h: int, latents: np.ndarray, candidate: Candidate, paths: np.ndarray) -> np.ndarray:
        """Return the sensors' noise-free readings along paths [n_sensor, n_run, n_row]: states, or rates there."""
        names, values = self.simulation.states, paths
        if self.rates:
            t = np.broadcast_to(candidate.times, paths.shape[:2])
            columns = dict(zip(names, np.moveaxis(paths, -1, 0), strict=True))
            columns |= {name: np.broadcast_to(signal.value(t[0]), t.shape) for name, signal in candidate.inputs.items()}
            u = np.stack([columns[name] for name in self.simulation.inputs] or [t], axis=-1)
            values = self.simulation.rates(t, paths, u[..., : len(self.simulation.inputs)])
            for (i, term), theta in zip(*self._added(h, latents), strict=True):
                values[..., i] += theta[:, None] * term.evaluate(columns)
        return np.stack([values[..., names.index(name)] for name in candidate.sensors])

    def _response(self, h: int, candidate: Candidate, along: np.ndarray) -> Response:
        """Return the prediction of a hypothesis by small steps: along one path, or along the path of each."""
        latents, k = self._latents(h)[: -self.outcomes], len(self.hypotheses[h].root)
        paths = np.repeat(along[:1], len(latents), axis=0) if self.rates else along[: len(latents)]
        sd = np.array(list(candidate.sensors.values()))[:, None, None]
        shown = np.concatenate(list(self._shown(h, latents, candidate, paths) / sd), axis=-1)
        by = (shown[1:] - shown[0]) / SMALL_STEP
        return Response(shown[0], by[:k], by[k:])

    def _predicted(self, candidate: Candidate, paths: Sequence[np.ndarray], resolved: bool) -> Responses:
        # Given the path, rates are linear in the coefficients; the information of the path itself is not counted.
        along = [[path] * len(paths) for path in paths] if self.rates else [paths] * len(paths)
        responses = [[self._response(h, candidate, own) for h, own in enumerate(each)] for each in along]
        bands = {name: np.full((len(paths), 3, candidate.rows), np.nan) for name in candidate.sensors}
        drawn = np.stack([path[-self.outcomes :] for path in paths])
        quantiles = (INTERVAL_ENDS[0], 0.5, INTERVAL_ENDS[1])
        for h, own in enumerate(drawn):
            shown = self._shown(h, self._latents(h)[-self.outcomes :], candidate, own)
            for name, values in zip(bands, shown, strict=True):
                # A run that failed shows nothing from there on.
                whole = np.mean(np.isfinite(values), axis=0) >= INTERVAL
                bands[name][h][:, whole] = np.nanquantile(values[:, whole], quantiles, axis=0)
        fails = float(np.max(np.mean(~np.all(np.isfinite(drawn), axis=(2, 3)), axis=1)))
        runs = dict(zip(self.simulation.states, np.moveaxis(np.concatenate(drawn), -1, 0), strict=True))
        runs |= {name: signal.value(candidate.times)[None] for name, signal in candidate.inputs.items()}
        reach = {name: _reach(self.data.column(name), values) for name, values in runs.items()}
        units = {name: self.data.units.get(name, "") for name in ("t", *bands)}
        units |= {name: derivative_unit(name, self.data.units) for name in bands if self.rates}
        labels = {name: derivative_label(name) if self.rates else name for name in bands}
        names, p = tuple(e.name for e in self.explanations), self.probability
        return Responses(candidate, names, p, bands, labels, units, responses, fails, reach, resolved)


def _reach(measured: np.ndarray, values: np.ndarray) -> float:
    """Return the 95 % quantile over runs, which may be infinite: any motion is beyond what never moved."""
    middle, half = 0.5 * (np.min(measured) + np.max(measured)), 0.5 * np.ptp(measured)
    far = np.nanmax(np.abs(values - middle), axis=1)
    return float(np.nanquantile(far / half if half > 0 else np.where(far > 0, np.inf, 0.0), 0.95, method="higher"))

"""The cases: which effect is hidden in which host, how large, and under how much noise; all from one seed."""

import hashlib
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float

from bayes_greybox.running.errors import InputError

from .systems.hidden import CATALOGUE, OFF_CATALOGUE
from .systems.hosts import HOSTS, Host

HIDDEN_FAMILIES = ("catalogue", "null", "mis-calibrated", "off-catalogue", "two effects")
"""Kinds of cases."""

NOISE = (0.01, 0.05, 0.2)
"""Standard deviation of the measured derivative's noise over the RMS of the true derivative."""

LARGEST_SHARE = 0.8
"""No effect is asked to have more than this share of the RMS of the derivative that it is a part of."""

RATIO_EDGES = (0.3, 4.0, 16.0, 30.0)
"""Ranges of the ratio, RMS of the effect over RMS of the noise, that all, the two lower and the lowest level allow."""

RATIO_SHARES: Mapping[float, tuple[float, float, float]] = {
    0.01: (0.342, 0.249, 0.409),
    0.05: (0.345, 0.655, 0.0),
    0.2: (1.0, 0.0, 0.0),
}
"""Shares of these ranges by noise level, log-uniform within each of them: the ratio is log-uniform over all cases."""

LEAST_IN_PAIRS = 2.0
"""Least ratio of either of two effects hidden at once."""

NULLS, MISCALIBRATED, OFF = 45, 42, 45
"""Numbers of cases of these families."""

ROOM: Mapping[str, tuple[str, ...]] = {
    "mechanical": (
        *("free-oscillator", "forced-oscillator", "free-chain"),
        *("swept-oscillator", "free-oscillator", "forced-chain"),
    ),
    "fluid": ("tank", "lower-tank", "seeping-tank", "draining-tank"),
    "population": ("rivals", "culture", "prey", "visited"),
    "electrical": ("rc", "series-rlc", "rl", "parallel-rlc"),
}
"""Hosts that effects of a domain are hidden in, two at a time, unless `HOSTS_OF` says where."""

HOSTS_OF: Mapping[str, Mapping[str, tuple[str, str]]] = {
    "mechanical": {
        "linear-stiffness": ("free-hard-spring", "forced-hard-spring"),
        "viscous-damping": ("free-drag-oscillator", "forced-drag-oscillator"),
        "input-gain": ("unmodelled-force", "chain-with-unmodelled-force"),
        "cubic-input": ("swept-oscillator", "forced-chain"),
        "squared-input": ("swept-oscillator", "forced-chain"),
        "coupling-stiffness": ("free-unlinked-chain", "forced-unlinked-chain"),
        "coupling-damping": ("free-unlinked-chain", "forced-unlinked-chain"),
        "cubic-coupling-stiffness": ("free-chain", "forced-unlinked-chain"),
    },
    "fluid": {
        "linear-outflow": ("tank", "draining-tank"),
        "torricelli-outflow": ("seeping-tank", "draining-seeping-tank"),
        "linear-inflow": ("twin-tank", "seeping-twin-tank"),
        "torricelli-inflow": ("twin-tank", "seeping-lower-tank"),
        "overflow-inflow": ("lower-tank", "twin-tank"),
        "connecting-pipe": ("twin-tank", "seeping-twin-tank"),
        "input-gain": ("unmodelled-pump", "seeping-tank-with-unmodelled-pump"),
        "cubic-input": ("tank", "seeping-tank"),
        "squared-input": ("tank", "seeping-tank"),
    },
    "population": {
        "linear-growth": ("crowded-culture", "grazed"),
        "logistic-crowding": ("prey", "culture"),
        "bilinear-interaction": ("rivals", "visited"),
        "holling-ii": ("prey", "visited"),
        "holling-ii-gain": ("predators", "rivals"),
        "holling-iii": ("rivals", "prey"),
        "holling-iii-gain": ("predators", "visited"),
        "migration": ("rivals", "visited"),
        "driven-growth": ("culture", "visited"),
    },
    "electrical": {
        "ohmic-loss": ("varistor-rc", "lossless-series"),
        "diode": ("rc", "parallel-rlc"),
        "diode-pair": ("rc", "parallel-rlc"),
        "brush-drop": ("rl", "series-rlc"),
        "saturating-inductor": ("rl-flux", "parallel-rlc"),
        "cubic-storage": ("series-rlc", "discharging-rlc"),
        "inductance-drop": ("rl", "series-rlc"),
        "input-gain": ("unmodelled-source", "parallel-with-unmodelled-source"),
        "cubic-input": ("rl", "parallel-rlc"),
    },
}
"""Hosts of the effects that not every host can show: those that have the effect in their simulation cannot."""

PAIRS = (
    ("forced-oscillator", "cubic-stiffness", "coulomb-friction"),
    ("free-oscillator", "cubic-stiffness", "quadratic-drag"),
    ("swept-oscillator", "quadratic-stiffness", "cubic-damping"),
    ("forced-chain", "dead-zone", "quadratic-drag"),
    ("forced-oscillator", "bilinear-stiffness", "van-der-pol-damping"),
    ("swept-oscillator", "cubic-input", "cubic-stiffness"),
    ("forced-hard-spring", "quadratic-drag", "constant-force"),
    ("free-chain", "constant-force", "cubic-stiffness"),
    ("unmodelled-force", "input-gain", "quadratic-stiffness"),
    ("forced-unlinked-chain", "coupling-stiffness", "quadratic-drag"),
    ("lower-tank", "overflow-inflow", "cubic-input"),
    ("twin-tank", "overflow", "connecting-pipe"),
    ("prey", "logistic-crowding", "migration"),
    ("visited", "migration", "driven-growth"),
    ("series-rlc", "cubic-resistor", "constant-source"),
    ("parallel-rlc", "saturating-inductor", "cubic-input"),
)
"""Pairs of effects hidden at once, each twice."""


@dataclass(frozen=True)
class HiddenCase:
    """One case; the same case gives the same data.

    Attributes:
        family: One of `HIDDEN_FAMILIES`.
        host: Name of the host, a key of `HOSTS`.
        effects: Slugs of the hidden effects, or one shape that is in no catalogue.
        ratios: Wanted RMS of each effect over that of the noise.
        noise: Standard deviation of the noise over the RMS of the true derivative.
        seed: Seed of everything random in the data.
    """

    family: str
    host: str
    effects: tuple[str, ...]
    ratios: tuple[float, ...]
    noise: float
    seed: int

    def __post_init__(self) -> None:
        if self.family not in HIDDEN_FAMILIES:
            raise InputError(f"There is no family {self.family!r} of cases; there are {', '.join(HIDDEN_FAMILIES)}.")
        if self.host not in HOSTS:
            raise InputError(f"There is no host {self.host!r}; there are {', '.join(HOSTS)}.")
        if len(self.effects) != len(self.ratios):
            raise InputError("A case needs one ratio for each of its effects.")

    @property
    def system(self) -> Host:
        """The host."""
        return HOSTS[self.host]

    @property
    def key(self) -> str:
        """Name that tells the case from all others, those of other seeds and ratios included."""
        digest = hashlib.sha1(json.dumps(asdict(self)).encode(), usedforsecurity=False).hexdigest()
        return "/".join((self.family, self.host, "+".join(self.effects) or "-", f"{self.noise:g}", digest[:8]))


def all_cases(seed: int = 0, crossed: bool = False) -> tuple[HiddenCase, ...]:
    """Return the benchmark's cases.

    Args:
        seed: Seed of ratios, coefficients, starts, excitation and noise.
        crossed: Hide every effect of the catalogue in both its hosts at every noise level, six cases each; by
            default four, in which it meets both hosts and every level.
    """
    rng = np.random.default_rng(seed)
    single = _with_ratios([*_catalogue(crossed)], rng)
    off = _with_ratios([*_off_catalogue()], rng)
    rest = [*_spread("null", NULLS), *_spread("mis-calibrated", MISCALIBRATED)]
    cases = [*single, *rest, *off, *_pairs(rng)]
    # From what the case is, not from its place: a longer list leaves the data of the others as they are.
    counts: dict[str, int] = {}
    numbered = []
    for case in cases:
        label = f"{seed} {case.family} {case.host} {case.effects} {case.noise}"
        counts[label] = counts.get(label, 0) + 1
        numbered.append(replace(case, seed=zlib.crc32(f"{label} {counts[label]}".encode())))
    return tuple(numbered)


def subset(cases: Sequence[Any], count: int = 30, seed: int = 0) -> tuple[Any, ...]:
    """Choose so many cases with the same mix: each family by its share, at least one of each, spread over its hosts."""
    if count >= len(cases):
        return tuple(cases)
    rng = np.random.default_rng(seed)
    chosen: list[int] = []
    for family in dict.fromkeys(case.family for case in cases):
        members = [i for i, case in enumerate(cases) if case.family == family]
        wanted = min(len(members), max(1, round(count * len(members) / len(cases))))
        for turn, part in enumerate(np.array_split(members, wanted)):
            # One from each stretch of the list, which runs through the domains; noise levels take turns.
            level = [i for i in part if cases[i].noise == NOISE[turn % len(NOISE)]]
            chosen.append(int(rng.choice(level or part)))
    return tuple(cases[i] for i in sorted(chosen))


def ratio_density(noise: float, log_ratio: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Return the density of the logarithm of the ratio in the family "catalogue", at a noise level.

    Args:
        noise: One of `NOISE`; for other levels the ratio is taken as log-uniform over the whole range.
        log_ratio: Points.
    """
    edges = np.log(RATIO_EDGES)
    shares = np.asarray(RATIO_SHARES.get(noise, np.diff(edges) / (edges[-1] - edges[0])))
    piece = np.clip(np.searchsorted(edges, log_ratio, side="right") - 1, 0, len(shares) - 1)
    inside = (log_ratio >= edges[0]) & (log_ratio <= edges[-1])
    return np.where(inside, (shares / np.diff(edges))[piece], 0.0)


def _catalogue(crossed: bool) -> Iterator[HiddenCase]:
    turn = 0
    for domain, effects in CATALOGUE.items():
        rooms = ROOM[domain]
        for i, effect in enumerate(effects.values()):
            usual = (rooms[2 * i % len(rooms)], rooms[(2 * i + 1) % len(rooms)])
            first, second = HOSTS_OF[domain].get(effect.slug, usual)
            visits = [(first, NOISE[0]), (second, NOISE[1]), (first, NOISE[2]), (second, NOISE[turn % 3])]
            if turn % 3 == 1:
                visits[-1] = (first, NOISE[1])
            turn += 1
            if crossed:
                visits = [(host, noise) for host in (first, second) for noise in NOISE]
            yield from (HiddenCase("catalogue", host, (effect.slug,), (0.0,), noise, 0) for host, noise in visits)


def _off_catalogue() -> Iterator[HiddenCase]:
    places = []
    for domain, shapes in OFF_CATALOGUE.items():
        for name, shape in shapes.items():
            hosts = [h for h in HOSTS.values() if h.domain == domain and shape.fits(h) and h.heeds_input]
            places.append((name, hosts))
    for i in range(OFF):
        name, hosts = places[i % len(places)]
        host = hosts[(3 * (i // len(places)) + i) % len(hosts)]
        yield HiddenCase("off-catalogue", host.name, (name,), (0.0,), NOISE[(i + i // len(places)) % 3], 0)


def _spread(family: str, count: int) -> Iterator[HiddenCase]:
    """Cases without a hidden effect, over all hosts and noise levels."""
    hosts = list(HOSTS)
    for i in range(count):
        yield HiddenCase(family, hosts[i % len(hosts)], (), (), NOISE[(i + i // len(hosts)) % 3], 0)


def _pairs(rng: np.random.Generator) -> Iterator[HiddenCase]:
    for i, (host, *effects) in enumerate(PAIRS * 2):
        noise = NOISE[(i + i // len(PAIRS)) % 3]
        highest = min(RATIO_EDGES[-1], LARGEST_SHARE / np.sqrt(len(effects)) / noise)
        ratios = np.exp(rng.uniform(np.log(LEAST_IN_PAIRS), np.log(highest), len(effects)))
        yield HiddenCase("two effects", host, tuple(effects), tuple(float(r) for r in ratios), noise, 0)


def _with_ratios(cases: list[HiddenCase], rng: np.random.Generator) -> list[HiddenCase]:
    """Draw ratios for cases of one effect, stratified: at each noise level they fill their distribution evenly."""
    given = list(cases)
    edges = np.log(RATIO_EDGES)
    for noise in NOISE:
        places = [i for i, case in enumerate(cases) if case.noise == noise]
        if not places:
            continue
        levels = (rng.permutation(len(places)) + rng.uniform(size=len(places))) / len(places)
        cumulative = np.concatenate([[0.0], np.cumsum(RATIO_SHARES[noise])])
        for i, level in zip(places, levels, strict=True):
            given[i] = replace(cases[i], ratios=(float(np.exp(np.interp(level, cumulative, edges))),))
    return given

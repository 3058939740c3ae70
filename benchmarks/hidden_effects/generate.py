"""The data of a case: coefficients to the wanted ratio, train and test runs, noise, and the truth."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError

from .assumptions.case import AssumptionCase
from .cases import RATIO_EDGES, HiddenCase
from .systems.hidden import find
from .systems.hosts import HOSTS, SPREAD, Host, formula, term_value
from .systems.ode import HostODE, LostError
from .systems.search import Wanted, coefficients
from .systems.trajectories import Excited, Runs, combine, excite, follow, rms

OFF_BY = 0.1
"""Relative error of the coefficient in a mis-calibrated simulation."""

LOWER = (1.0, 0.7, 0.5, 0.35, 0.25, 0.1, 0.03)
"""Shares of the wanted ratio that are tried in turn, with either sign, where the host cannot take the effect."""

SET_UPS = 5
"""Coefficients and inputs of the host that are tried in turn, where it can take them at no size."""


@dataclass(frozen=True)
class Truth:
    """One hidden effect.

    Attributes:
        slug: Its slug, or the name of a shape that is in no catalogue.
        coefficient: Its coefficient.
        inner: Its nonlinear parameter; NaN without one.
        ratio: RMS of its addition to the training data over the noise's standard deviation, as it came out.
        wanted: The ratio that the case asks for; larger than `ratio` only where the host could not take it.
    """

    slug: str
    coefficient: float
    inner: float
    ratio: float
    wanted: float


@dataclass(frozen=True)
class CaseData:
    """Data of a case for a solver, and the truth behind them.

    States and inputs are measured exactly, and every derivative has independent normal noise, unless the case is one of
    a broken assumption.

    Attributes:
        case: The case.
        train: Training data.
        test: Held-out data, from other starts and with other excitation.
        simulation: The simulation as a user writes it, by state; mis-calibrated where the case says so.
        sigma: Standard deviation of the noise on the studied derivative.
        effects: The truth.
        off: Term of the simulation whose coefficient is 10 % off, and the ratio of that; None if all are right.
        true_rates: True coefficients of the simulation's terms, by state.
        given_rates: The coefficients that `simulation` has.
        exact: Exact quantities on the data sets "train" and "test".
        ode: The system with the hidden effects; None for a case of a broken assumption.
        excited: Starts and inputs of the data sets; none for a case of a broken assumption.
    """

    case: HiddenCase | AssumptionCase
    train: Trajectories
    test: Trajectories
    simulation: Mapping[str, str]
    sigma: float
    effects: tuple[Truth, ...]
    off: tuple[str, float] | None
    true_rates: Mapping[str, Mapping[str, float]]
    given_rates: Mapping[str, Mapping[str, float]]
    exact: Mapping[str, Runs]
    ode: HostODE | None = field(default=None, kw_only=True)
    excited: Mapping[str, Excited] = field(default_factory=dict, kw_only=True)

    @property
    def host(self) -> Host:
        """The host system."""
        return self.case.system

    @property
    def equation(self) -> str:
        """The studied state."""
        return self.host.equation

    def measured(self, part: str = "train") -> dict[str, Float[np.ndarray, " n_obs"]]:
        """Return states and inputs as a solver gets them, and the time as "t"."""
        data = self.train if part == "train" else self.test
        return {"t": data.time, **data.columns}

    def gap(self, part: str = "train") -> Float[np.ndarray, " n_obs"]:
        """Return the true derivative less the given simulation, without noise, on "train" or "test"."""
        exact = self.exact[part]
        return exact.rates[self.equation] - combine(self.given_rates[self.equation], exact.columns)

    def residual(self, part: str = "train", true_coefficients: bool = False) -> Float[np.ndarray, " n_obs"]:
        """Return the measured derivative less the simulation, as given or with its true coefficients."""
        data = self.train if part == "train" else self.test
        terms = (self.true_rates if true_coefficients else self.given_rates)[self.equation]
        return data.derivatives[self.equation] - combine(terms, self.measured(part))

    @cached_property
    def closable(self) -> float:
        """Share of the mean squared gap on the test data that the true model closes; what it leaves is noise."""
        noise = self.test.derivatives[self.equation] - self.exact["test"].rates[self.equation]
        return 1.0 - (rms(noise) / rms(self.residual("test"))) ** 2


def generate(case: HiddenCase) -> CaseData:
    """Make the data of a case; the same case always gives the same.

    Raises:
        InputError: The host cannot show the effect at any size.
    """
    host = HOSTS[case.host]
    setting, choice, train_noise, test_noise = np.random.default_rng(case.seed).spawn(4)
    for _ in range(SET_UPS):
        # A host may resonate out of its bounds without any effect; then it is set up again.
        rates = drawn_rates(host, setting)
        excited = {"train": excite(host, setting, host.runs), "test": excite(host, setting, host.test_runs)}
        with suppress(LostError):
            ode, exact = _followed(case, HostODE(host, rates), excited, choice)
            break
    else:
        raise InputError(f"The host {host.name} cannot show {' and '.join(case.effects)} at any size.")
    scale = {state: case.noise * rms(rate) for state, rate in exact["train"].rates.items()}
    sigma = scale[host.equation]
    given, off = rates, None
    if case.family == "mis-calibrated":
        given, off = _miscalibrated(host, rates, exact["train"], sigma, choice)
    truth = tuple(
        Truth(act.effect.slug, act.coefficient, act.inner, abs(act.coefficient) * rms(value) / sigma, wanted)
        for act, value, wanted in zip(ode.acting, exact["train"].values, case.ratios, strict=True)
    )
    return CaseData(
        case=case,
        train=_measured(host, exact["train"], scale, train_noise),
        test=_measured(host, exact["test"], scale, test_noise),
        simulation={state: formula(terms) for state, terms in given.items()},
        sigma=sigma,
        effects=truth,
        off=off,
        true_rates=rates,
        given_rates=given,
        exact=exact,
        ode=ode,
        excited=excited,
    )


def drawn_rates(host: Host, rng: np.random.Generator) -> dict[str, dict[str, float]]:
    """Draw coefficients of the simulation; those of a plain y' = ydot stay 1."""
    return {
        state: {
            text: value if terms == {text: 1.0} else value * float(np.exp(rng.uniform(-SPREAD, SPREAD)))
            for text, value in terms.items()
        }
        for state, terms in host.rates.items()
    }


def _followed(
    case: HiddenCase, bare: HostODE, excited: Mapping[str, Excited], rng: np.random.Generator
) -> tuple[HostODE, dict[str, Runs]]:
    """Follow the host with its hidden effects; with another sign or smaller ones where it cannot take them."""
    effects = [find(bare.host.domain, slug) for slug in case.effects]
    missing = [effect.slug for effect in effects if not effect.fits(bare.host)]
    if missing:
        raise InputError(f"{missing[0]} needs roles that the host {bare.host.name} does not have.")
    first = rng.choice([-1.0, 1.0], len(effects))
    fractions = [
        np.nan if e.inner is None else float(np.exp(rng.uniform(np.log(e.inner.low), np.log(e.inner.high))))
        for e in effects
    ]
    for lower, flips in product(LOWER, product((1.0, -1.0), repeat=len(effects))):
        wanted = [
            Wanted(effect, lower * ratio * case.noise, float(sign * flip), fraction)
            for effect, ratio, sign, flip, fraction in zip(effects, case.ratios, first, flips, fractions, strict=True)
        ]
        try:
            acting = coefficients(bare, excited["train"], wanted) if wanted else ()
            ode = HostODE(bare.host, bare.rates, acting)
            return ode, {part: follow(ode, runs) for part, runs in excited.items()}
        except LostError:
            continue
    raise LostError("The host cannot take its effects at any size.")


def _miscalibrated(
    host: Host, rates: Mapping[str, Mapping[str, float]], train: Runs, sigma: float, rng: np.random.Generator
) -> tuple[dict[str, dict[str, float]], tuple[str, float]]:
    """Return the simulation with one coefficient off, of those whose error can be seen at all."""
    sizes = {
        text: OFF_BY * abs(value) * rms(np.broadcast_to(term_value(text, train.columns), train.known.shape)) / sigma
        for text, value in rates[host.equation].items()
    }
    visible = [text for text, size in sizes.items() if size >= RATIO_EDGES[0]] or [max(sizes, key=lambda k: sizes[k])]
    off = str(rng.choice(visible))
    given = {state: dict(terms) for state, terms in rates.items()}
    given[host.equation][off] *= 1.0 + OFF_BY * float(rng.choice([-1.0, 1.0]))
    return given, (off, sizes[off])


def _measured(host: Host, exact: Runs, scale: Mapping[str, float], rng: np.random.Generator) -> Trajectories:
    """Return the runs as data: noise on every derivative, none on states and inputs."""
    n_run = len(exact.known) // host.samples

    def by_run(values: np.ndarray) -> list[np.ndarray]:
        return list(values.reshape(n_run, host.samples))

    return Trajectories.from_arrays(
        by_run(exact.columns["t"]),
        states={state: by_run(exact.columns[state]) for state in host.states},
        inputs={name: by_run(exact.columns[name]) for name in host.inputs},
        derivatives={
            state: by_run(rate + scale[state] * rng.standard_normal(len(rate))) for state, rate in exact.rates.items()
        },
        units=dict(host.units),
        constant="keep",
    )

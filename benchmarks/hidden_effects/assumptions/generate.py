"""The data of a case of a broken assumption: the true system, its sensors, and what a user does before the study."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.running.errors import InputError
from benchmarks.hidden_effects.generate import SET_UPS, CaseData, Truth, drawn_rates
from benchmarks.hidden_effects.systems.hidden import find
from benchmarks.hidden_effects.systems.hosts import Host, formula
from benchmarks.hidden_effects.systems.ode import HostODE, LostError
from benchmarks.hidden_effects.systems.search import Wanted, coefficients
from benchmarks.hidden_effects.systems.trajectories import Excited, Runs, excite, rms

from .case import AssumptionCase, Family, Measured, Scene, Suspect
from .families import FAMILIES
from .hosts import PLACES
from .path import Path, followed

SMALLER = (1.0, 0.75, 0.5, 0.3)
"""Shares of the wanted ratio that are tried in turn; below them an effect could not be seen any more."""

PARTS = ("train", "test")
"""Data sets of a case."""


@dataclass(frozen=True)
class AssumptionData(CaseData):
    """Data of a case for a solver, and the truth behind them; further attributes are the right answers.

    Attributes:
        accepted: For each hidden effect the slugs that count as its name.
        excused: Slugs that are neither right nor wrong.
        suspects: True faults of the instrument; any of them is right.
        silent: Verdicts that are right; empty where something is missing.
    """

    accepted: tuple[tuple[str, ...], ...]
    excused: tuple[str, ...]
    suspects: tuple[Suspect, ...]
    silent: tuple[str, ...]


def generate(case: AssumptionCase) -> AssumptionData:
    """Make the data of a case; the same case always gives the same.

    Raises:
        InputError: The host cannot show the effect at any size.
    """
    family = FAMILIES[case.family]
    setting, choice, *sensors = np.random.default_rng(case.seed).spawn(4)
    visible, whole = case.place.visible, case.place.whole
    for attempt in range(SET_UPS):
        # A host may be lost with the first coefficients and input that are drawn; then it is set up again. Only the
        # last time are effects tried with the other sign: most of them should be what nature has.
        last = attempt == SET_UPS - 1
        rates = drawn_rates(whole, setting)
        excited = {"train": excite(whole, setting, whole.runs), "test": excite(whole, setting, whole.test_runs)}
        with suppress(LostError):
            ode, paths = _followed(family, case, HostODE(whole, rates), excited, choice, last)
            break
    else:
        raise InputError(f"The host {whole.name} cannot show {' and '.join(case.effects)} at any size.")
    exact = {part: paths[part].at() for part in PARTS}
    train = exact["train"]
    scene = Scene(
        case,
        paths,
        rms(train.rates[visible.equation]),
        {name: float(np.std(train.columns[name])) for name in (*visible.states, *visible.inputs)},
    )
    data = {part: _as_data(visible, family.measure(scene, part, rng)) for part, rng in zip(PARTS, sensors, strict=True)}
    sigma = family.sigma(scene)
    if family.finish is not None:
        data = dict(zip(PARTS, family.finish(data["train"], data["test"]), strict=True))
        exact = {part: _kept(exact[part], visible.samples, data[part]) for part in PARTS}
        train = exact["train"]
        sigma = rms(data["train"].derivatives[visible.equation] - train.rates[visible.equation])
    hidden = list(zip(ode.acting, train.values, strict=True))[len(ode.acting) - len(case.effects) :]
    true_rates = paths["train"].visible.rates
    return AssumptionData(
        case=case,
        train=data["train"],
        test=data["test"],
        simulation={state: formula(terms) for state, terms in true_rates.items()},
        sigma=sigma,
        effects=tuple(
            Truth(act.effect.slug, act.coefficient, act.inner, abs(act.coefficient) * rms(value) / sigma, wanted)
            for (act, value), wanted in zip(hidden, case.ratios, strict=True)
        ),
        off=None,
        true_rates=true_rates,
        given_rates=true_rates,
        exact=exact,
        accepted=tuple(family.accepted(case, slug) for slug in case.effects),
        excused=family.excused(case),
        suspects=family.suspects(case),
        silent=family.silent(case),
    )


def _followed(
    family: Family,
    case: AssumptionCase,
    bare: HostODE,
    excited: Mapping[str, Excited],
    rng: np.random.Generator,
    turned: bool,
) -> tuple[HostODE, dict[str, Path]]:
    """Follow the system with all that acts in it; smaller, or if `turned` with other signs, where that is too much."""
    beside, given = family.beside(case, rng), family.inner(case)
    effects = [find(bare.host.domain, slug) for slug in case.effects]
    fractions = [
        given.get(effect.slug, np.nan)
        if effect.inner is None or effect.slug in given
        else float(np.exp(rng.uniform(np.log(effect.inner.low), np.log(effect.inner.high))))
        for effect in effects
    ]
    seen = case.system
    visible = replace(
        seen,
        rates={s: {text: bare.rates[s][text] for text in terms} for s, terms in seen.rates.items()},
    )
    level = family.level(case)
    # Sizes are searched on runs of the usual length: long ones would cost much and tell little more.
    usual = PLACES[case.host].whole
    short = replace(bare, host=usual) if case.rows > usual.samples * usual.runs else bare
    sides, sizes = ((1.0, -1.0), SMALLER) if turned else ((1.0,), SMALLER[:-1])
    for side, smaller in product(sides, sizes):
        wanted = [
            Wanted(effect, smaller * ratio * level, side * sign, fraction)
            for effect, ratio, sign, fraction in zip(effects, case.ratios, case.signs, fractions, strict=True)
        ]
        wanted = [*beside, *wanted]
        try:
            acting = coefficients(short, excited["train"], wanted) if wanted else ()
            rest = HostODE(short.host, bare.rates, acting)
            acting = (*family.momentary(case, rest, excited["train"], rng), *acting)
            ode = HostODE(bare.host, bare.rates, acting)
            return ode, {part: followed(ode, visible, runs) for part, runs in excited.items()}
        except LostError:
            if not effects:
                raise
    raise LostError("The host cannot take its effects at any size.")


def _as_data(host: Host, measured: Measured) -> Trajectories:
    """Return the runs as data with the studied rate alone, as of sensors of displacement, speed and acceleration."""

    def by_run(values: Float[np.ndarray, " n_obs"]) -> list[np.ndarray]:
        return list(values.reshape(-1, host.samples))

    runs = len(measured.rate) // host.samples
    return Trajectories.from_arrays(
        [host.times] * runs,
        states={state: by_run(measured.columns[state]) for state in host.states},
        inputs={name: by_run(measured.columns[name]) for name in host.inputs},
        derivatives={host.equation: by_run(measured.rate)},
        units=dict(host.units),
        constant="keep",
    )


def _kept(exact: Runs, samples: int, data: Trajectories) -> Runs:
    """Return exact quantities on the rows that a filter left, the middle of every run."""
    edge = (samples - data.run_lengths[0]) // 2

    def inner(values: np.ndarray) -> np.ndarray:
        return values.reshape(-1, samples)[:, edge : samples - edge].ravel()

    return Runs(
        {name: inner(values) for name, values in exact.columns.items()},
        inner(exact.known),
        tuple(inner(value) for value in exact.values),
        inner(exact.hidden),
        {state: inner(rate) for state, rate in exact.rates.items()},
    )

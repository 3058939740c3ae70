"""Hypotheses whose probabilities are written down by hand, on the rows of a small equation."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from bayes_greybox.discovery.answer.coefficients import Coefficients
from bayes_greybox.discovery.answer.equation_study import EquationStudy
from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.decision.decide import Place, Verdict
from bayes_greybox.discovery.decision.probabilities import Probabilities, Share
from bayes_greybox.discovery.grid.log_evidence import modes
from bayes_greybox.discovery.grid.points import DISCREPANCIES, LAW, NO_DISCREPANCY
from bayes_greybox.discovery.grid.weigh import Hypothesis
from bayes_greybox.discovery.linearise.near import Near

AT = 100.0
"""Log weight of a hypothesis of probability one."""


def members_of(near: Near, name: str) -> tuple[int, ...]:
    """The first columns of these slugs, labels, formulas or sensor errors, with the free terms."""
    columns, body = near.regressors.columns, name.removesuffix(" & rest")
    wanted = [] if body in ("no gap", "unknown") else body.split(" + ")
    if body == "recalibrate":
        wanted = [columns[near.regressors.of_kind("correction")[0]].called]
    own = [
        next(
            i for i, c in enumerate(columns)
            if c.kind != "free" and each in (c.called, "" if c.effect is None else c.effect.slug)
        )
        for each in wanted
    ]  # fmt: skip
    return tuple(sorted((*near.regressors.of_kind("free"), *own)))


def with_hypotheses(near: Near, given: Mapping[str, float | tuple[float, float]], left: float = 0.5) -> Near:
    """The same rows with these hypotheses, such as "cube + square", "no gap", or "cube & rest".

    Args:
        near: Rows.
        given: Their probability, or that and the agreement. Beside a rest there is a law, beside all others nothing.
        left: RMS of a rest, scaled.
    """
    points = near.weighed.grid.points
    of_kind = {kind: next(k for k, point in enumerate(points) if point.kind == kind) for kind in (NO_DISCREPANCY, LAW)}
    found = []
    for name, value in given.items():
        p, agreement = value if isinstance(value, tuple) else (value, value)
        rest = name == "unknown" or name.endswith(" & rest")
        point, members = of_kind[LAW if rest else NO_DISCREPANCY], members_of(near, name)
        mode = modes(near.weighed.grid, near.weighed.precision, [members], np.array([point]), near.weighed.floor)
        found.append(
            Hypothesis(
                members, AT + float(np.log(p)), p, agreement,
                dict.fromkeys(DISCREPANCIES, 0.0) | {LAW if rest else NO_DISCREPANCY: 1.0}, {},
                np.eye(len(points))[point], point,
                float(np.sqrt(mode.v[0])), mode.mean[0], mode.covariance[0], np.abs(mode.mean[0]),
                left * rest, np.full(len(members), left * rest), np.zeros(len(members)),
            )
        )  # fmt: skip
    found.sort(key=lambda h: -h.probability)
    return replace(near, weighed=replace(near.weighed, hypotheses=tuple(found)))


def place_of(near: Near, index: int, tied: Sequence[str] = (), share: float = 0.7) -> Place:
    """One effect of an answer."""
    effect = near.column(index).effect
    return Place(effect.label, effect.slug, Share(share, share), tuple(tied))


def answer(near: Near, code: str, base: Sequence[int] = (), ties: Sequence[Sequence[str]] | None = None) -> Verdict:
    """A verdict with the effects of these columns."""
    places = tuple(place_of(near, i, tied) for i, tied in zip(base, ties or ((),) * len(base), strict=True))
    probabilities = Probabilities(near.weighed, Criteria())
    return Verdict(code, places, near.likeliest, (), 0.0, 0.0, probabilities=probabilities)


def study_of(near: Near, code="named", base=(), draws=None, inner=None, ties=None, checks=(), sigma=0.05):
    """A study with draws in user's units of the columns: free, corrections, then the effects of `base`."""
    known = near.regressors
    own = [*known.of_kind("free"), *known.of_kind("correction")]
    draws = np.zeros((4, len(own) + len(base))) if draws is None else np.asarray(draws, float)
    inner = np.tile(base, (len(draws), 1)) if inner is None else np.asarray(inner)
    inner = inner.reshape(len(draws), len(base)).astype(int)
    scale = np.array([[known.columns[i].scale for i in (*own, *row)] for row in inner]).reshape(draws.shape)
    study = object.__new__(EquationStudy)
    study.__dict__.update(
        near=near, verdict=answer(near, code, base, ties), amendment=SimpleNamespace(sigma=sigma), checks=tuple(checks),
        coefficients=Coefficients((*own, *base), draws * scale / known.target_scale, inner, np.full(len(draws), 0.1)),
        criteria=Criteria(),
    )  # fmt: skip
    return study

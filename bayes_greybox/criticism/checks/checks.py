"""All checks of a fit in one table: the noise model, and the influence of the prior beside the data."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd
from threadpoolctl import threadpool_limits

from bayes_greybox.criticism.convergence import convergence
from bayes_greybox.criticism.linearity import Linearity, linearity
from bayes_greybox.data.writing import formula
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.inference.remembering import remembered
from bayes_greybox.running.stages import stage

from .loo_pit import TEST_LEVEL, LooPit, loo_pit
from .other_noise import suggestion
from .sensitivity import CONFLICT, DOMINANT, SENSITIVITY_THRESHOLD, sensitivity
from .whiteness import Whiteness, whiteness


@dataclass(frozen=True)
class Checks:
    """Checks of a fit.

    Attributes:
        ok: True if every check passed.
        reasons: Failed checks, one sentence each with what to try, and last the noise that the residuals support if
            LOO-PIT or whiteness failed; empty if `ok`.
        table: Table by (equation, check): ok, value (a p-value, the largest sensitivity to the prior, or for linearised
            rows k̂ of the exact paths, NaN if unknown), limit (the level, or the threshold) and reason.
        loo_pit: LOO-PIT by equation.
        whiteness: Autocorrelation of the residuals by equation.
        sensitivity: Power-scaling sensitivity by (equation, quantity).
    """

    ok: bool
    reasons: tuple[str, ...]
    table: pd.DataFrame
    loo_pit: Mapping[str, LooPit]
    whiteness: Mapping[str, Whiteness]
    sensitivity: pd.DataFrame

    @property
    def pit(self) -> Mapping[str, LooPit]:
        """`loo_pit` under its former name."""
        return self.loo_pit

    def __str__(self) -> str:
        if self.ok:
            return "Every check of the model passed."
        return "\n- ".join(["The data speak against the model, or too softly:", *self.reasons])


@remembered
@threadpool_limits.wrap(limits=1)  # threads inside BLAS take ten times the work for matrices of this size
def checks(posterior: Posterior) -> Checks:
    """Check the claims of a fit: predictive distributions, white noise, and data that outweigh the prior.

    The first two are tests, each of level 1 % on average over the prior (see `loo_pit` and `whiteness` for what that
    assumes); the last compares sensitivities with the threshold of Kallioinen et al. 2024, which has no level. Chains
    that have not converged make all of them unreliable, and `reasons` says so first.
    """
    posterior.require_rows("Checks are made")
    pits = {name: loo_pit(posterior, name) for name in posterior.equations}
    white = {name: whiteness(posterior, name) for name in posterior.equations}
    scaled = sensitivity(posterior)
    rows: dict[tuple[str, str], dict[str, Any]] = {}
    for name, equation in posterior.equations.items():
        pit, spectrum = pits[name], white[name]
        rows[(name, "LOO-PIT")] = _row(pit.p > TEST_LEVEL, pit.p, TEST_LEVEL, _pit_reason(pit))
        rows[(name, "whiteness")] = _row(spectrum.p > TEST_LEVEL, spectrum.p, TEST_LEVEL, _white_reason(spectrum))
        # Sensitivities are by learned state, of which several may share the rows of one block.
        states = {state for state, _ in equation.frame.labels}
        sensitivities = scaled.loc[[key for key in scaled.index if key[0] in states]]
        worst = float(sensitivities["prior"].max()) if len(sensitivities) else 0.0
        reason = " ".join(_prior_reasons(name, sensitivities))
        if equation.rows.exact is not None:
            with stage("Following exact paths"):
                paths = linearity(posterior, name)
            rows[(name, "linearity")] = _row(paths.ok, paths.khat, paths.limit, _linearity_reason(name, paths))
        rows[(name, "prior sensitivity")] = _row(not reason, worst, SENSITIVITY_THRESHOLD, reason)
    index = pd.MultiIndex.from_tuples(list(rows), names=["equation", "check"])
    table = pd.DataFrame(list(rows.values()), index=index)
    reasons = [reason for reason in table["reason"] if reason]
    failed = [name for name in pits if not all(rows[(name, check)]["ok"] for check in ("LOO-PIT", "whiteness"))]
    reasons += [words for name in failed if (words := suggestion(posterior, name))]
    if not convergence(posterior).mixed:
        reasons.insert(0, "The sampler has not converged, so the other checks say little: see fit.verdict.")
    return Checks(not reasons, tuple(reasons), table, pits, white, scaled)


def _row(ok: bool, value: float, limit: float, reason: str) -> dict[str, Any]:
    return {"ok": ok, "value": value, "limit": limit, "reason": "" if ok else reason}


def _pit_reason(pit: LooPit) -> str:
    hint = {
        "too narrow": "the noise is larger or has heavier tails than the model can say: look for outliers, raise "
        "GreyBox(noise=...), or let the discrepancy see more variables",
        "too wide": "the noise is smaller than the model believes: lower GreyBox(noise_floor=...), and look "
        "whether rows repeat",
        "of the wrong shape": "the noise is shifted, skewed or changes along the record: look at the residuals over "
        "time and over the states",
    }[pit.wrong]
    return (
        f"The leave-one-out predictions of {pit.equation!r} are {pit.wrong} (p = {pit.p:.2g}; {pit.outside:.0%} of the "
        f"measurements fall outside their 90 % interval): {hint}."
    )


def _white_reason(white: Whiteness) -> str:
    lags = ", ".join(map(str, white.standing_out[:5])) + (", …" if len(white.standing_out) > 5 else "")
    where = f"lag {lags} stands out" if len(white.standing_out) == 1 else f"lags {lags} stand out"
    where = where if white.standing_out else "no lag alone, but all together"
    if white.by_frequency:
        return (
            f"The residuals of {white.equation!r} do not have the spectrum that differentiation gives white sensor "
            f"noise (p = {white.p:.2g}): keep fewer frequencies, or give the noise a larger white share."
        )
    hint = (
        "either the noise is correlated (differentiate with data.differentiate(), which tells the model, or take every "
        "n-th row), or something is missing that f cannot follow (give OrthogonalGP more variables or features, or "
        "look with bg.find_missing_effects)"
    )
    return (
        f"The residuals of {white.equation!r} are not as independent as the noise model says (p = {white.p:.2g}; "
        f"{where}): {hint}."
    )


def _linearity_reason(equation: str, paths: Linearity) -> str:
    return (
        f"The samples of {equation!r} are not linear in what was learned within its posterior: {paths.elsewhere:.0%} "
        f"of the exact posterior lies elsewhere (k-hat {paths.khat:.2g}). More or better samples, a stated prior for "
        "a coefficient that is poorly known, or a smaller dictionary narrow the posterior."
    )


def _prior_reasons(equation: str, table: pd.DataFrame) -> Iterator[str]:
    for diagnosis, words in {
        CONFLICT: "the prior and the data pull apart: widen the prior's scale, or ask why the data contradict it",
        DOMINANT: "the prior decides, not the data: report the dependence on the prior, or collect data that move it",
    }.items():
        diagnosed = table.index[table["diagnosis"].to_numpy(str) == diagnosis]
        if len(diagnosed):
            yield f"In {equation!r}, for {', '.join(formula(str(key[1])) for key in diagnosed)} {words}."

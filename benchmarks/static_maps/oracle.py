"""Probabilities of the hidden law to one who knows all else: the noise, the simulation, and how large laws are.

Laws φ_k of the catalogue compete, each with a coefficient of which the size is drawn as the maps draw it:

    y − g = c φ_k + σ W⁻¹ e,   m_k = ∫ p(c) exp(c φ̃ᵀr − c² φ̃ᵀφ̃/2) dc,   r = W(y − g)/σ, φ̃ = W φ_k/σ,

and nothing, m = 1, is as likely beforehand as all laws together. No study that does not know this much can be surer on
average of what is there and be right.
"""

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from benchmarks.hidden_effects.systems.hidden import ADDED, CATALOGUE
from benchmarks.sampled_systems.samples import CORRELATION

from .maps import HIDDEN, Measured, StaticMap, known, rms

SIZE_NODES, BEND_NODES = 60, 20
"""Points at which sizes and nonlinear parameters are summed over, evenly spaced in their logarithms."""

LEFT_OUT = ("pendulum-restoring", "power-law-stiffness", "power-law-drag")
"""Laws that are as good as others here: a pendulum's sine is a linear spring at these amplitudes."""

ROLES = {"F": {"position": "x", "velocity": "v"}, "q": {"level": "p"}}
"""Columns by role and output."""

LAWS = {
    output: {
        slug: law
        for slug, law in {**CATALOGUE[domain], **ADDED[domain]}.items()
        if set(law.roles) <= set(ROLES[output]) and slug not in LEFT_OUT
    }
    for output, domain in (("F", "mechanical"), ("q", "fluid"))
}
"""Laws of a force over position and speed, and of a flow over a pressure."""

Values = Float[np.ndarray, " n"]


def posterior(each: StaticMap, data: Measured) -> dict[str, float]:
    """Return the probability of each law, "" for none, likeliest first."""
    train, laws = data.train, LAWS[each.output]
    columns = dict(train.columns)
    roles = {role: columns[name] for role, name in ROLES[each.output].items()}
    rho = CORRELATION if each.sensor == "correlated" else 0.0
    simulated = known(each, columns)
    r = _white(train, train.rate(each.output) - simulated, rho) / data.noise
    share = np.geomspace(HIDDEN[0], HIDDEN[1], SIZE_NODES) * rms(simulated)
    log_odds = {"": float(np.log(len(laws)))}
    for slug, law in laws.items():
        bends = [1.0]
        if law.inner is not None:
            bends = np.geomspace(law.inner.low, law.inner.high, BEND_NODES) * np.max(np.abs(roles[law.inner.role]))
        every = []
        for bend in bends:
            shape = np.broadcast_to(law.value(roles, bend), len(simulated))
            c, phi = share / rms(shape), _white(train, shape, rho) / data.noise
            every += [sign * c * (phi @ r) - 0.5 * c**2 * (phi @ phi) for sign in (-1.0, 1.0)]
        log_odds[slug] = float(np.logaddexp.reduce(np.concatenate(every)) - np.log(np.size(every)))
    total = np.logaddexp.reduce(list(log_odds.values()))
    ranked = sorted(log_odds.items(), key=lambda item: -item[1])
    return {slug: float(np.exp(value - total)) for slug, value in ranked}


def _white(train: Trajectories, values: Values, rho: float) -> Values:
    """Return innovations of noise that is correlated from row to row of a run."""
    before = np.concatenate([[0.0], values[:-1]])
    first = np.concatenate([[True], np.diff(train.run) != 0])
    return np.where(first, values, (values - rho * before) / np.sqrt(1 - rho**2))

"""The reference posterior `hudson_lynx_hare-lotka_volterra` of posteriordb, and its priors.

Magnusson, Bürkner and Vehtari, github stan-dev/posteriordb: 10,000 draws of Stan. The model is that of Carpenter
(2018), du/dt = (α − β v) u, dv/dt = (−γ + δ u) v, hares u and lynxes v with lognormal errors.
"""

REFERENCE: dict[str, tuple[float, float, float, float, float]] = {
    "alpha": (0.54686, 0.063055, 0.44822, 0.54365, 0.65504),
    "beta": (0.027747, 0.0041547, 0.021378, 0.027502, 0.035021),
    "gamma": (0.8001, 0.08937, 0.66422, 0.79406, 0.95768),
    "delta": (0.024086, 0.0035281, 0.018857, 0.023825, 0.030307),
    "u(0)": (34.035, 2.9169, 29.344, 33.944, 39.038),
    "v(0)": (5.9359, 0.53055, 5.1149, 5.9113, 6.8339),
    "sigma_u": (0.24806, 0.043263, 0.18781, 0.24249, 0.3278),
    "sigma_v": (0.25102, 0.04359, 0.19107, 0.24484, 0.33129),
}
"""Mean, standard deviation, and quantiles at 5, 50 and 95 % by quantity."""

RATE, INTERACTION = (1.0, 0.5), (0.05, 0.05)
"""Mean and standard deviation of the normal priors of α and γ, and of β and δ; all are positive."""

START, NOISE = (10.0, 1.0), (-1.0, 1.0)
"""Median and logarithmic standard deviation of the populations in 1900; the same of both errors, by its logarithm."""

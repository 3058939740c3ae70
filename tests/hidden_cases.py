"""Cases of the hidden-effects benchmark with their data, and finished cases made by hand."""

from functools import cache

import numpy as np

from benchmarks.hidden_effects.cases import HiddenCase
from benchmarks.hidden_effects.generate import generate

OBVIOUS = HiddenCase("catalogue", "forced-oscillator", ("cubic-stiffness",), (10.0,), 0.01, 1)
SILENT = HiddenCase("null", "tank", (), (), 0.05, 2)


@cache
def made(case):
    return generate(case)


def without_effect(host):
    return made(HiddenCase("null", host, (), (), 0.05, 0))


def effect(slug, probability=0.99, mean=1.0, sd=0.1, status="added", tied_with=()):
    interval = {"lower": mean - 1.645 * sd, "upper": mean + 1.645 * sd}
    own = {"slug": slug, "probability": probability, "mean": mean, "sd": sd, **interval}
    return {**own, "status": status, "tied_with": list(tied_with)}


def row(family="catalogue", truth=("a",), verdict="named", effects=(), oracle=None, ratio=5.0, **more):
    about = {"key": f"{family}{np.random.default_rng(len(more)).integers(99)}", "domain": "mechanical", "host": "tank"}
    hidden = [{"slug": s, "coefficient": 1.0, "inner": None, "ratio": ratio, "wanted": ratio} for s in truth]
    study = {"verdict": verdict, "effects": list(effects), "closed": {"derivative NMSE": 0.9}, "seconds": 2.0}
    about |= {"family": family, "noise": 0.05, "effects": list(truth), "ratios": [ratio] * len(truth), "truth": hidden}
    return {**about, "off": None, "closable": 0.9, "study": study, "oracle": oracle, **more}

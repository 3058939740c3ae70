"""The same seed gives the same draws whatever the number of cores."""

import json
import os
import subprocess
import sys

import pytest

PROGRAM = """
import hashlib, json, os, sys
os.sched_setaffinity(0, json.loads(sys.argv[1]))
import numpy as np
import bayes_greybox as bg
from bayes_greybox.physics.catalogue.loading import load_catalogue
data = bg.systems.oscillator().simulate(t=np.linspace(0, 30, 200), noise=0.02, seed=1)
model = bg.GreyBox(dictionary={"ydot": ["y", "ydot", "y**3", "ydot**3"]}, prior=bg.Laplace())
fit = model.fit(data, draws=20, tune=20, chains=2, seed=3, progress=False)
drawn = fit.idata["posterior"].dataset
data = bg.systems.duffing().simulate(t=np.linspace(0, 20, 400), noise=0.02, seed=1)
model = bg.GreyBox(simulation={"y": "ydot", "ydot": "F - 10*y - 0.5*ydot"})
few = [e for e in load_catalogue("mechanical") if e.slug.endswith("-stiffness") and "coupling" not in e.slug]
study = bg.find_missing_effects(model, data, catalogue=few, settle=False, free_runs=False, progress=False)
print(json.dumps({
    "fit": {name: hashlib.sha256(drawn[name].to_numpy().tobytes()).hexdigest() for name in sorted(drawn)},
    "study": [study.verdict, study.effects["slug"].tolist(), study.effects["probability"].tolist()],
}))
"""

CORES = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []

pytestmark = pytest.mark.skipif(len(CORES) < 2, reason="needs two cores and a system that says which")


def said(cores, **environment):
    """What a process of its own drew and found on these cores."""
    words = [sys.executable, "-c", PROGRAM, json.dumps(cores)]
    # Threads of BLAS as users have them, and not as the workers of the tests.
    own = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    done = subprocess.run(words, env={**own, **environment}, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def one():
    return said(CORES[:1])


@pytest.fixture(scope="module")
def two():
    return said(CORES[:2])


@pytest.mark.slow
def test_a_fit_draws_the_same_on_one_core_and_on_two(one, two):
    assert one["fit"].keys() >= {"ydot_theta", "ydot_sigma", "ydot_length_scale"}
    assert one["fit"] == two["fit"]


@pytest.mark.slow
def test_a_study_says_the_same_on_one_core_and_on_two(one, two):
    """To the last bit where XLA is told to have one thread; else to the rounding of its sums, which it splits."""
    assert said(CORES[:2], NPROC="1") == one
    verdict, slugs, probabilities = two["study"]
    assert [verdict, slugs] == one["study"][:2]
    assert probabilities == pytest.approx(one["study"][2], rel=1e-9)

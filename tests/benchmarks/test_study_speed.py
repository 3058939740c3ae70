"""A study of 10⁵ rows, the catalogue weighed and the whole of it, and one with f over three variables.

python -m pytest -n 0 -m slow tests/benchmarks/test_study_speed.py -s
"""

import json
import subprocess
import sys

import pytest

# In a process of its own: the tests check the types of every call, users do not.
STUDIES = """
import json, time
import numpy as np
import bayes_greybox as bg

data = bg.systems.duffing(k3=40.0).simulate(t=np.linspace(0, 5000, 100_001), noise=0.05, seed=1)
model = bg.GreyBox(
    simulation={"y": "ydot", "ydot": "F - 10*y - 0.5*ydot"}, discrepancy=bg.OrthogonalGP(variables=("y", "ydot"))
)
# Once to compile; the second is warm.
for _ in range(2):
    study = bg.find_missing_effects(model, data, settle=False, free_runs=False, progress=False)
start = time.perf_counter()
whole = bg.find_missing_effects(model, data, progress=False)
print(json.dumps({
    "weigh": study.settings["seconds"]["explain"], "whole": time.perf_counter() - start,
    "effects": len(study.effects), "parts": whole.settings["seconds"],
    "verdict": whole.verdict, "first": whole.effects["slug"].iloc[0],
}))
"""


@pytest.mark.slow
def test_a_study_of_a_hundred_thousand_rows(capsys):
    result = subprocess.run([sys.executable, "-c", STUDIES], capture_output=True, text=True, check=True)
    found = json.loads(result.stdout)
    with capsys.disabled():
        print(
            f"\n{found['effects']} effects weighed in {found['weigh']:.1f} s, warm; "
            f"whole study {found['whole']:.0f} s {found['parts']}"
        )
    assert (found["verdict"], found["first"]) == ("named", "cubic-stiffness")
    assert found["weigh"] < 5
    assert found["whole"] < 60


OVER_ALL = """
import json, time
import numpy as np
import bayes_greybox as bg

t = np.linspace(0, 40, 400)
F = np.sin(1.3 * t) + 0.7 * np.sin(2.9 * t + 1)
# Midpoint steps, twenty to a sample.
y, v, states = 0.0, 0.0, []
for k, at in enumerate(t):
    force = lambda s: np.sin(1.3 * s) + 0.7 * np.sin(2.9 * s + 1)
    rate = lambda s, y, v: (v, force(s) - 2 * y - 0.2 * v - 0.8 * y**3)
    states.append((y, v, rate(at, y, v)[1]))
    h = (t[1] - t[0]) / 20
    for j in range(20):
        a, b = rate(at + j * h, y, v)
        a, b = rate(at + (j + 0.5) * h, y + h / 2 * a, v + h / 2 * b)
        y, v = y + h * a, v + h * b
y, v, a = np.array(states).T
a = a + 0.03 * np.random.default_rng(0).standard_normal(400)
data = bg.Trajectories.from_arrays(t, states={"y": y, "v": v}, inputs={"F": F}, derivatives={"y": v, "v": a})
model = bg.GreyBox(simulation={"y": "v", "v": "F - 2*y - 0.2*v"})
start = time.perf_counter()
study = bg.find_missing_effects(model, data, progress=False)
print(json.dumps({
    "seconds": time.perf_counter() - start, "verdict": study.verdict, "first": study.effects["slug"].iloc[0],
    "ok": study.fit.verdict.ok, "over": study.fit.equations["v"].frame.variables,
}))
"""


@pytest.mark.slow
def test_a_study_with_f_over_two_states_and_an_input(capsys):
    result = subprocess.run([sys.executable, "-c", OVER_ALL], capture_output=True, text=True, check=True)
    found = json.loads(result.stdout)
    with capsys.disabled():
        print(f"\n400 rows, f over three variables: {found['seconds']:.0f} s")
    assert (found["verdict"], found["first"], found["over"]) == ("named", "cubic-stiffness", ["y", "v", "F"])
    assert found["ok"] and found["seconds"] < 60

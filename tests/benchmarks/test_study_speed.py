"""A study of 10⁵ rows: the catalogue weighed, and the whole of it with free runs and NUTS.

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

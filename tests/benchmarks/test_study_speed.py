"""A study of 10⁵ rows: the catalogue weighed, and the whole of it with free runs and NUTS.

python -m pytest -n 0 -m slow tests/benchmarks/test_study_speed.py -s
"""

import time

import numpy as np
import pytest

import bayes_greybox as bg


@pytest.mark.slow
def test_a_study_of_a_hundred_thousand_rows(capsys):
    system = bg.systems.duffing(k3=40.0)
    data = system.simulate(t=np.linspace(0, 5000, 100_001), noise=0.05, seed=1)
    model = bg.GreyBox(
        simulation={"y": "ydot", "ydot": "F - 10*y - 0.5*ydot"}, discrepancy=bg.OrthogonalGP(variables=("y", "ydot"))
    )
    # Once to compile; the second is warm.
    weighed = []
    for _ in range(2):
        study = bg.find_missing_effects(model, data, settle=False, free_runs=False, progress=False)
        weighed.append(study.settings["seconds"]["explain"])
    start = time.perf_counter()
    whole = bg.find_missing_effects(model, data, progress=False)
    seconds = time.perf_counter() - start
    with capsys.disabled():
        print(
            f"\n{len(study.effects)} effects weighed in {weighed[0]:.1f} s, warm {weighed[1]:.1f} s; "
            f"whole study {seconds:.0f} s {whole.settings['seconds']}"
        )
    assert whole.verdict == "named"
    assert whole.effects["slug"].iloc[0] == "cubic-stiffness"
    assert weighed[1] < 5
    assert seconds < 60

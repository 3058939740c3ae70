"""Every shipped config that fits, but for the one without an orthogonal kernel, must converge at its full length.

[BAYES_GREYBOX_DATA=folder] python -m pytest -n 0 -m slow tests/benchmarks/test_configs.py -s
"""

import os
from pathlib import Path

import pytest

from bayes_greybox.config.file import load_config

CONFIGS = Path(__file__).parents[2] / "configs"
FITS = sorted(
    path.stem
    for path in CONFIGS.glob("*.toml")
    if not path.stem.startswith(("compare", "discover")) and "nonorthogonal" not in path.stem
)


@pytest.mark.slow
@pytest.mark.parametrize("name", FITS)
def test_a_shipped_config_converges(name, capsys):
    config = load_config(CONFIGS / f"{name}.toml")
    if getattr(config.data, "dataset", None) and "BAYES_GREYBOX_DATA" not in os.environ:
        pytest.skip("BAYES_GREYBOX_DATA names no folder of data")
    train, _ = config.read_data()
    fit = config.build_model().fit(train, progress=False, **config.sampling.model_dump())
    table = fit.summary()
    divergences = int(fit.idata["sample_stats"]["diverging"].sum())
    with capsys.disabled():
        print(
            f"\n| {name} | {table['r_hat'].max():.4f} | {table['ess_bulk'].min():.0f} | {table['ess_tail'].min():.0f} "
            f"| {divergences} |"
        )
    assert fit.verdict.ok, fit.verdict
    assert divergences == 0
    assert table["r_hat"].max() <= 1.01
    assert min(table["ess_bulk"].min(), table["ess_tail"].min()) >= 400

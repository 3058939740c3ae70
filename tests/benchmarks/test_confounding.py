"""The confounding study: data with a known answer, a cell that finds it, tables and their resumption."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.program import Program
from bayes_greybox.report.plots import plot_confounding
from bayes_greybox.running.errors import InputError
from benchmarks.confounding.cells import KERNELS, Cell, _compressed, measure_cell
from benchmarks.confounding.run import CONFOUNDING, cases, score
from benchmarks.confounding.situations import RATE_NOISE, SITUATIONS, records
from benchmarks.runner import Asked, perform


def fabricated_row(situation, variant, measure, replicates=4):
    found = next(s for s in SITUATIONS if s.name == situation)
    theta = np.array(list(found.theta.values()))
    offset = np.linspace(-0.1, 0.1, replicates)[:, None]
    return {
        "situation": situation,
        "variant": variant,
        "measure": measure,
        "theta": theta.tolist(),
        "projected": np.full(len(theta), 0.5).tolist(),
        "overlap": 0.2,
        "seconds": 2.0,
        "divergences": [0] * (replicates - 1) + [1],
        "mean": (theta + 0.2 + offset).tolist(),
        "sd": np.full((replicates, len(theta)), 0.1).tolist(),
        "lower": (theta + 0.2 + offset - 0.15).tolist(),
        "upper": (theta + 0.2 + offset + 0.15).tolist(),
        "correlation": [0.5] * replicates,
        "r_hat": [1.0] * replicates,
        "ess": [500.0] * replicates,
    }


def test_situations_are_what_they_say():
    overlaps = {}
    for situation in SITUATIONS:
        data = records(situation, 200, seed=0)
        assert np.array_equal(data.rates[:3], records(situation, 3, seed=0).rates)
        clean = data.rates.mean(axis=0)
        spread = (data.rates - clean).std() / np.sqrt(1 - 1 / 200)
        # relative error of a standard deviation of 30,000 values: 0.4 %, at four standard errors
        assert abs(spread / data.noise - 1) < 4 * 0.0041
        learned = clean - data.force
        assert data.noise == pytest.approx(RATE_NOISE * np.sqrt(np.mean(learned**2)), rel=0.01)
        # dv/dt of the path is the rate: a centred difference errs by h²/6 times the third derivative
        slope = (data.v[2:] - data.v[:-2]) / (data.t[2] - data.t[0])
        assert np.sqrt(np.mean((slope - clean[1:-1]) ** 2)) < 0.05 * clean.std()
        overlaps[situation.name] = data.overlap()
    assert overlaps["complete"] == 0 and overlaps["dissimilar"] < 0.1 and overlaps["overlapping"] > 0.7


def test_box_projection_of_a_cube_is_that_of_the_integral():
    data = records(SITUATIONS[2], 1, seed=0)
    low, high = data.y.min(), data.y.max()
    moment = lambda k: (high ** (k + 1) - low ** (k + 1)) / ((k + 1) * (high - low))  # noqa: E731
    v = (data.v.max() + data.v.min()) / 2
    v2 = (data.v.max() ** 2 + data.v.max() * data.v.min() + data.v.min() ** 2) / 3
    H = np.array([[moment(2), moment(1) * v], [moment(1) * v, v2]])
    expected = np.linalg.solve(H, -np.array([moment(4), moment(3) * v]))
    np.testing.assert_allclose(data.projected("box"), expected, rtol=1e-4, atol=1e-5)


def test_one_factorisation_serves_all_replicates():
    data = records(SITUATIONS[2], 2, seed=0)
    model = Program(
        dictionary={"v": ["y", "v"]},
        simulation={"v": "F"},
        discrepancy=OrthogonalGP(variables=("y", "v"), features=4),
    )
    equation, targets = _compressed(model, data)
    Phi, Psi = (np.asarray(part) for part in (equation.design.Phi, equation.design.Psi))
    columns = {"y": data.y, "v": data.v, "F": data.force}
    rows = np.column_stack([np.asarray(part) for part in equation.frame.rows(columns)])
    for i in range(2):
        y = (data.rates[i] - data.force) / equation.frame.target_scale
        np.testing.assert_allclose(targets[i] @ targets[i], y @ y)
        np.testing.assert_allclose(np.column_stack([Phi, Psi]).T @ targets[i], rows.T @ y, atol=1e-9)


def test_scores_of_known_results():
    scores = score(
        [fabricated_row("overlapping", "projected", "box"), fabricated_row("overlapping", "none", "empirical")]
    )
    first = scores["terms"].loc[("overlapping", "projected", "box", "y")]
    assert first["bias"] == pytest.approx(0.2) and first["sd"] == pytest.approx(0.1)
    # lower ends 0.2 + offset − 0.15 ≤ 0 for two of four offsets; projections 0.5 lie above all
    assert first["coverage"] == 0.25 and first["coverage_projection"] == 0.0
    cell = scores["cells"].loc[("overlapping", "projected", "box")]
    assert cell["bias"] == pytest.approx(2.0) and cell["converged"] == 0.75 and cell["ess_per_second"] == 250.0
    assert ("overlapping", "none", "–") in scores["cells"].index
    figure = plot_confounding(scores["terms"])
    figure.canvas.draw()
    assert len(figure.axes) == 2 and len(figure.axes[0].get_yticklabels()) == 4


def test_a_stopped_run_goes_on_and_tables_are_written(tmp_path):
    ran = []

    def measured(cell):
        ran.append(cell)
        return fabricated_row(cell.situation, cell.variant, cell.measure, cell.replicates)

    def run(chosen):
        return perform(replace(CONFOUNDING, run=measured), chosen, asked)

    asked = Asked(tmp_path, replicates=4, progress=False)
    cells = cases(asked)
    assert len(cells) == len(SITUATIONS) * len(KERNELS)
    run(cells[:2])
    with (tmp_path / "results.jsonl").open("a", encoding="utf-8") as file:
        file.write('{"cut')
    scores = run(cells)
    assert ran == [cell for case in cells for cell in case.arguments]
    assert run(cells)["cells"].equals(scores["cells"]) and len(ran) == len(cells)
    assert len(json.loads((tmp_path / "summary.json").read_text())["cells"]) == len(cells)
    with pytest.raises(InputError, match="at least one case"):
        run([])


@pytest.mark.slow
def test_orthogonality_gives_precision_and_takes_the_physical_coefficient():
    """Six replicates: where what is missing overlaps the dictionary, θ is the projection and not the coefficient."""
    scores = score([measure_cell(Cell("overlapping", "projected", "empirical", 6, 200, 200, 0))])
    row = scores["terms"].loc[("overlapping", "projected", "empirical", "y")]
    assert row["coverage"] == 0.0
    # 90 % intervals that hold at most two of six have probability 1e-3
    assert row["coverage_projection"] > 2 / 6
    assert abs(row["bias"] - row["projection"]) < 6 * row["sd"] / np.sqrt(6)
    assert scores["cells"]["correlation"].iloc[0] < 1e-6

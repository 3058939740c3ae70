import jax
import numpy as np

from bayes_greybox.criticism.calibration.coverage import places
from bayes_greybox.criticism.calibration.quantities import quantities
from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.inference.sampler.prior_data import draw_truths, open_equation
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.priors import RegularisedHorseshoe
from bayes_greybox.model.program import Program


def ranked(gp):
    """Names of what is ranked for the equations `y` and `y_dot`, the truths standing for two posterior draws each."""
    rng = np.random.default_rng(0)
    y, v = rng.uniform(-1, 1, (2, 30))
    data = Trajectories.from_arrays(
        np.arange(30.0),
        states={"y": y, "y_dot": v},
        derivatives={"y": v + 0.1 * rng.standard_normal(30), "y_dot": -y + 0.1 * rng.standard_normal(30)},
    )
    terms = {"y": ["y_dot", "y"], "y_dot": ["y", "y_dot"]}
    model = Program(terms, prior=RegularisedHorseshoe(), discrepancy=gp)
    opened = {name: open_equation(equation) for name, equation in model.assemble(data).items()}
    truths, targets = draw_truths(model, opened, 6, jax.random.key(0), rng)
    samples = {name: np.stack([value, value], axis=1) for name, value in truths.items()}
    where = {name: places(part.equation.frame, data) for name, part in opened.items()}
    found = list(quantities(opened, targets, truths, samples, where))
    for _, truth, drawn in found:
        np.testing.assert_allclose(drawn[:, 0], truth)
    return [name for name, *_ in found]


def test_each_quantity_is_ranked_once_and_raw_coordinates_not_at_all():
    names = ranked(OrthogonalGP(features=4))
    assert len(names) == len(set(names))
    assert {"y_sigma", "y_dot_sigma", "y_tau", "y_dot_tau", "y_dot_amplitude"} <= set(names)
    assert not {"y_noise", "y_dot_noise", "y_tau_unit", "y_dot_tau_unit"} & set(names)


def test_a_model_without_discrepancy_has_a_likelihood_to_rank():
    names = ranked(None)
    assert "y_dot_log_likelihood" in names and not any(name.endswith("f_rms") for name in names)

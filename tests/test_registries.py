"""What is listed in a registry can be chosen, configured, saved and loaded: a new kind is one file and its test."""

from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
import numpyro
import numpyro.distributions as dist
import pytest
from fabricated import fabricate

import bayes_greybox as bg
from bayes_greybox.config import load_config
from bayes_greybox.inference.kept.model_record import describe, rebuild
from bayes_greybox.model.gp.kernels import KERNELS, Kernel
from bayes_greybox.model.priors import PRIORS, Scales
from bayes_greybox.model.rows.derivative_rows import DerivativeRows
from bayes_greybox.model.rows.kinds import ROW_KINDS
from bayes_greybox.model.rows.row_kind import RowKind
from bayes_greybox.running.limits import Count, Positive, require_limits

BASE = """
[data]
system = "oscillator"
t = { stop = 10.0, points = 30 }

[dictionary]
ydot = ["y"]
"""


@dataclass(frozen=True)
class Cauchy:
    """A prior that the package does not have."""

    scale: Positive = 1.0
    powers: tuple[float, ...] = (1.0,)
    share: Positive | None = None

    def __post_init__(self):
        require_limits(self)

    def scales(self, n_term, n_obs, sigma):
        spread = numpyro.sample("spread", dist.HalfCauchy(self.scale).expand([n_term]).to_event(1))
        return Scales(jnp.asarray(spread))


@dataclass(frozen=True)
class EverySecond(RowKind):
    """Rows that the package does not have."""

    step: Count = 2

    def rows(self, data, equation, simulation):
        return DerivativeRows().rows(data, equation, simulation)


@pytest.fixture
def lists(monkeypatch):
    """The three registries, each with one entry more."""
    kernel = Kernel("rational", lambda r2: 1 / (1 + r2), KERNELS["matern52"].log_spectral_shape, 3.0)
    monkeypatch.setitem(KERNELS, "rational", kernel)
    monkeypatch.setitem(PRIORS, "cauchy", Cauchy)
    monkeypatch.setitem(ROW_KINDS, "every_second", EverySecond)


@pytest.fixture
def data():
    t = 0.1 * np.arange(20)
    return bg.Trajectories.from_arrays(t, states={"y": np.sin(t)}, derivatives={"y": np.cos(t)})


def configured(folder, text):
    (folder / "case.toml").write_text(BASE + text, encoding="utf-8")
    return load_config(folder / "case.toml")


ALL = """
[prior]
kind = "cauchy"
scale = 2
powers = [1.0, 3.0]

[discrepancy]
kernel = "rational"
features = 4

[rows]
kind = "every_second"
step = 3
"""


def test_new_kinds_are_configured(lists, tmp_path):
    model = configured(tmp_path, ALL).build_model()
    assert model.prior == Cauchy(2.0, (1.0, 3.0))
    assert model.rows == EverySecond(3)
    assert model.discrepancy == bg.OrthogonalGP(kernel="rational", features=4)
    assert configured(tmp_path, '[models.a.prior]\nkind = "cauchy"').build_model("a").prior == Cauchy()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (ALL.replace("scale = 2", "scale = 0"), r"\[prior\] scale = 0 cannot be used; it must be greater than 0"),
        (ALL.replace("scale", "scal"), r"\[prior\] unknown key 'scal'; did you mean 'scale'\?"),
        (ALL.replace("3.0]", '"x"]'), r"\[prior\] powers\[1\] = 'x' cannot be used; it must be a number"),
        (ALL.replace("cauchy", "cauchi"), r"\[prior\] kind = 'cauchi' is not available; did you mean 'cauchy'\?"),
        (ALL.replace("step = 3", "step = 0"), r"\[rows\] step = 0 cannot be used"),
        (ALL.replace("every_second", "every_secnd"), r"\[rows\] kind = 'every_secnd' is not .* 'every_second'\?"),
        (ALL.replace("rational", "rationale"), r"\[discrepancy\] kernel = 'rationale' is not .* 'rational'\?"),
        (
            ALL.replace('kind = "every_second"', ""),
            r"\[rows\] needs the key 'kind'; known: as-measured, derivative, trajectory, weak, every_second",
        ),
    ],
)
def test_mistakes_in_new_kinds_are_named(lists, tmp_path, text, words):
    with pytest.raises(bg.InputError, match=words):
        configured(tmp_path, text)


def test_new_kinds_are_saved_and_loaded(lists, data, tmp_path):
    model = bg.GreyBox(
        {"y": ["y", "y**2"]},
        prior=Cauchy(2.0, (1.0, 3.0)),
        rows=EverySecond(3),
        discrepancy=bg.OrthogonalGP(kernel="rational", features=4),
    )
    made = fabricate(model, data, weight=0.1 * np.ones((2, 3, 4)))
    fit = bg.Fit(made.model, made.data, made.sampling, made.idata)
    fit.save(tmp_path / "run.nc")
    again = bg.load(tmp_path / "run.nc")
    assert (again.model.prior, again.model.rows) == (model.prior, model.rows)
    assert again.model.discrepancy == model.discrepancy
    np.testing.assert_array_equal(again.predict(data).nmse()["y"], fit.predict(data).nmse()["y"])


def test_rows_of_the_users_own_are_refused_in_words_once_they_are_read_again(data):
    model = bg.GreyBox({"y": ["y"]}, rows=EverySecond(), discrepancy=None)
    record = describe(model, data)
    assert record["rows"] == {"kind": "own EverySecond"}
    again = rebuild(record)
    with pytest.raises(bg.InputError, match="rows were of a class of your own.*build the model again"):
        again.designs(data)


def test_registered_classes_are_what_their_lists_are_of():
    for kind in PRIORS.values():
        assert hasattr(kind(), "scales")
    for kind in ROW_KINDS.values():
        assert isinstance(kind(), RowKind)
    for name, kernel in KERNELS.items():
        assert kernel.name == name

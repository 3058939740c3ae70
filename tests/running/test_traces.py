"""Traces that are kept: the same draws, no trace in later processes, and never one that belongs to something else."""

import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import numpyro
import pytest

import bayes_greybox as bg
from bayes_greybox.inference.sampler import nuts
from bayes_greybox.inference.sampler.programs import programs_for
from bayes_greybox.inference.settings import Sampling
from bayes_greybox.inference.whole_rate import whole_rate
from bayes_greybox.model import priors
from bayes_greybox.model.algebra import linalg
from bayes_greybox.model.gp import kernels
from bayes_greybox.model.program import Program
from bayes_greybox.physics.simulation.reading import simulation_of
from bayes_greybox.running import compiling, identity, traces
from bayes_greybox.running.traces import kept

pytestmark = pytest.mark.skipif(
    os.environ.get(traces.CHECKED) == "1", reason="no traces are kept while shapes and types are checked in them"
)

MODULE = "bayes_greybox.model.gp.hyper"
"""Where the functions of these tests say that they are: of others no trace is kept."""

MODULES = (nuts.__name__, "bayes_greybox.model", "bayes_greybox.inference.sampler")

FIT = """
import json, logging, jax, numpy as np
traced, said = [], []
jax.monitoring.register_event_duration_secs_listener(lambda event, _, **more: traced.append((event, more)))
import bayes_greybox as bg

class Listen(logging.Handler):
    def emit(self, record):
        said.append(record.getMessage())

log = logging.getLogger("bayes_greybox.running.traces")
log.setLevel(logging.DEBUG)
log.addHandler(Listen())
x = np.linspace(-1, 1, 40)
data = bg.Trajectories.from_arrays(x, states={"x": x}, derivatives={"x": np.sin(3 * x) - 0.5 * x})
model = bg.GreyBox({"x": ["x", "x**3"]}, prior=bg.Normal(), discrepancy=bg.OrthogonalGP(features=4))
fit = model.fit(data, draws=20, tune=20, chains=2, seed=1, progress=False)
fit.checks()
followed = fit.simulate(data).states["x"].mean
values = {
    f"{group}/{name}": np.asarray(value, float).tobytes().hex()
    for group in ("posterior", "prior", "sample_stats", "log_prior")
    for name, value in fit.idata[group].dataset.data_vars.items()
}
values["free run"] = np.asarray(followed).tobytes().hex()
names = [str(more.get("fun_name")) for event, more in traced if event.endswith("jaxpr_trace_duration")]
print(json.dumps({"values": values, "said": said, "traced": names}))
"""

TRACED = {"first", "advance", "constrain", "draw_all", "one", "every", "follow"}
"""Functions that these are made of, and the programs of checks and free runs."""

PROGRAMS = ["start", "advance", "constrain", "conditional", "prior", "log_prior"]


def _fit(tmp_path, **environment):
    own = {k: v for k, v in os.environ.items() if not k.startswith(("JAX_", "BAYES_GREYBOX_"))}
    # Programs are compiled as those of the test run are; all three are the same in this.
    own |= {name: os.environ[name] for name in ("JAX_DISABLE_MOST_OPTIMIZATIONS",) if name in os.environ}
    own |= {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache"), **environment}
    ran = subprocess.run([sys.executable, "-W", "ignore", "-c", FIT], env=own, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return json.loads(ran.stdout.splitlines()[-1])


def _files(tmp_path):
    return sorted(tmp_path.rglob("*-trace"))


class Processes(NamedTuple):
    """What three processes said, one after the other, and the traces that were there after the first two."""

    without: dict
    first: dict
    second: dict
    files: list
    ours: list


@pytest.fixture(scope="module")
def processes(tmp_path_factory):
    """The first has a folder that only JAX was told of; the others have one of ours, too."""
    folder = tmp_path_factory.mktemp("processes")
    told = {
        "JAX_COMPILATION_CACHE_DIR": str(folder / "theirs"),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    }
    without, files = _fit(folder, **told), _files(folder)
    told["BAYES_GREYBOX_CACHE"] = str(folder / "ours")
    first, ours = _fit(folder, **told), _files(folder)
    return Processes(without, first, _fit(folder, **told), files, ours)


@pytest.mark.slow
def test_a_later_process_traces_nothing_and_draws_the_same(processes):
    without, first, second = processes[:3]
    assert TRACED <= set(without["traced"])
    assert first["said"][:6] == [f"{name}: traced now" for name in PROGRAMS]
    assert second["said"][:6] == [f"{name}: the trace was kept" for name in PROGRAMS]
    assert {"sensitivity: the trace was kept", "follow: the trace was kept"} <= set(second["said"])
    assert all(said.endswith("the trace was kept") for said in second["said"])
    assert not TRACED & set(second["traced"])
    # The program is the same; whether it is inlined or called, the compiler makes the same of it.
    assert without["values"] == first["values"] == second["values"]


@pytest.mark.slow
def test_nothing_of_ours_goes_where_only_jax_was_told_to_keep_programs(processes):
    assert not processes.files
    assert processes.ours and all("ours" in file.parts for file in processes.ours)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder for traces, as in a process without checks of types that began a while ago."""
    monkeypatch.setattr(traces, "keep_programs", lambda: tmp_path)
    monkeypatch.delenv(traces.CHECKED, raising=False)
    monkeypatch.setattr(bg, "_SINCE", time.time() + 60)
    return tmp_path


def _counted(found, identity=(), once=False):
    """A program, kept, and the list of what it was traced for."""

    def double(x, more):
        found.append(x.shape)
        return {"double": 2 * x, "more": [more["a"] + 1, ()]}

    double.__module__ = MODULE
    return kept(double, identity, "double", once=once)


def _same(got, x):
    assert got["more"][1] == () and float(got["more"][0]) == 2.0
    np.testing.assert_array_equal(got["double"], 2 * np.asarray(x))


@pytest.mark.parametrize("once", [False, True])
def test_values_are_those_of_the_function_and_it_is_traced_once(folder, once):
    traced = []
    for _ in range(2):
        program = _counted(traced, once=once)
        for shape in ((3,), (3,), (4,)):
            _same(program(jnp.ones(shape), {"a": 1.0}), jnp.ones(shape))
    assert traced == [(3,), (4,)] and len(_files(folder)) == 2


def test_without_an_identity_nothing_is_kept(folder):
    traced = []
    _same(_counted(traced, None)(jnp.ones(3), {"a": 1.0}), jnp.ones(3))
    assert traced and not _files(folder)


def test_while_types_are_checked_nothing_is_kept(folder, monkeypatch):
    monkeypatch.setenv(traces.CHECKED, "1")
    traced = []
    _same(_counted(traced)(jnp.ones(3), {"a": 1.0}), jnp.ones(3))
    assert traced and not _files(folder)


def test_a_function_from_elsewhere_has_no_trace_kept(folder):
    assert float(kept(lambda x: 2 * x, (), "double")(1.0)) == 2.0
    assert not _files(folder)


@pytest.mark.parametrize("damage", ["empty", "cut", "changed", "another", "folder"])
def test_a_damaged_file_is_ignored_and_replaced(folder, damage):
    traced = []
    for n in (3, 4):
        _counted(traced)(jnp.ones(n), {"a": 1.0})
    file, other = _files(folder)
    whole = file.read_bytes()
    made = {"empty": b"", "cut": whole[:-100], "changed": whole[:-1] + b"?", "another": other.read_bytes()}
    file.unlink()
    if damage == "folder":
        file.mkdir()
    else:
        file.write_bytes(made[damage])
    for _ in range(2):
        for n in (3, 4):
            _same(_counted(traced)(jnp.ones(n), {"a": 1.0}), jnp.ones(n))
    assert len(traced) == (4 if damage == "folder" else 3)
    assert set(folder.iterdir()) == {file, other}


def test_a_trace_that_cannot_be_written_is_no_error(folder, monkeypatch):
    monkeypatch.setattr(traces, "keep_programs", lambda: folder / "none")
    _same(_counted([])(jnp.ones(3), {"a": 1.0}), jnp.ones(3))


def test_a_trace_that_does_not_run_is_no_error(folder, monkeypatch):
    _counted([])(jnp.ones(3), {"a": 1.0})
    other = jax.export.export(jax.jit(lambda x: x))(jnp.ones(7))
    monkeypatch.setattr(traces, "_stored", lambda *_: other)
    for _ in range(2):
        _same(_counted([])(jnp.ones(3), {"a": 1.0}), jnp.ones(3))


class Pair(NamedTuple):
    x: object


def test_what_jax_cannot_write_down_runs_all_the_same(folder):
    def pair(x):
        return Pair(2 * x)

    def called(x):
        return jax.pure_callback(lambda x: np.asarray(x), jax.ShapeDtypeStruct((), float), x)

    pair.__module__ = called.__module__ = MODULE
    assert float(kept(pair, (), "pair")(jnp.ones(())).x) == 2.0
    assert float(kept(called, (), "called")(jnp.ones(()))) == 1.0
    assert not _files(folder)


def test_linear_algebra_is_kept(folder):
    def solve(A):
        return jnp.linalg.cholesky(A), jnp.linalg.eigh(A)[0], jnp.linalg.qr(A)[1], jnp.linalg.svd(A)[1]

    solve.__module__ = MODULE
    A = jnp.array([[2.0, 0.5], [0.5, 1.0]])
    got = kept(solve, (), "solve")(A)
    assert _files(folder)
    for one, other in zip(got, solve(A), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


MODEL = Program({"x": ["x", "x**3"]}, prior=priors.Normal(), discrepancy=bg.OrthogonalGP(features=4))


@pytest.fixture
def design():
    x = np.linspace(-1, 1, 40)
    data = bg.Trajectories.from_arrays(x, states={"x": x}, derivatives={"x": np.sin(3 * x)})
    return MODEL.assemble(data)["x"].design


def _name(*arguments, model=MODEL, name="start", tune=100):
    leaves, tree = jax.tree.flatten(arguments)
    return identity.name_of(name, MODULES, (model.bare, tune, 0.8), leaves, tree)


def test_what_a_trace_depends_on_is_in_its_name(folder, design, monkeypatch):
    key = jax.random.PRNGKey(0)
    names = [_name({"x": design}, key)]
    assert names[0] == _name({"x": design.with_target(design.y + 1)}, jax.random.PRNGKey(1))
    names += [
        _name({"x": design}, key, name="advance"),
        _name({"x": design}, key, tune=101),
        _name({"x": design}, key, tune=100.0),
        _name({"y": design}, key),
        _name({"x": design}, 0),
        _name({"x": design}, jnp.zeros((), int)),
        _name({"x": design}, key.astype(jnp.int32)),
        _name({"x": replace(design, y=design.y[1:])}, key),
        _name({"x": replace(design, kernel="matern32")}, key),
        _name({"x": replace(design, coefficients=replace(design.coefficients, certain=(0,)))}, key),
        _name({"x": design}, key, model=replace(MODEL, prior=priors.Normal(2.0))),
        _name({"x": design}, key, model=replace(MODEL, prior=priors.Laplace())),
        _name({"x": design}, key, model=replace(MODEL, discrepancy=None)),
        _name({"x": design}, key, model=replace(MODEL, noise=0.3)),
    ]
    with jax.default_matmul_precision("float32"):
        names.append(_name({"x": design}, key))
    with jax.debug_nans(True):
        names.append(_name({"x": design}, key))
    changed = (
        (numpyro, "__version__", "9.9"),
        (jax, "__version__", "9.9"),
        (nuts, "ITERATIONS_PER_CHUNK", 10),
        (linalg, "RELATIVE_JITTER", 1.0),
        (numpyro.distributions.Distribution, "_validate_args", "as never before"),
        (linalg, "jittered_cholesky", linalg.solve_lower),
    )
    for where, what, value in changed:
        with monkeypatch.context() as patched:
            patched.setattr(where, what, value)
            names.append(_name({"x": design}, key))
    with monkeypatch.context() as patched:
        patched.setitem(kernels.KERNELS, "matern32", kernels._matern("matern32", 1.6, lambda r: 1 + r, 3.42, 4.5))
        # A lambda of a test is one from elsewhere.
        assert _name({"x": design}, key) is None
        patched.setitem(kernels.KERNELS, "matern32", kernels.KERNELS["matern52"])
        names.append(_name({"x": design}, key))
    assert None not in names
    assert [names.index(name) for name in names] == list(range(len(names)))
    assert _name({"x": design}, key) == names[0]


def test_what_cannot_be_stated_has_no_name(folder, design, monkeypatch):
    key = jax.random.PRNGKey(0)

    class Mine(priors.Normal):
        pass

    assert _name({"x": design}, key, model=replace(MODEL, prior=Mine())) is None
    assert _name({"x": design}, key, model=replace(MODEL, prior=bg.CustomPrior(lambda n: jnp.ones(n)))) is None
    assert _name({"x": design}, jax.random.key(0)) is None
    assert _name({"x": design}, key, tune=object()) is None
    with numpyro.handlers.seed(rng_seed=0):
        assert _name({"x": design}, key) is None
    with monkeypatch.context() as patched:
        patched.setattr(priors.Normal, "scales", lambda *_: None)
        assert _name({"x": design}, key) is None
    with monkeypatch.context() as patched:
        patched.setattr(nuts, "hmc_record", lambda _: {})
        assert _name({"x": design}, key) is None
    assert _name({"x": design}, key) is not None


def test_source_is_in_the_name(folder, tmp_path, monkeypatch):
    package = tmp_path / "package"
    (package / "running").mkdir(parents=True)
    (package / "running" / "identity.py").write_text("x = 1")
    monkeypatch.setattr(identity, "__file__", str(package / "running" / "identity.py"))
    names = {identity.sources()}
    stamp = (package / "running" / "identity.py").stat().st_mtime_ns
    (package / "running" / "identity.py").write_text("x = 2")
    os.utime(package / "running" / "identity.py", ns=(stamp, stamp))
    names.add(identity.sources())
    (package / "other.py").write_text("")
    names.add(identity.sources())
    assert len(names) == 3
    # A process that began before its source was changed runs the older one.
    monkeypatch.setattr(bg, "_SINCE", time.time() - 60)
    with pytest.raises(identity.Unkept):
        identity.sources()


def test_the_rate_of_a_free_run_is_told_to_the_last_digit_and_code_is_not():
    columns = {"x": np.linspace(-1, 1, 5)}
    keys = []
    for number in ("0.3", "0.30000000000000004"):
        simulation = simulation_of({"x": f"-{number}*x"}, ("x",), ())
        keys.append(whole_rate(simulation, {}, columns).identity)
    assert identity.stated(keys[0]) != identity.stated(keys[1])
    with pytest.raises(identity.Unkept):
        identity.stated(whole_rate(simulation_of(lambda t, x, u: -x, ("x",), ()), {}, columns).identity)


@pytest.mark.parametrize(
    "one, other",
    [(1, 1.0), (1, True), ("1", 1), ((1, 2), [1, 2]), ((1, (2, 3)), ((1, 2), 3)), (0.1, np.float64(0.1)), (0.0, -0.0)],
)
def test_different_values_are_told_apart(one, other):
    assert repr(identity.stated(one)) != repr(identity.stated(other))


def test_long_arrays_are_told_whole():
    one, other = np.zeros(10_000), np.zeros(10_000)
    other[5_000] = 1e-9
    assert identity.stated(one) != identity.stated(other)
    with pytest.raises(identity.Unkept):
        identity.stated(np.array([object()]))


@pytest.mark.slow
def test_a_prior_of_the_users_own_is_never_kept(folder, monkeypatch):
    x = np.linspace(-1, 1, 4)
    data = bg.Trajectories.from_arrays(x, states={"x": x}, derivatives={"x": x})
    own = Program(
        {"x": ["x"]}, prior=bg.CustomPrior(lambda n: numpyro.deterministic("sd", jnp.ones(n))), discrepancy=None
    )
    designs = {"x": own.assemble(data)["x"].design}
    asked = []
    monkeypatch.setattr(traces, "name_of", lambda *given: asked.append(given[0]))
    run = dict(draws=4, chains=1, key=jax.random.PRNGKey(0), progress=False)
    programs_for(own, designs, Sampling(tune=4)).chains.run(designs, **run)
    assert not asked
    programs_for(replace(own, prior=priors.Normal(1.5)), designs, Sampling(tune=4)).chains.run(designs, **run)
    assert asked == ["start", "advance", "constrain"]


def test_the_folder_is_the_one_of_compiled_programs(tmp_path, monkeypatch):
    monkeypatch.setenv(compiling.FOLDER, str(tmp_path))
    assert compiling.keep_programs.__wrapped__().parent == Path(tmp_path) / compiling.CACHE_SUBFOLDER
    monkeypatch.setenv(compiling.FOLDER, "off")
    assert compiling.keep_programs.__wrapped__() is None


def test_a_function_of_no_module_is_not_trusted():
    def function(x):
        return x

    function.__module__ = None
    with pytest.raises(identity.Unkept):
        identity._function(function, MODULE)

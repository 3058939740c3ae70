"""Compiled programs: right, lazy, quickly made where XLA knows how, and kept where the user wants them."""

import os
import subprocess
import sys
from functools import partial

import jax
import jax.numpy as jnp
import pytest

import bayes_greybox.model  # noqa: F401 - from here on in 64 bits, whichever file comes first
from bayes_greybox.running import compiling
from bayes_greybox.running.compiling import compiled


@pytest.mark.parametrize("runs", [{}, {"once": True}, {"often": True}], ids=["some", "once", "often"])
def test_values_are_those_of_the_function(runs):
    @partial(compiled, **runs, static_argnames="power")
    def root(x, power):
        return jnp.sum(jnp.abs(x) ** (1 / power))

    x = jnp.arange(5.0)
    assert float(root(x, power=2)) == pytest.approx(sum(i**0.5 for i in range(5)), rel=1e-14)


def test_what_runs_often_is_optimised_whatever_jax_was_told():
    if compiling.compile_options(False) is None:
        pytest.skip("This XLA has none of these options.")
    levels = [
        compiling.compile_options(*runs).get("xla_backend_optimization_level") for runs in [(False, True), (True,)]
    ]
    assert levels[0] > levels[1] == 0


def test_same_shapes_are_traced_once():
    traced = []

    @compiled
    def double(x):
        traced.append(x.shape)
        return 2 * x

    for shape in ((3,), (3,), (4,)):
        double(jnp.ones(shape))
    assert traced == [(3,), (4,)]


def test_options_that_this_xla_does_not_know_are_left_out(monkeypatch):
    monkeypatch.setattr(compiling, "FAST", {"xla_no_such_option": True})
    compiling.compile_options.cache_clear()
    assert compiling.compile_options(False) is None
    assert float(compiled(lambda x: x + 1)(1.0)) == 2.0
    compiling.compile_options.cache_clear()


PROGRAM = """
import jax, jax.numpy as jnp
import bayes_greybox.model  # noqa: F401 - from here on in 64 bits, whichever file comes first
from bayes_greybox.running import compiling
compiling.compiled(lambda x: jnp.linalg.cholesky(x @ x.T + jnp.eye(3)))(jnp.ones((3, 3)))
print(jax.config.jax_compilation_cache_dir)
"""


def _kept(tmp_path, **environment):
    own = {k: v for k, v in os.environ.items() if not k.startswith("JAX_")}
    own |= {"HOME": str(tmp_path), "XDG_CACHE_HOME": str(tmp_path / "cache"), **environment}
    found = subprocess.run([sys.executable, "-c", PROGRAM], env=own, capture_output=True, text=True, check=True)
    return found.stdout.strip(), [file for file in tmp_path.rglob("*-cache") if file.is_file()]


def test_programs_are_kept_in_the_users_cache(tmp_path):
    folder, files = _kept(tmp_path)
    assert folder.startswith(str(tmp_path)) and files


def test_a_folder_that_is_named_gets_one_of_ours_inside(tmp_path):
    folder, files = _kept(tmp_path, BAYES_GREYBOX_CACHE=str(tmp_path / "mine"))
    assert folder.startswith(str(tmp_path / "mine" / compiling.CACHE_SUBFOLDER)) and files


@pytest.fixture
def told():
    """Tells JAX of a folder, or of none, until the end of the test."""
    before = jax.config.jax_compilation_cache_dir
    yield lambda folder: jax.config.update("jax_compilation_cache_dir", folder)
    jax.config.update("jax_compilation_cache_dir", before)


def test_programs_are_not_kept_where_the_user_says_so(told, monkeypatch):
    told(None)
    monkeypatch.setenv(compiling.FOLDER, "off")
    assert compiling.keep_programs.__wrapped__() is None and jax.config.jax_compilation_cache_dir is None


def test_jax_keeps_programs_where_it_was_told(told, tmp_path, monkeypatch):
    told(str(tmp_path / "theirs"))
    monkeypatch.delenv(compiling.FOLDER, raising=False)
    assert compiling.keep_programs.__wrapped__() is None
    assert jax.config.jax_compilation_cache_dir == str(tmp_path / "theirs")


def test_a_cache_is_bounded(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling, "CACHE_LIMIT_BYTES", 250)
    (tmp_path / "machine").mkdir()
    for i in range(4):
        file = tmp_path / "machine" / f"{i}-{'trace' if i % 2 else 'cache'}"
        file.write_bytes(bytes(100))
        os.utime(file, (1000 + i, 1000 + i))
    compiling._prune(tmp_path)
    assert sorted(file.name for file in tmp_path.glob("*/*")) == ["2-cache", "3-trace"]


def test_what_is_not_ours_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(compiling, "CACHE_LIMIT_BYTES", 0)
    (tmp_path / "machine" / "folder-cache").mkdir(parents=True)
    (tmp_path / "machine" / "thesis.txt").write_bytes(bytes(100))
    compiling._prune(tmp_path)
    assert (tmp_path / "machine" / "thesis.txt").exists() and (tmp_path / "machine" / "folder-cache").exists()


def test_a_home_that_cannot_be_written_to_is_no_error(told, tmp_path, monkeypatch):
    told(None)
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv(compiling.FOLDER, str(tmp_path / "file" / "below"))
    assert compiling.keep_programs.__wrapped__() is None and jax.config.jax_compilation_cache_dir is None


def test_64_bits_stay(tmp_path):
    assert compiled(lambda x: x + 1)(jnp.float64(1.0)).dtype == jax.dtypes.canonicalize_dtype("float64")


def test_programs_are_let_go_where_they_take_what_a_process_may_have(tmp_path, monkeypatch):
    # A process that did many studies died in the compiler, which found no memory to map.
    traced = []

    @compiled
    def double(x):
        traced.append(x.shape)
        return 2 * x

    allowed, mappings = tmp_path / "max_map_count", tmp_path / "maps"
    monkeypatch.setattr(compiling, "ALLOWED", allowed)
    monkeypatch.setattr(compiling, "OWN_MAPPINGS", mappings)
    assert not compiling.make_room(), "a system that says nothing of mappings has no bound"
    allowed.write_text("30\n")
    mappings.write_text("one\n" * 9)
    double(jnp.ones(3))
    assert not compiling.make_room()
    double(jnp.ones(3))
    assert len(traced) == 1
    mappings.write_text("one\n" * 11)
    assert compiling.make_room()
    assert float(double(jnp.ones(3))[0]) == 2.0
    assert len(traced) == 2


@pytest.mark.skipif(not compiling.OWN_MAPPINGS.exists(), reason="This system does not say what a process has mapped.")
def test_letting_go_gives_mappings_back():
    def mapped():
        return len(compiling.OWN_MAPPINGS.read_bytes().splitlines())

    before = mapped()
    functions = [compiled(partial(jnp.polyval, jnp.arange(float(k)))) for k in range(2, 22)]
    kept = [function(jnp.ones(k)) for k, function in enumerate(functions, 2)]
    taken = mapped() - before
    jax.clear_caches()
    assert len(kept) == 20 and mapped() - before < taken / 2

"""No configuration or catalogue crashes the package, hangs it, is executed or writes anything."""

import probes
from hypothesis import given, settings
from hypothesis import strategies as st
from inputs import CATALOGUES, CONFIGS, ROOT, broken, mutated

SETTINGS = settings(derandomize=True, deadline=None, max_examples=60, database=None)
CONFIG_FILES = sorted((ROOT / "configs").glob("*.toml"))
CATALOGUE_FILES = sorted((ROOT / "bayes_greybox/physics/catalogue").glob("*.toml"))


@SETTINGS
@given(text=st.one_of(mutated(CONFIGS), broken(CONFIG_FILES)))
def test_configurations_are_read_or_refused(tmp_path_factory, text):
    probes.config(text, folder(tmp_path_factory))


@SETTINGS
@given(text=st.one_of(mutated(CATALOGUES), broken(CATALOGUE_FILES)))
def test_so_are_catalogues(tmp_path_factory, text):
    probes.catalogue(text, folder(tmp_path_factory))


_folders = {}


def folder(tmp_path_factory):
    """One for all examples."""
    return _folders.setdefault("one", tmp_path_factory.mktemp("toml"))

"""The lowest versions that are declared are the ones that CI installs."""

import re
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

ROOT = Path(__file__).parents[1]
LOWEST = ROOT / ".ci" / "lowest.txt"


def _declared():
    """Lower bounds of the package and of what its tests need, on the lowest Python."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    (python,) = re.findall(r">=([\d.]+)", project["requires-python"])
    extras = project["optional-dependencies"]
    bounds = {}
    for line in [*project["dependencies"], *extras["test"], *extras["tables"], *extras["distributed"], *extras["fmu"]]:
        need = Requirement(line)
        if need.name == project["name"] or (need.marker and not need.marker.evaluate({"python_version": python})):
            continue
        (bounds[canonicalize_name(need.name)],) = (Version(s.version) for s in need.specifier if s.operator == ">=")
    return bounds


@pytest.mark.skipif(not LOWEST.exists(), reason="a source distribution has no .ci")
def test_lowest_versions_are_the_declared_ones():
    declared, held_back = LOWEST.read_text().split("\n\n")
    pins = [
        dict(line.split("==") for line in part.splitlines() if not line.startswith("#"))
        for part in (declared, held_back)
    ]
    assert {canonicalize_name(name): Version(version) for name, version in pins[0].items()} == _declared()
    assert not set(pins[1]) & set(_declared())

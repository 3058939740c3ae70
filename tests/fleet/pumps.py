"""Three small machines of one kind, of which one lacks nothing, for tests of fleets."""

import numpy as np
import pandas as pd

import bayes_greybox as bg

CONFIG = """
[data]
path = "any.csv"
time = "t"
states = ["y", "ydot"]
inputs = ["F"]
derivatives = { ydot = "a" }
test_fraction = 0.3

[simulation]
y = "ydot"
ydot = "F - 10*y - 0.5*ydot"

[discrepancy]
variables = ["y"]

[study]
catalogue = "few.toml"
settle = false
free_runs = false

[output]
figures = false
"""

CATALOGUE = """
[[effect]]
slug = "cubic-stiffness"
name = "Cubic stiffness"
expression = "position**3"
meaning = "The spring hardens."

[[effect]]
slug = "quadratic-stiffness"
name = "Quadratic stiffness"
expression = "position**2"
meaning = "The spring is not the same both ways."
"""


def pumps(folder):
    """A folder with pumps/, all.toml and the catalogue that it names; itself."""
    (folder / "pumps").mkdir()
    (folder / "all.toml").write_text(CONFIG, encoding="utf-8")
    (folder / "few.toml").write_text(CATALOGUE, encoding="utf-8")
    for k, k3 in enumerate((40.0, 0.0, 44.0)):
        write_asset(folder / "pumps" / f"pump {k}.csv", k3, seed=k)
    return folder


def write_asset(path, k3, seed):
    data = bg.systems.duffing(k3=k3).simulate(t=np.linspace(0, 20, 161), noise=0.05, seed=seed)
    columns = {"t": data.time, "y": data.column("y"), "ydot": data.column("ydot"), "F": data.column("F")}
    pd.DataFrame({**columns, "a": data.derivatives["ydot"]}).to_csv(path, index=False)

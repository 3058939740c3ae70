"""Learned systems made by hand, which exported programs are compared on."""

import numpy as np

import bayes_greybox as bg
from bayes_greybox.equations.learned import Drawn, LearnedEquation, LearnedSystem, LearnedTerm, Value
from bayes_greybox.physics.simulation.reading import simulation_of

CLOSE = {"rtol": 1e-8, "atol": 1e-12}
TERMS = [
    "y**3", "sign(v)", "abs(v)*v", "max(abs(y) - 0.3, 0, v)", "heaviside(y - 0.1)", "tanh(v/0.30000000000000004)",
    "sqrt(abs(y))", "1/(1 + y**2)", "y**-2", "abs(y)**(1/3)", "exp(-y)*sin(pi*v)", "-y", "y - 0.2", "10**12*y", "1",
    "abs(v)**-1.5", "2*y/3", "min(y, v, z)", "(-y)**2/(v*z)", "cos(v)", "tan(y/3)", "asin(tanh(y))", "acos(tanh(v))",
    "atan(v)", "sinh(y)", "cosh(y)", "log(1 + y**2)", "2**y", "log(2)*y", "sin(y + pi/4)",
    "abs(sign(v) - sign(y))*y", "y*(v - 1)**2", "-(y + 1)*sqrt(2)/z",
]  # fmt: skip


def system_of(simulation, terms, states=("y", "v", "z"), inputs=("F",), equation="v", units=None):
    rng = np.random.default_rng(0)
    data = bg.Trajectories.from_arrays(
        np.arange(5.0),
        states={n: rng.uniform(1, 2, 5) for n in states},
        inputs={n: rng.uniform(1, 2, 5) for n in inputs},
        units=units,
    )
    made = [bg.Term(text) for text in terms]
    learned = tuple(
        LearnedTerm(t.name, t, Value(m, 0.1, m - 0.2, m + 0.2), "1", 0.9)
        for t, m in zip(made, rng.normal(0, 1, len(made)), strict=True)
    )
    drawn = Drawn(tuple(made), np.zeros((1, len(made))), np.zeros((1, 0)))
    known = simulation_of(simulation, states, inputs)
    return LearnedSystem("fit", known, data, {equation: LearnedEquation(learned, (), None, None, drawn)}, "Rule.")


MEMORY = {"y": "v", "v": "F - 2*y - 0.1*v", "z": "v - (abs(v)*z + v*abs(z))/(2*0.3)"}
HOSTILE = ("double", "x", "der", "ω", "M_PI", "y1", "time")
CASES = {
    "every function": (MEMORY, TERMS, ("y", "v", "z"), ("F",), "v"),
    "hostile names": (
        {HOSTILE[0]: "x", "x": "u - 2*double*ω", "der": "y1 - time", "ω": "-ω*u", "M_PI": "x*dxdt",
         "y1": "y0", "time": "der"},
        ["double**3", "abs(ω)*der", "time*y1"], HOSTILE, ("u", "y0", "dxdt"), "x",
    ),
}  # fmt: skip


def points(system, n=100):
    rng = np.random.default_rng(1)
    x, u = rng.uniform(0.05, 1.5, (n, len(system.states))), rng.uniform(-1, 1, (n, len(system.inputs)))
    return x * rng.choice([-1, 1], x.shape), u

"""Exported programs say what the package's own right-hand side says, to 1e-8."""

import ctypes
import shutil
import subprocess
from types import MappingProxyType

import numpy as np
import pytest

import bayes_greybox as bg
from bayes_greybox.criticism.equations.learned import Drawn, LearnedEquation, LearnedSystem, LearnedTerm, Value
from bayes_greybox.criticism.equations.rates import learned_rates
from bayes_greybox.data.errors import InputError
from bayes_greybox.physics.simulation.reading import simulation_of
from bayes_greybox.report.exports.door import export_system
from bayes_greybox.report.exports.model import Notes

CLOSE = {"rtol": 1e-8, "atol": 1e-12}
TERMS = [
    "y**3", "sign(v)", "abs(v)*v", "max(abs(y) - 0.3, 0, v)", "heaviside(y - 0.1)", "tanh(v/0.30000000000000004)",
    "sqrt(abs(y))", "1/(1 + y**2)", "y**-2", "abs(y)**(1/3)", "exp(-y)*sin(pi*v)", "-y", "y - 0.2", "10**12*y", "1",
    "abs(v)**-1.5", "2*y/3", "y**v*0 + min(y, v)", "(-y)**2/(v*z)",
]  # fmt: skip


def system_of(simulation, terms, states=("y", "v", "z"), inputs=("F",), equation="v"):
    rng = np.random.default_rng(0)
    data = bg.Trajectories.from_arrays(
        np.arange(5.0),
        states={n: rng.uniform(1, 2, 5) for n in states},
        inputs={n: rng.uniform(1, 2, 5) for n in inputs},
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
HOSTILE = ("double", "x", "der", "ω", "lambda_", "y1", "time")
CASES = {
    "every function": (MEMORY, [t for t in TERMS if "y**v" not in t], ("y", "v", "z"), ("F",), "v"),
    "hostile names": (
        {HOSTILE[0]: "x", "x": "u - 2*double*ω", "der": "y1 - time", "ω": "-ω*u", "lambda_": "x*dxdt",
         "y1": "y0", "time": "der"},
        ["double**3", "abs(ω)*der", "time*y1"], HOSTILE, ("u", "y0", "dxdt"), "x",
    ),
}  # fmt: skip


def points(system, n=100):
    rng = np.random.default_rng(1)
    x, u = rng.uniform(0.05, 1.5, (n, len(system.states))), rng.uniform(-1, 1, (n, len(system.inputs)))
    return x * rng.choice([-1, 1], x.shape), u


def by_python(path):
    program = {}
    exec(path.read_text(encoding="utf-8"), program)
    return program["rhs"]


@pytest.mark.parametrize("case", CASES)
def test_python_and_c_compute_the_packages_rates(case, tmp_path):
    system = system_of(*CASES[case])
    x, u = points(system)
    own = learned_rates(system)(0.0, x, u)
    assert np.all(np.isfinite(own))
    export_system(system, tmp_path / "m.py", Notes("No */ end."))
    rhs = by_python(tmp_path / "m.py")
    np.testing.assert_allclose(rhs(0.0, x.T, u.T).T, own, **CLOSE)
    np.testing.assert_allclose(rhs(0.0, x[0], u[0]), own[0], **CLOSE)
    export_system(system, tmp_path / "m.c", Notes("No */ end."))
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC"]
    subprocess.run([compiler, *strict, "-o", tmp_path / "m.so", tmp_path / "m.c", "-lm"], check=True)
    function = ctypes.CDLL(str(tmp_path / "m.so")).m_rhs
    found, vector = np.zeros_like(own), ctypes.POINTER(ctypes.c_double)
    function.argtypes = [ctypes.c_double, vector, vector, vector]
    for row in range(len(x)):
        function(
            0.0,
            *(np.ascontiguousarray(a[row]).ctypes.data_as(vector) for a in (x, u)),
            found[row].ctypes.data_as(vector),
        )
    np.testing.assert_allclose(found, own, **CLOSE)


@pytest.mark.parametrize("case", CASES)
def test_modelica_says_the_packages_rates(case, tmp_path):
    """Read by pymoca's parser of the Modelica grammar, evaluated over its syntax tree."""
    parser = pytest.importorskip("pymoca.parser", reason="pymoca is not installed")
    system = system_of(*CASES[case])
    x, u = points(system)
    export_system(system, tmp_path / "m.mo", Notes('A "quoted" verdict \\'))
    model = parser.parse((tmp_path / "m.mo").read_text()).classes["m"]
    kinds = {
        name: next((kind for kind in ("parameter", "input") if kind in symbol.prefixes), "state")
        for name, symbol in model.symbols.items()
    }
    columns = dict(zip([n for n, kind in kinds.items() if kind == "state"], x.T, strict=True))
    columns |= dict(zip([n for n, kind in kinds.items() if kind == "input"], u.T, strict=True))
    columns |= {n: value(bound(model.symbols[n]), {}) for n, kind in kinds.items() if kind == "parameter"}
    found = [np.broadcast_to(value(e.right, columns), len(x)) for e in model.equations]
    np.testing.assert_allclose(np.stack(found, axis=-1), learned_rates(system)(0.0, x, u), **CLOSE)


OPERATORS = MappingProxyType({
    "+": lambda a, b=None: a if b is None else a + b, "-": lambda a, b=None: -a if b is None else a - b,
    "*": np.multiply, "/": np.divide, "^": lambda a, b: np.asarray(a, float) ** b, ">": np.greater, "<": np.less,
    "sign": np.sign, "abs": np.abs, "max": np.maximum, "min": np.minimum, "tanh": np.tanh, "sqrt": np.sqrt,
    "exp": np.exp, "sin": np.sin,
})  # fmt: skip


def bound(symbol):
    """What is declared of a parameter."""
    arguments = (each.value for each in symbol.class_modification.arguments)
    return next(each.modifications[0] for each in arguments if each.component.name == "value")


def value(node, columns):
    kind = type(node).__name__
    if kind == "Primary":
        return node.value
    if kind == "ComponentRef":
        return columns[node.name]
    if kind == "IfExpression":
        found = value(node.expressions[-1], columns)
        for when, then in reversed(list(zip(node.conditions, node.expressions, strict=False))):
            found = np.where(value(when, columns), value(then, columns), found)
        return found
    name = node.operator if isinstance(node.operator, str) else node.operator.name
    return OPERATORS[name](*(value(each, columns) for each in node.operands))


def test_a_simulation_that_is_code_goes_into_python_beside_the_terms_and_nowhere_else(tmp_path):
    def code(t, x, u):
        return np.array([x[1], u[0] - 0.3 * x[1], -x[2]])

    system = system_of(code, ["y**3"])
    export_system(system, tmp_path / "m.py", Notes())
    x, u = points(system, 1)
    own = learned_rates(system)(0.0, x, u)[0]
    np.testing.assert_allclose(by_python(tmp_path / "m.py")(0.0, x[0], u[0], simulation=code), own, **CLOSE)
    for ending in ("c", "mo"):
        with pytest.raises(InputError, match="give it as formulas"):
            export_system(system, tmp_path / f"m.{ending}", Notes())


def test_an_unknown_ending_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"use one of \.py, \.c, \.mo"):
        export_system(system_of(MEMORY, ["y"]), tmp_path / "m.f90", Notes())


def test_a_study_exports_its_amended_model_with_its_sentence(study, tmp_path):
    study.export(tmp_path / "amended.py")
    text = (tmp_path / "amended.py").read_text(encoding="utf-8")
    assert study.sentence[:40] in text and "±" in text
    x, u = np.random.default_rng(0).uniform(-1, 1, (20, 2)), np.random.default_rng(1).uniform(-1, 1, (20, 1))
    np.testing.assert_allclose(
        by_python(tmp_path / "amended.py")(0.0, x.T, u.T).T, study.to_callable()(0.0, x, u), **CLOSE
    )
    study.fit.export(tmp_path / "fit.c")
    assert "void fit_rhs(" in (tmp_path / "fit.c").read_text()

"""Exported programs say what the package's own right-hand side says, to 1e-8."""

import ctypes
import re
import shutil
import subprocess
from dataclasses import replace
from types import MappingProxyType

import numpy as np
import pytest
from exported_systems import CASES, CLOSE, MEMORY, TERMS, points, system_of
from pymoca import parser

import bayes_greybox as bg
from bayes_greybox.equations.learned import Drawn, InnerValue, LearnedSystem, Value, parameters_of
from bayes_greybox.equations.rates import learned_rates
from bayes_greybox.physics.formula.functions import FUNCTIONS
from bayes_greybox.physics.simulation.reading import simulation_of
from bayes_greybox.report.exports.door import export_system
from bayes_greybox.report.exports.model import Notes
from bayes_greybox.running.errors import InputError


def by_python(path):
    program = {}
    exec(path.read_text(encoding="utf-8"), program)
    return program["rhs"]


def by_c(path, name, x, u, n):
    """Values [n_row, n] of a compiled function."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler")
    # The standard itself, and what compilers do by default, whose math.h has more names.
    for standard in ("gnu99", "c99"):
        strict = [f"-std={standard}", "-Wall", "-Wextra", "-Werror", "-pedantic", "-shared", "-fPIC"]
        subprocess.run([compiler, *strict, "-o", path.with_suffix(".so"), path, "-lm"], check=True)
    function = getattr(ctypes.CDLL(str(path.with_suffix(".so"))), name)
    found, vector = np.zeros((len(x), n)), ctypes.POINTER(ctypes.c_double)
    function.argtypes = [ctypes.c_double, vector, vector, vector]
    for row in range(len(x)):
        given = (np.ascontiguousarray(each[row]).ctypes.data_as(vector) for each in (x, u))
        function(0.0, *given, found[row].ctypes.data_as(vector))
    return found


def test_every_function_of_formulas_is_exported_here():
    assert [name for name in FUNCTIONS if not any(f"{name}(" in text for text in TERMS)] == []


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
    np.testing.assert_allclose(by_c(tmp_path / "m.c", "m_rhs", x, u, own.shape[1]), own, **CLOSE)


@pytest.mark.parametrize("case", CASES)
def test_modelica_says_the_packages_rates(case, tmp_path):
    """Read by pymoca's parser of the Modelica grammar, evaluated over its syntax tree."""
    system = system_of(*CASES[case])
    x, u = points(system)
    export_system(system, tmp_path / "m.mo", Notes('A "quoted" verdict \\'))
    found = by_modelica(tmp_path / "m.mo", x, u)
    np.testing.assert_allclose(found, learned_rates(system)(0.0, x, u), **CLOSE)


@pytest.mark.parametrize(("unit", "times"), [("ms", 1000), ("min", 1 / 60), ("s", 1), (None, 1)])
def test_the_time_of_modelica_is_in_seconds_and_that_of_c_and_python_the_datas(unit, times, tmp_path):
    system = system_of(*CASES["every function"], units=unit and {"t": unit})
    x, u = points(system)
    for name in ("m.mo", "m.c"):
        export_system(system, tmp_path / name, Notes())
    own = learned_rates(system)(0.0, x, u)
    np.testing.assert_allclose(by_modelica(tmp_path / "m.mo", x, u), times * own, **CLOSE)
    assert ("Time is in s here" in (tmp_path / "m.mo").read_text()) == (times != 1)
    if shutil.which("cc"):
        np.testing.assert_allclose(by_c(tmp_path / "m.c", "m_rhs", x, u, own.shape[1]), own, **CLOSE)


def by_modelica(path, x, u):
    """Right sides [n_row, n_equation] of the equations of a model, states in order."""
    model = parser.parse(path.read_text()).classes[path.stem]
    kinds = {
        name: next((kind for kind in ("parameter", "input", "output") if kind in symbol.prefixes), "state")
        for name, symbol in model.symbols.items()
    }
    columns = dict(zip([n for n, kind in kinds.items() if kind == "state"], x.T, strict=True))
    columns |= dict(zip([n for n, kind in kinds.items() if kind == "input"], u.T, strict=True))
    columns |= {n: value(bound(model.symbols[n]), {}) for n, kind in kinds.items() if kind == "parameter"}
    return np.stack([np.broadcast_to(value(each.right, columns), len(x)) for each in model.equations], axis=-1)


OPERATORS = MappingProxyType({
    "+": lambda a, b=None: a if b is None else a + b, "-": lambda a, b=None: -a if b is None else a - b,
    "*": np.multiply, "/": np.divide, "^": lambda a, b: np.asarray(a, float) ** b, ">": np.greater, "<": np.less,
    "sign": np.sign, "abs": np.abs, "max": np.maximum, "min": np.minimum, "tanh": np.tanh, "sqrt": np.sqrt,
    "exp": np.exp, "sin": np.sin, "cos": np.cos, "tan": np.tan, "asin": np.arcsin, "acos": np.arccos,
    "atan": np.arctan, "sinh": np.sinh, "cosh": np.cosh, "log": np.log,
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


def test_an_effect_with_memory_brings_its_hidden_state_and_how_that_starts(tmp_path):
    system = system_of(MEMORY, ["z", "y**3"])
    measured = replace(system.data, states={name: system.data.states[name] for name in ("y", "v")})
    system = replace(system, data=measured)
    assert system.hidden == ("z",)
    x, u = points(system)
    own = learned_rates(system)(0.0, x, u)
    for starts, said, start in (
        ({"z": "y"}, "hidden, moves along with y where a run starts", float(measured.states["y"][0])),
        ({"z": ""}, "hidden, starts at rest", 0.0),
        ({}, "not measured; its start is unknown, set your own", 0.0),
    ):
        for ending in ("py", "c", "mo"):
            export_system(system, tmp_path / f"m.{ending}", Notes(starts=starts))
            assert said in (tmp_path / f"m.{ending}").read_text()
        program = {}
        exec((tmp_path / "m.py").read_text(), program)
        assert program["START"] == (*(float(measured.states[name][0]) for name in ("y", "v")), start)
        np.testing.assert_allclose(program["rhs"](0.0, x.T, u.T).T, own, **CLOSE)
        np.testing.assert_allclose(by_modelica(tmp_path / "m.mo", x, u), own, **CLOSE)
        assert ("initial equation\n  z = y;" in (tmp_path / "m.mo").read_text()) == (starts.get("z") == "y")
    np.testing.assert_allclose(by_c(tmp_path / "m.c", "m_rhs", x, u, 3), own, **CLOSE)


def test_a_start_that_was_not_estimated_is_not_called_so(tmp_path):
    system = system_of({"y": "v", "v": "-y"}, ["y**3"], ("y", "v"), (), "v")
    samples = replace(system.data, states={"y": system.data.states["y"]})
    system, path = replace(system, data=replace(system.data, samples=samples)), tmp_path / "model.py"
    export_system(system, path, Notes())
    text = " ".join(path.read_text().replace("#", " ").split())
    assert "v: not measured; its start is that of a smoothed path and not estimated, set your own," in text
    assert f"y: measured, {system.data.states['y'][0]:.6g} where the data start" in text
    estimated = {"y": Value(1.23, 0.5, 0.5, 2.0), "v": Value(2.0953, 2.258, -1.5, 5.8)}
    export_system(system, path, Notes(estimated=estimated))
    text = " ".join(path.read_text().replace("#", " ").split())
    assert "y: measured, 1.23 ± 0.50 where" in text and "v: not measured, 2.1 ± 2.3 where the data start" in text
    assert "START = (1.23, 2.0953)" in text


def test_a_hidden_state_of_no_term_in_the_answer_is_left_out(tmp_path):
    system = system_of(MEMORY, ["y**3"])
    export_system(system, tmp_path / "m.py", Notes(states=("y", "v")))
    x, u = points(system)
    own = learned_rates(system)(0.0, x, u)[:, :2]
    np.testing.assert_allclose(by_python(tmp_path / "m.py")(0.0, x[:, :2].T, u.T).T, own, **CLOSE)


def test_a_state_without_an_equation_drives_the_others_as_the_last_of_the_inputs(tmp_path):
    system = system_of({"v": "F - 2*y - 0.1*v"}, ["y**3*z"])
    assert system.states == ("y", "v", "z") and system.names == ("v",)
    x, u = points(system)
    own, driving = learned_rates(system)(0.0, x, u), np.column_stack([u, x[:, [0, 2]]])
    for ending in ("py", "c", "mo"):
        export_system(system, tmp_path / f"m.{ending}", Notes())
    np.testing.assert_allclose(by_python(tmp_path / "m.py")(0.0, x[:, 1:2].T, driving.T).T, own, **CLOSE)
    np.testing.assert_allclose(by_c(tmp_path / "m.c", "m_rhs", x[:, 1:2], driving, 1), own, **CLOSE)
    np.testing.assert_allclose(by_modelica(tmp_path / "m.mo", x[:, 1:2], driving), own, **CLOSE)
    assert "u[2] z: state without an equation, which drives the others" in (tmp_path / "m.c").read_text()


def test_what_a_hidden_state_moves_along_with_is_an_input_where_it_has_no_equation(tmp_path):
    system = system_of({"v": "F - 0.1*v", "z": "v - z"}, ["z"])
    export_system(system, tmp_path / "m.mo", Notes(starts={"z": "y"}))
    text = (tmp_path / "m.mo").read_text()
    assert "input Real y " in text and "initial equation\n  z = y;" in text


def test_outputs_have_a_function_of_their_own(tmp_path):
    system = system_of({"y": "v", "v": "-y", "z": "0"}, ["y*F", "v**2"], equation="load")
    assert system.is_output("load")
    x, u = points(system)
    own = learned_rates(system)(0.0, x, u)
    for ending in ("py", "c", "mo"):
        export_system(system, tmp_path / f"m.{ending}", Notes())
    program = {}
    exec((tmp_path / "m.py").read_text(), program)
    assert program["OUTPUTS"] == ("load",)
    np.testing.assert_allclose(program["outputs"](0.0, x.T, u.T).T, own[:, 3:], **CLOSE)
    np.testing.assert_allclose(by_c(tmp_path / "m.c", "m_outputs", x, u, 1), own[:, 3:], **CLOSE)
    np.testing.assert_allclose(by_modelica(tmp_path / "m.mo", x, u), own, **CLOSE)


def test_the_header_says_correlations_and_inner_parameters(tmp_path):
    system = system_of(MEMORY, ["y**3", "v", "max(abs(y) - 0.3, 0)"])
    (equation,) = system.learned.values()
    rng = np.random.default_rng(0)
    draws = rng.multivariate_normal([1, 1, 1], [[1, -0.9, 0.1], [-0.9, 1, 0], [0.1, 0, 1]], size=4000)
    # Half of the draws are of another pattern, which has nothing to say of this one.
    draws = np.concatenate([draws, np.column_stack([rng.normal(0, 9, (4000, 2)), np.zeros(4000)])])
    gap = InnerValue("gap", "dead-zone", "half the free play", Value(0.3, 0.02, 0.27, 0.33), "m")
    drawn = Drawn(equation.drawn.terms, draws, np.zeros((len(draws), 0)))
    system = replace(system, learned={"v": replace(equation, drawn=drawn, inner=(gap,), pattern=0.5)})
    export_system(system, tmp_path / "m.c", Notes())
    lines = (tmp_path / "m.c").read_text().splitlines()
    # Of 4,000 draws the correlation has a standard error of 0.003.
    (said,) = [line for line in lines if "Posterior correlation" in line]
    assert said.startswith(" * Posterior correlation of k_y3 and k_v: ")
    assert abs(float(said.split(": ")[1]) + 0.9) < 0.02
    assert " * Within dead-zone of v: gap = 0.300 +- 0.020 m, a number in the formula." in lines


@pytest.mark.parametrize("stem", ["k", "k_y3", "k_rhs"])
def test_what_the_program_is_called_is_no_coefficient(stem, tmp_path):
    system = system_of({"y": "v", "v": "-y", "rhs": "0"}, ["y**3", "rhs"], ("y", "v", "rhs"))
    x, u = points(system)
    own = learned_rates(system)(0.0, x, u)
    export_system(system, tmp_path / f"{stem}.c", Notes())
    text = (tmp_path / f"{stem}.c").read_text()
    called = text.split("void ")[1].split("(")[0]
    np.testing.assert_allclose(by_c(tmp_path / f"{stem}.c", called, x, u, 3), own, **CLOSE)


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


def test_a_study_exports_its_extended_model_with_its_sentence(study, tmp_path):
    study.export(tmp_path / "amended.py")
    text = (tmp_path / "amended.py").read_text(encoding="utf-8")
    assert study.sentence[:40] in text and "±" in text
    x, u = np.random.default_rng(0).uniform(-1, 1, (20, 2)), np.random.default_rng(1).uniform(-1, 1, (20, 1))
    np.testing.assert_allclose(
        by_python(tmp_path / "amended.py")(0.0, x.T, u.T).T, study.to_callable()(0.0, x, u), **CLOSE
    )
    study.fit.export(tmp_path / "fit.c")
    assert "void fit_rhs(" in (tmp_path / "fit.c").read_text()


def test_comments_are_short_lines_and_a_correction_without_a_sign_has_no_probability(tmp_path):
    system = system_of({"y": "v", "v": "F - 3*y - 0.5*v", "z": "-z"}, ["y", "v", "v**3"])
    equation = system.learned["v"]
    sure, open_, effect = equation.terms
    terms = (
        replace(sure, value=Value(0.2, 0.05, 0.1, 0.3), probability=0.9999),
        replace(open_, value=Value(-2.8e-11, 7.3e-10, -6.7e-10, 7.3e-10), probability=0.9999),
        replace(effect, value=Value(0.0, 1.0, -1.0, 1.0), probability=0.7),
    )
    system = replace(system, learned={"v": replace(equation, terms=terms)})
    verdict = "The simulation lacks cubic drag in d(v)/dt, and that is not all. " * 10
    for name in ("m.py", "m.c", "m.mo"):
        export_system(system, tmp_path / name, Notes(verdict))
        text = (tmp_path / name).read_text(encoding="utf-8")
        said = [line for line in text.splitlines() if line.startswith(("#", "/*", " *", "//"))]
        assert max(map(len, said)) <= 100
        assert verdict.strip() in re.sub(r" (#|//|\*) ", " ", " ".join(" ".join(said).split()))
        flat = " ".join(text.replace("\n# ", " ").replace(" */\n/* ", " ").split())
        # What is likely there but has no sign is no sure correction; an effect keeps its probability.
        assert "not told from zero; correction, adds to the -0.5 of the simulation" in flat
        assert flat.count("P > 0.999") == 1 and "P 0.700" in flat


def test_rates_of_hidden_states_have_parameters_by_name(tmp_path):
    parameters = {"Q": bg.Parameter(2.0), "R0": bg.Parameter(0.05)}
    formulas = {"soc": "-i/(3600*Q)", "V": "3.2 + 0.9*soc - R0*i"}
    simulation = simulation_of(formulas, ("soc",), ("i",), ("V",), None, parameters, {"soc": 1.0})
    time = np.arange(5.0)
    data = bg.Trajectories.from_arrays(time, inputs={"i": time}, outputs={"V": time})
    system = LearnedSystem("study", simulation, data, {}, "Rule.", parameters_of(parameters, {}))
    export_system(system, tmp_path / "m.py", Notes())
    text = (tmp_path / "m.py").read_text()
    assert "Q = 2.0" in text
    scope = {}
    exec(text, scope)
    before = scope["rhs"](0.0, np.array([1.0]), np.array([7.2]))
    scope["Q"] = 4.0
    np.testing.assert_allclose(before / scope["rhs"](0.0, np.array([1.0]), np.array([7.2])), 2.0)

"""A model as the text of a program in Python, C or Modelica, below a header with its origin and uncertainty."""

import textwrap
from collections.abc import Sequence
from importlib.metadata import version

from bayes_greybox.data.writing import unit_text
from bayes_greybox.report.exports.model import ExportedModel, Factor, Formula, rate_symbol
from bayes_greybox.report.words.formatting import estimate, interval, probability_text
from bayes_greybox.running.errors import InputError

from .printers import CPrinter, ModelicaPrinter, PythonPrinter, ascii_text, identifiers, one_line, quoted, within_c
from .reserved import C_WORDS, MODELICA_WORDS, PYTHON_WORDS


def python_program(model: ExportedModel, name: str) -> str:
    """Return a module with `rhs(t, x, u)`; beside a simulation that is code, `rhs(t, x, u, simulation)`."""
    identified = _names(model, PYTHON_WORDS)
    names = {**identified, **{rate_symbol(k): f"g[{k}]" for k in range(len(model.states))}}
    printer = PythonPrinter(names)
    heading = header(model, identified, ("x[{}]", "u[{}]"))
    lines = [part for line in heading for part in comment(one_line(line), "# ")]
    lines += ["", "import numpy", ""]
    for label, group in (("STATES", model.states), ("INPUTS", model.inputs), ("OUTPUTS", model.outputs)):
        lines.append(f"{label} = {tuple(each.name for each in group)!r}")
    lines += [f"START = {tuple(each.start for each in model.states)!r}", ""]
    for each in model.factors:
        lines += [*comment(one_line(uncertainty(each)), "# "), f"{each.name} = {float(each.value.mean)!r}"]
    for called, formulas in (("rhs", model.rates), ("outputs", model.given)):
        if not formulas:
            continue
        code = model.code and called == "rhs"
        what = "Rates of STATES" if called == "rhs" else "OUTPUTS"
        lines += ["", "", f"def {called}(t, x, u=(){', *, simulation' if code else ''}):"]
        lines.append(f'    """{what} at states x [n_state, ...] and inputs u [n_input, ...]."""')
        lines += ["    x, u = numpy.asarray(x, float), numpy.asarray(u, float)"]
        if code:
            lines.append(f"    # simulation(t, x, u) -> dx/dt, of one point: {one_line(model.code)},")
            lines.append("    # which the model was fitted beside.")
            lines.append("    g = numpy.asarray(simulation(t, x, u), float)")
        lines += [f"    {identified[each.name]} = x[{k}]" for k, each in enumerate(model.states)]
        lines += [f"    {identified[each.name]} = u[{k}]" for k, each in enumerate(model.inputs)]
        lines += ["    found = [", *(f"        {_sum(printer, each)}," for each in formulas), "    ]"]
        lines.append("    shape = numpy.broadcast_shapes(x.shape[1:], u.shape[1:])")
        lines.append("    return numpy.stack([numpy.broadcast_to(each, shape) for each in found])")
    return "\n".join(lines) + "\n"


C_HELPERS = {
    "sign_of": "static double sign_of(double v) { return v > 0.0 ? 1.0 : v < 0.0 ? -1.0 : v; }",
    "max_of": "static double max_of(double a, double b) { return a != a || a > b ? a : b; }",
    "min_of": "static double min_of(double a, double b) { return a != a || a < b ? a : b; }",
    "step_of": "static double step_of(double v, double at_zero)\n"
    "{\n    return v > 0.0 ? 1.0 : v < 0.0 ? 0.0 : v == 0.0 ? at_zero : v;\n}",
}
"""Functions of a program in C, which stand in it where it calls them."""


def c_program(model: ExportedModel, name: str, tunable: bool = False) -> str:
    """Return C99 with `void NAME_rhs(double t, const double *x, const double *u, double *dxdt)`.

    If `tunable`, coefficients are one more argument `const double *p` after u, and not constants, the functions are for
    what includes the program alone, and rates are per second.
    """
    _require_formulas(model, "C")
    called = _called(model, name, C_WORDS)
    names = _names(model, [*C_WORDS, f"{called}_rhs", f"{called}_outputs", *(["p"] if tunable else [])])
    slots: list[tuple[str, list[str]]] = [
        (slot, [names[each.name] for each in group]) for slot, group in (("x", model.states), ("u", model.inputs))
    ]
    slots += [("p", [each.name for each in model.factors])] if tunable else []
    arguments = ", ".join(["double t", *(f"const double *{slot}" for slot, _ in slots)])
    printer = CPrinter(names)
    heading = header(model, names, ("x[{}]", "u[{}]"), in_seconds=tunable)
    lines = ["/*", *(part for line in heading for part in comment(within_c(line), " * ")), " */"]
    lines += ["#include <math.h>", ""]
    every = " ".join(_sum(printer, each) for each in model.formulas)
    lines += [part for helper, text in C_HELPERS.items() if f"{helper}(" in every for part in (text, "")]
    for k, each in enumerate(model.factors):
        lines += comment(within_c(uncertainty(each)), "/* ", " */")
        value = f"{each.name} = {float(each.value.mean)!r}"
        lines.append(f"/* p[{k}] {value} */" if tunable else f"static const double {value};")
    for kind, result, formulas in (("rhs", "dxdt", model.rates), ("outputs", "y", model.given)):
        if not formulas:
            continue
        lines += ["", f"{'static ' if tunable else ''}void {called}_{kind}({arguments}, double *{result})", "{"]
        for slot, group in slots:
            lines += [f"    const double {each} = {slot}[{k}];" for k, each in enumerate(group)]
        unused = ["t", *(each for slot, group in slots for each in (slot, *group))]
        lines += ["    " + " ".join(f"(void){each};" for each in unused)]
        times = model.per_second if tunable and kind == "rhs" else 1.0
        lines += [f"    {result}[{k}] = {_sum(printer, each, times)};" for k, each in enumerate(formulas)]
        lines += ["}"]
    return "\n".join(lines) + "\n"


def modelica_program(model: ExportedModel, name: str) -> str:
    """Return a Modelica model with inputs, parameters and an equation for every state and output, in seconds."""
    _require_formulas(model, "Modelica")
    called = _called(model, name, MODELICA_WORDS)
    names = _names(model, [*MODELICA_WORDS, called])
    printer = ModelicaPrinter(names)
    heading = header(model, names, ("state {}", "input {}"), in_seconds=True)
    lines = [part for line in heading for part in comment(ascii_text(line), "// ")]
    lines += [f"model {called}"]
    for each in model.factors:
        lines.append(f"  parameter Real {each.name} = {float(each.value.mean)!r} {quoted(uncertainty(each))};")
    lines += [f"  input Real {names[each.name]} {quoted(each.about)};" for each in model.inputs]
    for each in model.states:
        start = "" if each.follows else f"(start = {each.start!r}, fixed = true)"
        lines.append(f"  Real {names[each.name]}{start} {quoted(each.about)};")
    lines += [f"  output Real {names[each.name]};" for each in model.outputs]
    following = [each for each in model.states if each.follows]
    if following:
        lines += ["initial equation", *(f"  {names[each.name]} = {names[each.follows]};" for each in following)]
    lines += ["equation"]
    lines += [f"  der({names[each.name]}) = {_sum(printer, each, model.per_second)};" for each in model.rates]
    lines += [f"  {names[each.name]} = {_sum(printer, each)};" for each in model.given]
    return "\n".join([*lines, f"end {called};"]) + "\n"


def _called(model: ExportedModel, name: str, words: Sequence[str]) -> str:
    """Return the name of the program: the stem of its file, made distinct from those of coefficients."""
    factors = {each.name for each in model.factors}
    (called,) = identifiers([name], [*words, *factors]).values()
    while {f"{called}_rhs", f"{called}_outputs"} & factors:
        called = f"{called}_"
    return called


def _names(model: ExportedModel, words: list[str]) -> dict[str, str]:
    names = identifiers([each.name for each in model.quantities], [*words, *(f.name for f in model.factors)])
    return {**names, **{each.parameter: each.name for each in model.factors if each.parameter}}


def _sum(printer: PythonPrinter | CPrinter | ModelicaPrinter, formula: Formula, times: float = 1.0) -> str:
    simulated = [] if formula.known == 0 and formula.added else [printer._print(formula.known)]
    text = " + ".join([*simulated, *(printer.product(name, phi) for name, phi in formula.added)])
    return text if times == 1.0 else f"{times!r}*({text})"


def _require_formulas(model: ExportedModel, language: str) -> None:
    if model.code:
        raise InputError(
            f"The simulation is {model.code}, which cannot be written in {language}: give it as formulas, "
            "GreyBox(simulation={'y': 'v', ...}), or export to .py, whose rhs takes its rates, simulation(t, x, u), "
            "beside its arguments."
        )


def header(model: ExportedModel, names: dict[str, str], slots: tuple[str, str], in_seconds: bool = False) -> list[str]:
    """Return the lines of the header; without a date, so that the same model gives the same text.

    Names are identifiers by the names of the data, `slots` patterns of states and inputs, such as "x[{}]". If
    `in_seconds`, time is in seconds there, whatever it was in the data.
    """
    what = "extended by a study" if model.origin == "study" else "fitted to data"
    lines = [f"A model {what}; written by bayes_greybox {version('bayes-greybox')}."]
    lines += [text for text in (model.notes.verdict, model.rule, *model.notes.remarks) if text]
    lines += ["Coefficients are posterior means, with standard deviation and 90 % interval."]
    lines += [
        f"Not in it, as it has no formula: f of {name}, {text}." for name, text in model.notes.discrepancy.items()
    ]
    unit = unit_text(model.time)
    if in_seconds and model.per_second != 1.0:
        lines.append(
            f"Time is in s here, and rates are per s: what the data, with their time in {unit}, say is multiplied by "
            f"{model.per_second:.15g}. Coefficients have the units of the data."
        )
    elif unit:
        lines.append(f"Time is in {unit}: rates are per {unit}.")
    for slot, quantities in zip((*slots, "output"), (model.states, model.inputs, model.outputs), strict=True):
        for k, each in enumerate(quantities):
            first = f"{each.start:.6g}" if each.start_sd is None else estimate(each.start, each.start_sd)
            start = f", {first} where the data start" if slot == slots[0] else ""
            renamed = f' (called "{each.name}" in the data)' if names[each.name] != each.name else ""
            unit = f" [{unit_text(each.unit)}]" if unit_text(each.unit) else ""
            lines.append(f"{slot.format(k)}  {names[each.name]}{renamed}{unit}: {each.about}{start}")
    for name, inner in model.inner:
        text = estimate(inner.value.mean, inner.value.sd, inner.unit)
        lines.append(f"Within {inner.effect} of {name}: {inner.name} = {text}, a number in the formula.")
    for a, b, value in model.correlations:
        lines.append(f"Posterior correlation of {a} and {b}: {value:.2f}")
    return lines


def comment(text: str, mark: str, end: str = "") -> list[str]:
    """Return text as lines of a comment between `mark` and `end`, none of them longer than 100 characters."""
    lines = textwrap.wrap(text, 100 - len(mark) - len(end), break_long_words=False, break_on_hyphens=False)
    return [f"{mark}{line}{end}" for line in lines or [""]]


def uncertainty(factor: Factor) -> str:
    """Return the term of a coefficient, its uncertainty and its probability, as a comment."""
    value = factor.value
    parts = [f"{factor.formula} in {factor.equation}" if factor.equation else f"parameter {factor.parameter}"]
    if value.sd > 0:
        parts.append(f"{estimate(value.mean, value.sd, factor.unit)}, 90 % {interval(value.lower, value.upper)}")
    elif unit_text(factor.unit):
        parts.append(unit_text(factor.unit))
    if factor.correction and (value.lower < 0.0 < value.upper or value.sd > abs(value.mean)):
        # That it is there is likely, and says nothing where its sign is not known.
        parts.append("not told from zero")
    elif factor.probability is not None:
        parts.append(f"P {probability_text(factor.probability)}")
    return "; ".join([*parts, *([factor.about] if factor.about else [])])

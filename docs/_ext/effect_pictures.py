"""A picture of an effect of the catalogue, drawn from its formula by NumPy and Matplotlib."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
import sympy
from matplotlib.figure import Figure

from bayes_greybox.physics.catalogue.effects import Effect
from bayes_greybox.physics.catalogue.inner_parameter import InnerParameter
from bayes_greybox.physics.formula.expressions import parse_expression

POSITIVE = {"level", "upstream", "population", "other", "absolute_temperature", "absolute_surroundings"}
"""Roles that are never negative."""

LINE, GREY = "#3b82c4", "#808890"
"""Colours that can be seen on white and on black."""

STYLE = {
    "font.size": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "text.color": GREY,
    "axes.labelcolor": GREY,
    "axes.edgecolor": GREY,
    "xtick.color": GREY,
    "ytick.color": GREY,
    "svg.hashsalt": "bayes_greybox",
}

STEPS = 2000
"""Steps of a period, of hidden states."""


def save_picture(effect: Effect, path: Path) -> None:
    """Write the picture as an SVG without background."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(3.2, 2.2), layout="constrained")
        axes = figure.subplots()
        draw = _loop if effect.hidden else {0: _line, 1: _curve, 2: _map}[len(_variables(effect))]
        draw(axes, effect)
        figure.savefig(path, transparent=True, metadata={"Date": None})


DRIVEN = ("input", "position", "temperature", "current", "concentration")
"""Roles that drive hidden states in pictures, by sin(t); a velocity is its rate."""


def middle(inner: InnerParameter) -> float:
    """The value in the middle of a parameter's range, for five periods of a wave sin(t)."""
    scale = {"period": 2 * math.pi, "record": 10 * math.pi}.get(inner.scale, 1.0)
    return scale * math.sqrt(inner.low * inner.high)


def _variables(effect: Effect) -> list[str]:
    own = {part.name for part in (*effect.inner, *effect.hidden)}
    return sorted({symbol.name for symbol in effect.expr.free_symbols} - own)


def _function(text: str) -> Callable[[Mapping[str, np.ndarray]], np.ndarray]:
    formula = parse_expression(text)
    symbols = sorted(formula.free_symbols, key=str)
    compiled = sympy.lambdify(symbols, formula, "numpy")
    return lambda columns: np.asarray(compiled(*(columns[symbol.name] for symbol in symbols)), float)


def _constants(effect: Effect) -> dict[str, np.ndarray]:
    return {inner.name: np.array(middle(inner)) for inner in effect.inner}


def _axis(role: str, n: int) -> np.ndarray:
    # Without zero: a formula may divide by what is drawn.
    return np.linspace(1e-6 if role in POSITIVE else -1.0, 1.0, n)


def _line(axes, effect: Effect) -> None:
    axes.plot([0, 1], [1, 1], color=LINE)
    axes.set(xlabel="time", ylabel="effect", ylim=(-0.1, 1.3), xticks=[])


def _curve(axes, effect: Effect) -> None:
    (role,) = _variables(effect)
    x = _axis(role, 801)
    y = np.broadcast_to(_function(effect.expression)({role: x, **_constants(effect)}), x.shape)
    # A jump is a jump, no steep line.
    leaps = np.abs(np.diff(y)) > 0.4 * np.ptp(y)
    shown = np.insert(y.astype(float), np.flatnonzero(leaps) + 1, np.nan)
    axes.axhline(0, color=GREY, linewidth=0.5)
    axes.plot(np.insert(x, np.flatnonzero(leaps) + 1, np.nan), shown, color=LINE)
    axes.set(xlabel=_words(role), ylabel="effect", title=_caption(effect))


def _map(axes, effect: Effect) -> None:
    first, second = _variables(effect)
    x, y = np.meshgrid(_axis(first, 121), _axis(second, 121))
    z = _function(effect.expression)({first: x, second: y, **_constants(effect)})
    limit = np.abs(z).max()
    levels = np.linspace(-limit, limit, 14)
    colours = axes.contourf(x, y, z, levels=levels, cmap="PRGn")
    axes.set(xlabel=_words(first), ylabel=_words(second), title=_caption(effect))
    bar = axes.figure.colorbar(colours, ax=axes, label="effect", ticks=[-limit, 0, limit], format="%.2g")
    bar.outline.set_edgecolor(GREY)


def _loop(axes, effect: Effect) -> None:
    """The second period of x = sin(t): what the effect does on the way there, and on the way back."""
    values = {**_constants(effect)}
    rates = {state.name: _function(state.rate) for state in effect.hidden}

    def columns(t: float, z: Mapping[str, float]) -> dict[str, np.ndarray]:
        wave = {**dict.fromkeys(DRIVEN, math.sin(t)), "velocity": math.cos(t)}
        return {**{k: np.array(v) for k, v in wave.items()}, **values, **{k: np.array(v) for k, v in z.items()}}

    def slope(t: float, z: np.ndarray) -> np.ndarray:
        at = columns(t, dict(zip(rates, z, strict=True)))
        return np.array([float(rate(at)) for rate in rates.values()])

    h, z = 2 * math.pi / STEPS, np.zeros(len(rates))
    across, found = [], []
    value = _function(effect.expression)
    driven = next(role for role in DRIVEN if role in effect.roles)
    for k in range(6 * STEPS):
        t = k * h
        if k >= 5 * STEPS:
            at = columns(t, dict(zip(rates, z, strict=True)))
            across.append(float(at[driven]))
            found.append(float(value(at)))
        k1 = slope(t, z)
        z = z + h * slope(t + h / 2, z + h / 2 * k1)
    axes.plot([*across, across[0]], [*found, found[0]], color=LINE)
    axes.set(xlabel=_words(driven), ylabel="effect", title=_caption(effect))


def _words(role: str) -> str:
    return role.replace("_", " ")


def _caption(effect: Effect) -> str:
    return ", ".join(f"{_words(inner.name)} {middle(inner):.2g}" for inner in effect.inner)

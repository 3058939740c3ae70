"""Style of all figures: colours, text with units, figures that pyplot does not keep, and whole files of them."""

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from matplotlib.mathtext import MathTextParser

from bayes_greybox.report.words.formatting import unit_text
from bayes_greybox.running.errors import InputError
from bayes_greybox.running.whole_files import whole_file

DASHED = (0, (4, 3))
"""Line of what is no result, such as a threshold."""

# Okabe & Ito's colour-blind-safe palette; blue and orange also differ in lightness.
BLUE = "#0072B2"
ORANGE = "#D55E00"
SKY = "#56B4E9"
DARK = "#222222"
GREY = "#767676"
LIGHT = "#D9D9D9"

BEFORE: dict[str, Any] = {"color": ORANGE, "linestyle": (0, (5, 1.6))}
AFTER: dict[str, Any] = {"color": BLUE, "linestyle": "-"}
"""The simulation as given and the extended model, in every figure: apart in grey too."""

SIGNED = "PRGn"
"""Map of signed numbers: safe for colour-blind readers, and of colours that stand for nothing else."""

STYLE: dict[str, Any] = {
    "font.size": 10, "axes.titlesize": 10.5, "axes.labelsize": 10, "xtick.labelsize": 9, "ytick.labelsize": 9,
    "legend.fontsize": 9, "legend.frameon": False, "axes.spines.top": False, "axes.spines.right": False,
    "axes.edgecolor": "#555555", "axes.titlelocation": "left", "hatch.color": GREY, "hatch.linewidth": 0.5,
    "text.usetex": False, "figure.facecolor": "white",
}  # fmt: skip


def new_figure(width: float, height: float) -> Figure:
    """Return an empty figure with constrained layout that pyplot knows how to show but does not hold on to."""
    layout = ConstrainedLayoutEngine(w_pad=0.08, h_pad=0.08, wspace=0.03)
    figure = plt.figure(figsize=(width, height), layout=layout)
    # Left open, a notebook would show it twice: as the value of the cell and as an open figure.
    plt.close(figure)
    return figure


@contextmanager
def laid_out(figure: Figure) -> Iterator[None]:
    """Settle the layout of a figure while it is saved, which would draw everything twice otherwise."""
    engine = figure.get_layout_engine()
    if engine is None:
        yield
        return
    engine.execute(figure)
    with mpl.rc_context({"figure.autolayout": False, "figure.constrained_layout.use": False}):
        figure.set_layout_engine(None)
    try:
        yield
    finally:
        figure.set_layout_engine(engine)


def figure_of(ax: Axes) -> Figure:
    """Return the outermost figure that holds the axes."""
    figure = ax.get_figure(root=True)
    assert isinstance(figure, Figure)
    return figure


def place_legend(ax: Axes, ours: bool, handles: Sequence[Artist] | None = None, columns: int | None = None) -> None:
    """Place a legend below a figure of our own, clear of its curves; inside the caller's axes otherwise.

    It names the labelled artists of the axes, or the handles that are given, `columns` in a row, by default all.
    """
    shown = list(handles) if handles is not None else ax.get_legend_handles_labels()[0]
    labels = [str(handle.get_label()) for handle in shown]
    if ours:
        place = {"loc": "outside lower left", "ncols": columns or len(shown), "columnspacing": 1.5}
        legend = figure_of(ax).legend(shown, labels, **place)
    else:
        legend = ax.legend(shown, labels, loc="best")
    for handle in legend.legend_handles:
        # One of many curves is pale, and its line in the legend alone: not to be seen where the page is dark.
        if isinstance(handle, Line2D):
            handle.set_alpha(1.0)


def given_axes(axes: Sequence[Axes] | np.ndarray, needed: int, order: str) -> list[Axes]:
    """Return the caller's axes as a flat list, checked for their number; the message says which they are, in order."""
    flat = list(np.ravel(np.asarray(axes, dtype=object)))
    if len(flat) != needed:
        raise InputError(f"This figure needs {needed} axes ({order}), but {len(flat)} were given.")
    return flat


def panels_of(
    axes: Sequence[Axes] | np.ndarray | None, needed: int, order: str, size: tuple[float, float], **subplots: Any
) -> list[Axes]:
    """Return the caller's axes, see `given_axes`, or those of a new figure of a size in inches, by default a column."""
    if axes is not None:
        return given_axes(axes, needed, order)
    return list(np.ravel(new_figure(*size).subplots(**{"nrows": needed, "squeeze": False, **subplots})))


def guide_rows(ax: Axes, n: int) -> np.ndarray:
    """Draw thin lines along which n rows are read, the first on top, and return their places."""
    rows = np.arange(n)
    ax.hlines(rows, 0, 1, transform=ax.get_yaxis_transform(), color=LIGHT, linewidth=0.6, zorder=0)
    ax.set_ylim(n - 0.5, -0.5)
    ax.tick_params(axis="y", length=0)
    return rows


def rug(ax: Axes, positions: np.ndarray, label: str | None = None) -> None:
    """Mark positions of data rows by strokes along the lower edge."""
    ax.plot(positions, np.full(len(positions), 0.02), "|", transform=ax.get_xaxis_transform(), color=DARK, alpha=0.45,
            markersize=7, markeredgewidth=0.6, label=label)  # fmt: skip


def every_nth(n_obs: int, most: int) -> slice:
    """Return evenly spaced rows, at most about `most` of them."""
    return slice(None, None, max(1, -(-n_obs // most)))


def plain(text: str) -> str:
    """Return text that is drawn as it stands: a dollar sign does not start a formula."""
    return text.replace("$", r"\$")


def formula_or_name(name: str, latex: str | None) -> str:
    """Return the formula where there is one that can be drawn, and the plain name otherwise."""
    if not latex:
        return plain(name)
    formula = f"${latex.strip('$ ')}$"
    try:
        MathTextParser("path").parse(formula)
    except ValueError:
        return plain(name)
    return formula


def with_unit(label: str, unit: str | None) -> str:
    """Return a label with its unit in brackets; the label alone where there is no unit."""
    shown = plain(unit_text(unit))
    return f"{plain(label)} [{shown}]" if shown else plain(label)


def save_figures(figures: Mapping[str, Figure], folder: str | os.PathLike[str]) -> dict[str, Path]:
    """Write each figure as `folder/name.png`, beside its final name first and then renamed.

    Args:
        figures: figures by name; a name is a file name without its ending.
        folder: where to; made where it is missing.

    Returns:
        The path of each figure.

    Raises:
        InputError: a name is not a plain file name, or the folder cannot be written to.
    """
    target = Path(folder)
    for name in figures:
        if not name or name.startswith(".") or set(name) & set('/\\:*?"<>|\0'):
            raise InputError(f"{name!r} cannot name a figure's file; use letters, digits, '-' and '_'.")
    try:
        target.mkdir(parents=True, exist_ok=True)
        for name, figure in figures.items():
            with whole_file(target / f"{name}.png") as part, laid_out(figure):
                # The usual level of compression, 6, makes files a tenth smaller in twice the time.
                figure.savefig(part, format="png", dpi=150, pil_kwargs={"compress_level": 3})
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"Cannot write figures to {str(target)!r} ({reason}); choose another folder.") from error
    return {name: target / f"{name}.png" for name in figures}

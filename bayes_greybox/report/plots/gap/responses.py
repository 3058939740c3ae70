"""Expected responses of an experiment under each explanation, and where these part."""

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bayes_greybox.report.plots import style

LOOKS = ((style.BLUE, "-"), (style.ORANGE, (0, (5, 2))), (style.SKY, (0, (1, 1))), (style.DARK, (0, (5, 1.5, 1, 1.5))))
"""Colour and line of each explanation, likeliest first; more of them are not drawn."""


@mpl.rc_context(style.STYLE)
def plot_responses(
    time: Float[np.ndarray, " n_row"],
    bands: Float[np.ndarray, "n_explanation 3 n_row"],
    *,
    names: Sequence[str],
    probability: Float[np.ndarray, " n_explanation"],
    noise: float,
    channel: str,
    unit: str | None = None,
    time_unit: str | None = None,
    width: float = 9.0,
    axes: Sequence[Axes] | np.ndarray | None = None,
) -> Figure:
    """Draw bands of one sensor under each explanation, and their difference from the likeliest one's median.

    Args:
        time: times of the rows, in `time_unit`.
        bands: lower end, median and upper end for each explanation, without noise, in `unit`.
        names: explanations, likeliest first; the first four are drawn.
        probability: probability of each.
        noise: standard deviation of the sensor.
        channel: measured quantity.
        unit: unit of the channel.
        time_unit: unit of time.
        width: width of the figure in inches.
        axes: two axes to draw into: the response, and the difference.
    """
    order = "the response, then the difference"
    above, below = style.panels_of(axes, 2, order, (width, 5.4), sharex=True, height_ratios=[1.2, 1.0])
    centre = bands[0, 1]
    below.axhspan(-1, 1, color=style.LIGHT, linewidth=0, label="noise, ±1 SD")
    for (colour, line), name, p, band in zip(LOOKS, names, probability, bands, strict=False):
        label = f"{style.plain(name)} ({p:.2f})"
        for ax, (low, middle, high) in ((above, band), (below, (band - centre) / noise)):
            ax.fill_between(time, low, high, color=colour, alpha=0.22, linewidth=0)
            ax.plot(time, middle, color=colour, linestyle=line, linewidth=1.4, label=label if ax is above else None)
    if len(names) > len(LOOKS):
        above.plot([], [], " ", label=f"{len(names) - len(LOOKS)} less likely ones are not drawn")
    above.set_title(f"{style.plain(channel)} under each explanation")
    above.set_ylabel(style.with_unit(channel, unit))
    below.set_title("Difference from the likeliest, over the noise")
    below.set_ylabel("difference [SD]")
    below.set_xlabel(style.with_unit("time", time_unit))
    below.axhline(0.0, color=style.GREY, linewidth=0.8, zorder=0.5)
    for ax in (above, below):
        ax.margins(x=0.01)
    handles = [*above.get_legend_handles_labels()[0], *below.get_legend_handles_labels()[0]]
    # Names of several effects are long: in a narrow figure they stand one below the other.
    style.place_legend(above, axes is None, handles, columns=max(1, min(len(handles), int(width // 3))))
    return style.figure_of(above)

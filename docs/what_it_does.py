"""The picture in README: where a simulation is wrong, which effect it lacks, and what adding it does.

From the root of a checkout, in about two minutes on two cores:

    python docs/what_it_does.py

The study is that of configs/discover_spring.toml, whose report has these figures at their full size.
"""

from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from PIL import Image

import bayes_greybox as bg

SHOWN = 4
"""Explanations in the ranking, best first."""

STYLE = {
    "font.size": 9.5,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "legend.frameon": False,
}


def spring() -> bg.Study:
    """The study: a real oscillator has a hardening spring that its simulation does not know."""
    measured = bg.systems.duffing(k3=40.0).simulate(t=np.linspace(0, 60, 601), noise=0.05, seed=1)
    train, test = measured.split(0.7)
    model = bg.GreyBox(simulation={"y": "ydot", "ydot": "F - 10*y - 0.5*ydot"})
    return bg.find_missing_effects(model, train, test=test, catalogue="mechanical", draws=800, tune=500, chains=2)


def picture(study: bg.Study) -> Figure:
    """One column that can be read on a phone: where, what, and whether it helps."""
    with mpl.rc_context(STYLE):
        figure = plt.figure(figsize=(5.0, 7.4), layout=ConstrainedLayoutEngine(w_pad=0.1, h_pad=0.05))
        where, what, helps = figure.subfigures(3, 1, height_ratios=(2.6, 2.3, 2.5), hspace=0.03)
        _where(where, study.maps["ydot"], bg.study_figures.support(study.maps["ydot"]))
        _what(what, study)
        _helps(helps, study.paths["y"])
        for part, question in {
            where: "1  Where do simulation and measurements disagree?",
            what: "2  Which effect is missing?",
            helps: "3  Does adding it help?",
        }.items():
            part.suptitle(question, x=0.02, ha="left", fontsize=10.5, fontweight="bold")
    plt.close(figure)
    return figure


def _where(figure, gap, inside) -> None:
    left, right = figure.subplots(1, 2, sharey=True)
    limit = np.abs(gap.before[inside]).max()
    maps = {"the simulation as given": (left, gap.before), "with the effect added": (right, gap.after)}
    x, y = gap.axes
    for title, (ax, values) in maps.items():
        colours = ax.pcolormesh(x, y, values.T, cmap="PRGn", vmin=-limit, vmax=limit, shading="gouraud")
        ax.contourf(x, y, inside.T.astype(float), levels=[-1, 0.5], colors="white")
        ax.plot(*gap.samples[::2].T, "o", color="#222222", markersize=1.4, markeredgewidth=0, alpha=0.5)
        ax.set(title=title, xlabel="position [m]", xlim=(x[0], x[-1]), ylim=(y[0], y[-1]))
    left.set_ylabel("velocity [m/s]")
    figure.colorbar(colours, ax=[left, right], label="gap [m/s²]")


def _what(figure, study) -> None:
    table = study.hypotheses.xs("ydot", level=0).sort_values("probability", ascending=False).head(SHOWN)
    names = dict(zip(study.effects["slug"], study.effects["name"], strict=True)) | {"unknown": "Unknown"}
    shown = [" + ".join(names.get(part, part.capitalize()) for part in name.split(" + ")) for name in table.index]
    probability, left = (table[column].to_numpy(float) for column in ("probability", "share_left"))
    bg.plots.plot_hypotheses(shown, probability, left, chosen=shown[:1], title="", axes=figure.subplots())


def _helps(figure, path) -> None:
    ax = figure.subplots()
    before, after = (np.stack([band.mean, band.lower, band.upper]) for band in (path.before, path.after))
    bg.plots.plot_free_run(path.time, path.measured, before, after, state="position", time_unit="s", unit="m", axes=ax)
    ax.get_legend().remove()
    ax.set_title("held-out data, from their first state and the input")
    handles, labels = ax.get_legend_handles_labels()
    called = {"before": "as given", "after": "with the effect"}
    ax.legend(handles, [called.get(label, label) for label in labels], loc="lower left", ncols=3, columnspacing=1.2)


def save(figure: Figure, path: Path) -> None:
    """Write the picture as a PNG of few colours, a third of its size otherwise."""
    figure.savefig(path, dpi=200)
    few = Image.open(path).convert("RGB").quantize(256, method=Image.Quantize.MAXCOVERAGE, kmeans=3)
    few.save(path, optimize=True)


if __name__ == "__main__":
    save(picture(spring()), Path(__file__).with_suffix(".png"))

"""Values that are read off a figure under the pointer: boxes of its axes, their lines, and values of maps.

Values of lines are not kept a second time: the page's script reads them off the drawn line, to the tenth of a point
that it is drawn with. Values of maps have two characters each.
"""

from typing import Any

import numpy as np
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

LETTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-_"
"""Digits of the values of maps, 64 to a place."""


def readings(figure: Figure) -> list[dict[str, Any]]:
    """Return for each axes with something to read its box in points, limits, labels, and its lines or its map.

    Lines are given an id, by which the drawing has them.
    """
    width, height = (72.0 * size for size in figure.get_size_inches())
    axes_read = []
    for k, ax in enumerate(figure.axes):
        lines, shown = _lines(ax, k), _map(ax)
        if not (lines or shown) or ax.get_xscale() != "linear" or ax.get_yscale() != "linear":
            continue
        box = ax.get_position()
        edges = (width * box.x0, height * (1 - box.y1), width * box.width, height * box.height)
        about: dict[str, Any] = {
            "box": [round(edge, 1) for edge in edges],
            "x": _ends(ax.get_xlim()),
            "y": _ends(ax.get_ylim()),
            "names": [_label(figure, ax, "x"), _label(figure, ax, "y")],
        }
        axes_read.append(about | ({"map": shown} if shown else {"lines": lines}))
    return axes_read


def _lines(ax: Any, k: int) -> dict[str, str]:
    """Return the labels of the lines that run from left to right, by the id that they are given."""
    labels = {}
    for j, line in enumerate(ax.get_lines()):
        label, x = str(line.get_label()), np.asarray(line.get_xdata(orig=False), float)
        # A line of fewer points is not worth reading.
        if not label.startswith("_") and len(x) >= 8 and line.get_transform() == ax.transData:
            finite = x[np.isfinite(x)]
            if np.all(np.diff(finite) >= 0) and np.ptp(finite) > 0:
                line.set_gid(f"line{k}x{j}")
                labels[f"line{k}x{j}"] = label
    return labels


def _map(ax: Any) -> dict[str, Any] | None:
    """Return name, range and values of a map on an even grid, row by row from below."""
    mesh: Any = next((one for one in ax.collections if isinstance(one, QuadMesh)), None)
    if mesh is None or mesh.colorbar is None:
        return None
    corners = mesh.get_coordinates()
    values = np.ma.filled(np.ma.asarray(mesh.get_array(), float), 0.0).reshape(corners.shape[0] - 1, -1)
    low, high = float(values.min()), float(values.max())
    most = len(LETTERS) ** 2 - 1
    steps = np.round((values - low) / ((high - low) or 1.0) * most).astype(int)
    return {
        "name": mesh.colorbar.ax.get_ylabel(),
        "range": _ends((low, high)),
        "across": values.shape[1],
        "x": _ends((corners[0, 0, 0], corners[0, -1, 0])),
        "y": _ends((corners[0, 0, 1], corners[-1, 0, 1])),
        "values": "".join(LETTERS[v // 64] + LETTERS[v % 64] for v in steps.ravel()),
    }


def _label(figure: Any, ax: Any, side: str) -> str:
    """Return the label of an axis, or that of the lowest panel or of the figure where panels share it."""
    panel = ax.get_xlabel() if side == "x" else ax.get_ylabel()
    shared = figure.get_supxlabel() if side == "x" else figure.get_supylabel()
    others = [other.get_xlabel() if side == "x" else "" for other in reversed(figure.axes)]
    return panel.split("\n")[0] or shared or next((text.split("\n")[0] for text in others if text), "")


def _ends(pair: tuple[Any, Any]) -> list[float]:
    return [float(f"{float(end):.6g}") for end in pair]

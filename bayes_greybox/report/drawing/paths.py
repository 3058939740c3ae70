"""Paths in few characters: tenths of a point, relative steps, and dots that are one path together."""

import re
from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element

_SMALL_SHAPE = 12.0
"""Shapes no wider than this many points, such as markers, keep hundredths."""


def short_path(commands: str) -> str:
    """Return the attribute `d` of a path, in points, in fewer characters."""
    numbers = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", commands)]
    small = bool(numbers) and max(numbers[::2]) - min(numbers[::2]) <= _SMALL_SHAPE
    if small or re.search(r"[A-KN-Ya-kn-y]", commands.replace("e-", "")):
        places = 2 if small else 1
        text = re.sub(r"-?\d+\.\d+(?:e-?\d+)?", lambda match: _short(float(match[0]), places), commands)
        return re.sub(r"\s+", " ", re.sub(r"\s*([A-Za-z])\s*", r"\1", text)).strip()
    return "".join(_strokes(commands))


def dots(uses: Sequence[Element], shapes: Mapping[str, Element], link: str) -> tuple[str, str] | None:
    """Return many copies of one round marker as a single path, and its style; None for other copies.

    A stroke without length but with round ends is a dot, which takes a tenth of the characters of a copy. Copies name
    their shape, one of `shapes` by id, in the attribute `link`.
    """
    names, styles = {one.get(link, "")[1:] for one in uses}, {one.get("style", "") for one in uses}
    if len(names) != 1 or len(styles) != 1:
        return None
    (name,), (style,) = names, styles
    shape = shapes.get(name)
    # A circle is eight curves, as matplotlib draws it; what has an outline of its own colour stays as it is.
    if shape is None or shape.get("d", "").count("C") != 8 or "fill: none" in style or "stroke: #" in _outline(style):
        return None
    across = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", shape.get("d", ""))[::2]]
    colour = re.search(r"fill: (#[0-9a-f]{6})", style)
    opacity = re.search(r"(?:fill-)?opacity: ([\d.]+)", style)
    if colour is None:
        return None
    width = max(across) - min(across)
    stroke = f"stroke: {colour[1]}; stroke-width: {width:.2f}; stroke-linecap: round; fill: none"
    if opacity:
        stroke += f"; stroke-opacity: {opacity[1]}"
    path = "".join(f"M{_short(float(one.get('x', 0)))} {_short(float(one.get('y', 0)))}h0" for one in uses)
    return path, stroke


def _outline(style: str) -> str:
    """Return the part of a style that draws an outline in another colour than the inside."""
    inside, outside = (re.search(rf"(?<![\w-]){name}: (#[0-9a-f]{{6}})", style) for name in ("fill", "stroke"))
    return f"stroke: {outside[1]}" if outside and (inside is None or inside[1] != outside[1]) else ""


def _strokes(commands: str):
    """Yield straight strokes as steps from one point to the next, without those of no length."""
    x = y = 0
    fresh = True
    for command, text in re.findall(r"([MLz])([^MLz]*)", commands):
        if command == "z":
            yield "z"
            continue
        to_x, to_y = (round(10 * float(number)) for number in text.split())
        if command == "M":
            yield f"M{_short(to_x / 10)} {_short(to_y / 10)}"
            fresh = True
        elif (to_x, to_y) != (x, y) or fresh:
            yield f"{'l' if fresh else ' '}{_short((to_x - x) / 10)} {_short((to_y - y) / 10)}"
            fresh = False
        x, y = to_x, to_y


def _short(number: float, places: int = 1) -> str:
    text = f"{number:.{places}f}"
    text = text.rstrip("0").rstrip(".") if "." in text else text
    return "0" if text in ("-0", "") else text.replace("0.", ".", 1) if text.lstrip("-").startswith("0.") else text

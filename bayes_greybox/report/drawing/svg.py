"""A figure as SVG to stand in the text of a page.

Letters stay letters, colours are the page's own, so that they follow it into the dark, and coordinates have a tenth of
a point. Nothing of it names a font, a colour or an id that the rest of the page could trip over. Paths have few
characters: tenths of a point, relative steps, and dots that are one path together.
"""

import hashlib
import io
import json
import re
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import matplotlib as mpl
from markupsafe import escape
from matplotlib.figure import Figure

from bayes_greybox.report.drawing.hover import readings
from bayes_greybox.report.plots.style import laid_out

COLOURS = {
    "#000000": "ink", "#222222": "ink", "#555555": "edge", "#767676": "grey", "#d9d9d9": "light", "#f3f3f3": "faint",
    "#ffffff": "paper", "#0072b2": "blue", "#d55e00": "orange", "#56b4e9": "sky", "#00441b": "most", "#40004b": "least",
}  # fmt: skip
"""Colours of `plots.style`, and the ends of the colour map of signed numbers, by their names in the page's style."""

_SPACE = "{http://www.w3.org/2000/svg}"
_LINK = "{http://www.w3.org/1999/xlink}href"
_IDLE = {"font-family", "stroke-linejoin", "stroke-miterlimit"}
_DEFAULT = {("text-anchor", "start"), ("stroke-linecap", "butt"), ("fill-opacity", "1"), ("stroke-opacity", "1")}


def drawing(figure: Figure, alt: str) -> str:
    """Return the figure as an `svg` element, with a description for those who cannot see it."""
    text = io.BytesIO()
    # A fixed salt and no date: the same results make the same file.
    with laid_out(figure), mpl.rc_context({"svg.hashsalt": "bayes_greybox", "svg.fonttype": "none"}):
        read = readings(figure)
        figure.savefig(text, format="svg", dpi=100, facecolor="none", metadata={"Date": None, "Creator": None})
    # Ids are those of the page that it stands in: no other drawing may have them.
    prefix = f"f{hashlib.sha256(text.getvalue() + alt.encode()).hexdigest()[:6]}-"
    root = ElementTree.fromstring(text.getvalue())
    box = root.get("viewBox", "")
    inside = _Drawing(root, prefix, [line for axes in read for line in axes.get("lines", {})])
    body = "".join(inside.written(child) for child in root)
    seen = f' data-axes="{escape(json.dumps(inside.renamed(read), ensure_ascii=False))}"' if read else ""
    return f'<svg class="drawing" role="img" aria-label="{escape(alt)}" viewBox="{box}"{seen}>{body}</svg>'


class _Drawing:
    """Elements of one drawing, and the ids that they refer to."""

    def __init__(self, root: Element, prefix: str, kept: list[str]) -> None:
        self._shapes = {one.get("id", ""): one for one in root.iter() if one.get("id")}
        used: list[str] = []
        for one in root.iter():
            used += [one.get(_LINK, "")[1:]] if one.get(_LINK, "").startswith("#") else []
            used += re.findall(r"url\(#([\w-]+)\)", f"{one.get('clip-path', '')} {one.get('style', '')}")
        self._names = {name: f"{prefix}{k}" for k, name in enumerate(dict.fromkeys([*used, *kept]))}

    def renamed(self, read: list[dict]) -> list[dict]:
        """Return readings with the ids that their lines have in the page."""
        lines = [{self._names[line]: label for line, label in axes.get("lines", {}).items()} for axes in read]
        return [{**axes, "lines": named} if named else axes for axes, named in zip(read, lines, strict=True)]

    def written(self, one: Element) -> str:
        """Return an element with everything in it; nothing where nothing is left of it."""
        tag = one.tag.removeprefix(_SPACE)
        if tag in ("metadata", "style") or not isinstance(one.tag, str):
            return ""
        uses = [child for child in one if child.tag == f"{_SPACE}use"]
        inside = str(escape((one.text or "").strip())) if tag in ("text", "tspan") else ""
        merged = _dots(uses, self._shapes) if len(uses) > 1 else None
        for child in one:
            if merged is not None and child in uses:
                if child is uses[0]:
                    path, style = merged
                    inside += f'<path d="{path}" style="{_style(style)}"/>'
            else:
                inside += self.written(child)
        about = "".join(f' {name}="{value}"' for name, value in self._attributes(tag, one))
        if tag in ("g", "defs") and (not inside or not about and tag == "g"):
            return inside
        if tag == "path" and one.get("id") in self._shapes and one.get("id") not in self._names:
            return ""
        return f"<{tag}{about}>{inside}</{tag}>" if inside else f"<{tag}{about}/>"

    def _attributes(self, tag: str, one: Element):
        for name, value in one.attrib.items():
            if name == "id":
                if value in self._names:
                    yield "id", self._names[value]
            elif name == _LINK:
                yield "href", value if value.startswith("data:") else f"#{self._names[value[1:]]}"
            elif name == "clip-path":
                yield name, f"url(#{self._names[value[5:-1]]})"
            elif name == "d":
                yield name, _short_path(value)
            elif name == "style":
                if style := _style(value):
                    yield name, re.sub(r"url\(#([\w-]+)\)", lambda match: f"url(#{self._names[match[1]]})", style)
            elif name == "transform":
                if not value.startswith("rotate(-0 "):
                    yield name, _rounded(value, 2)
            elif name in ("x", "y", "width", "height"):
                yield name, _rounded(value, 1 if tag != "image" else 3)
            elif name == "fill" and value.lower() in COLOURS and "style" not in one.attrib:
                # As a hatching has its ground.
                yield "style", f"fill:var(--{COLOURS[value.lower()]})"
            elif tag == "image" or not name.startswith("{"):
                yield name, str(escape(value))


def _style(text: str) -> str:
    kept = []
    for name, value in [map(str.strip, one.split(":", 1)) for one in text.split(";") if ":" in one]:
        if name == "font":
            name, value = "font-size", re.findall(r"[\d.]+px", value)[0]
        if name not in _IDLE and (name, value) not in _DEFAULT:
            colour = COLOURS.get(value.lower())
            kept.append(f"{name}:{f'var(--{colour})' if colour else _rounded(value, 2)}")
    return str(escape(";".join(kept)))


def _rounded(text: str, decimals: int) -> str:
    return re.sub(r"-?\d+\.\d+", lambda match: f"{round(float(match[0]), decimals):g}", text)


def _short_path(commands: str) -> str:
    """Return the attribute `d` of a path, in points, in fewer characters."""
    numbers = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", commands)]
    # Shapes no wider than this, such as markers, keep hundredths.
    small = bool(numbers) and max(numbers[::2]) - min(numbers[::2]) <= 12.0
    if small or re.search(r"[A-KN-Ya-kn-y]", commands.replace("e-", "")):
        places = 2 if small else 1
        text = re.sub(r"-?\d+\.\d+(?:e-?\d+)?", lambda match: _short(float(match[0]), places), commands)
        return re.sub(r"\s+", " ", re.sub(r"\s*([A-Za-z])\s*", r"\1", text)).strip()
    return "".join(_strokes(commands))


def _dots(uses: Sequence[Element], shapes: Mapping[str, Element]) -> tuple[str, str] | None:
    """Return many copies of one round marker as a single path, and its style; None for other copies."""
    names, styles = {one.get(_LINK, "")[1:] for one in uses}, {one.get("style", "") for one in uses}
    if len(names) != 1 or len(styles) != 1:
        return None
    (name,), (style,) = names, styles
    shape = "" if name not in shapes else shapes[name].get("d", "")
    inside, edge = (re.search(rf"(?<![\w-]){part}: (#[0-9a-f]{{6}})", style) for part in ("fill", "stroke"))
    # A circle is eight curves, as matplotlib draws it; what has an outline of its own colour stays as it is.
    if shape.count("C") != 8 or "fill: none" in style or inside is None or (edge and edge[1] != inside[1]):
        return None
    across = [float(number) for number in re.findall(r"-?\d+(?:\.\d+)?", shape)[::2]]
    width = max(across) - min(across)
    stroke = f"stroke: {inside[1]}; stroke-width: {width:.2f}; stroke-linecap: round; fill: none"
    if opacity := re.search(r"(?:fill-)?opacity: ([\d.]+)", style):
        stroke += f"; stroke-opacity: {opacity[1]}"
    # A stroke without length but with round ends is a dot, which takes a tenth of the characters of a copy.
    path = "".join(f"M{_short(float(one.get('x', 0)))} {_short(float(one.get('y', 0)))}h0" for one in uses)
    return path, stroke


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

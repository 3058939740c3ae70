"""What autodoc needs to know of the house: public names, and docstrings that state no types.

A class is documented under its public name, `bg.Trajectories`, wherever it lives; annotations that name its home lead
there. Types stand in annotations alone, so that in "Returns: One row for each effect: slug, ..." nothing before a colon
is one.
"""

import ast
from pathlib import Path

from docutils import nodes
from sphinx.application import Sphinx

PACKAGE = "bayes_greybox"

ELSEWHERE = {
    "ndarray": "numpy.ndarray",
    "Array": "jax.Array",
    "jax.jaxlib._jax.Array": "jax.Array",
    "jaxlib._jax.Array": "jax.Array",
    "matplotlib.axes._axes.Axes": "matplotlib.axes.Axes",
    "sympy.core.expr.Expr": "sympy.core.expr.Expr",
}
"""Names under which other projects document what annotations call otherwise."""


def public_names(stub: Path) -> dict[str, str]:
    """Public name by the full name of what it stands for, as the stub beside the package lists them."""
    found = {}
    for node in ast.parse(stub.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                found[f"{PACKAGE}.{node.module}.{alias.name}"] = f"{PACKAGE}.{alias.asname or alias.name}"
    return found


def _resolve(app: Sphinx, env, node, contnode: nodes.Element) -> nodes.Node | None:
    target = node.get("reftarget", "")
    if node.get("refdomain") != "py":
        return None
    if target in ELSEWHERE:
        node["reftarget"] = ELSEWHERE[target]  # intersphinx is asked next
        return None
    known = public_names(Path(app.srcdir).parent / PACKAGE / "__init__.pyi")
    short = {full.rpartition(".")[2]: name for full, name in known.items()}
    name = known.get(target) or short.get(target)
    if name is None:
        return None
    return env.get_domain("py").resolve_xref(env, node["refdoc"], app.builder, "obj", name, node, contnode)


def _without_types(app: Sphinx, what: str, name: str, obj: object, options: object, lines: list[str]) -> None:
    """A colon in front says that there is no type: in the first line of a property, and of what is returned."""
    firsts = [k + 1 for k, line in enumerate(lines[:-1]) if line.strip() in ("Returns:", "Yields:")]
    if what in ("attribute", "data", "property") and lines:
        firsts.append(0)
    for k in firsts:
        text = lines[k].lstrip()
        if ":" in text:
            lines[k] = f"{lines[k][: len(lines[k]) - len(text)]}: {text}"


def setup(app: Sphinx) -> dict[str, bool]:
    """Look up what Sphinx did not find, and read docstrings before napoleon does."""
    app.connect("missing-reference", _resolve, priority=400)
    app.connect("autodoc-process-docstring", _without_types, priority=400)
    return {"parallel_read_safe": True, "parallel_write_safe": True}

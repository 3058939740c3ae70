"""How Sphinx builds the site: `sphinx-build -W --keep-going -n docs build/site`, without a network."""

import sys
import tomllib
from pathlib import Path

DOCS = Path(__file__).parent
ROOT = DOCS.parent

# The extensions of this site, and the checkout itself where it is not installed.
sys.path[:0] = [str(DOCS / "_ext"), str(ROOT)]

project = "bayes_greybox"
release = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
author = "The bayes_greybox developers"
project_copyright = "The bayes_greybox developers"
language = "en"

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "sphinx.ext.napoleon",
    "myst_nb",
    "mathml",
    "catalogue_pages",
    "gallery_pages",
    "outside",
    "public_names",
]

exclude_patterns = [
    "_ext",
    "inventories",
    "gallery",
]

# Notebooks show the outputs that they were stored with.
nb_execution_mode = "off"
nb_merge_streams = True
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4

# Docstrings have words of code between single backticks, as Markdown has.
default_role = "code"
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
autosummary_generate = True
autosummary_imported_members = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_attr_annotations = False
python_use_unqualified_type_names = True
nitpicky = True
# Types that only the rooms of the package know, and shapes of arrays, are text.
nitpick_ignore_regex = [
    ("py:.*", r"jaxtyping\..*"),
    ("py:class", r"'.*'|_"),
    ("py:.*", r"bayes_greybox\.(\w+\.)+\w+"),
]

# Names that pages link to, as files: nothing is fetched.
intersphinx_mapping = {
    name: (address, str(DOCS / "inventories" / f"{name}.inv"))
    for name, address in {
        "python": "https://docs.python.org/3/",
        "numpy": "https://numpy.org/doc/stable/",
        "pandas": "https://pandas.pydata.org/docs/",
        "xarray": "https://docs.xarray.dev/en/stable/",
        "matplotlib": "https://matplotlib.org/stable/",
        "sympy": "https://docs.sympy.org/latest/",
        "jax": "https://docs.jax.dev/en/latest/",
    }.items()
    if (DOCS / "inventories" / f"{name}.inv").is_file()
}
intersphinx_disabled_reftypes = ["std:*"]

html_theme = "pydata_sphinx_theme"
html_title = f"bayes_greybox {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
# Pages without pages below them have no list of these.
html_sidebars = {page: [] for page in ("index", "start", "cite", "search", "genindex", "py-modindex")}
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "navbar_end": ["theme-switcher"],
    "navbar_persistent": ["search-button"],
    "show_prev_next": False,
    "secondary_sidebar_items": ["page-toc"],
    "header_links_before_dropdown": 9,
    "footer_start": ["copyright"],
    "footer_end": [],
}

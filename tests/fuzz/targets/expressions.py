"""Search for formulas that crash the parser, hang it or are executed; see CONTRIBUTING."""

from searching import search  # isort: skip
import probes

search(lambda given, _: probes.expression(given.decode("utf-8", "replace")))

"""Search for configurations that crash the package, hang it, are executed or write anything; see CONTRIBUTING."""

from searching import search  # isort: skip
import probes

search(probes.config)

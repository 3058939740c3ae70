"""Every figure: of fits, of studies, and of numbers of your own.

Figures of results take the result: `coefficients(fit)`, `gap_map(study, "ydot")`; `fit_figures` and `study_figures`
draw them all. The functions plot_* draw numbers that are handed to them. The stub beside this file lists them; each is
imported when it is first used.

Each function returns the figure. It is not registered with pyplot: in a notebook it shows once, as the value
of the cell, and a loop that draws hundreds leaves nothing open. Hand over axes of your own to draw into a
figure of your own.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

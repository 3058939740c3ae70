"""Free terms, corrections and effects of one equation, evaluated at its rows."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.discovery.grid.table import CORRECTION, EFFECT, FREE
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.program import Program
from bayes_greybox.model.scaling import discrepancy_box, features_per_variable
from bayes_greybox.physics.catalogue.effects import BoundEffect

from .columns import Values, at_values, first_values
from .regressors import ALWAYS_ZERO, Regressors

LAW_FEATURES = {1: 32, 2: 12, 3: 8}
"""Features per variable when the user names none: finer than in a fit, since the gap may be finer than the discrepancy
beside the effects that close it, and no chain has to pay for them."""

INPUT_ROLE = "input"
"""Role of a drive: the usual signs of its effects are relative to the simulation's own."""


def regressors_of(
    model: Program, data: Trajectories, equation: str, effects: Sequence[BoundEffect],
    values: Mapping[str, Values] | None = None, shown: Float[np.ndarray, " n_row"] | float = 0.0,
) -> Regressors:  # fmt: skip
    """Return free terms, corrections and effects of one equation.

    Raises:
        InputError: The simulation equals the measurement exactly; a variable of f that is constant or unknown.
    """
    plain = model.equation_rows(data, equation)
    rows = replace(plain, measured=plain.measured + shown / plain.gain)
    gp = model.discrepancy or OrthogonalGP()
    variables, centre, half_width = discrepancy_box(gp, rows.columns)
    simulation = model.simulator(data)
    per_variable = LAW_FEATURES.get(len(variables))
    default = None if per_variable is None else (per_variable,) * len(variables)
    basis = HilbertBasis(gp.boundary, features_per_variable(gp, len(variables), default))
    hidden = any(effect.effect.hidden for effect in effects)
    path = model.rows.nodes(data, equation, simulation, whole=True) if hidden else None
    regressors = Regressors(variables, centre, half_width, basis, path=path, rows=rows)
    if model.dictionary.get(equation, ()):
        stated = model.stated(equation, data)
        spreads = {name: prior.sd for name, prior in stated.priors.items()}
        regressors.add(FREE, [(term, {"spread": spreads.get(term.name)}) for term in stated.learned])
    parts = simulation.additive_terms(equation)
    regressors.add(CORRECTION, [(term, {"nominal": value}) for term, value in parts])
    nominals = {term.name: value for term, value in parts}
    terms = {regressors.columns[i].formula.name for i in regressors.of_kind(FREE)} | set(nominals)
    # An input that acts late on another body, or as a factor, has no lag here.
    idle = [e for e in effects if e.effect.nominal and e.names[e.effect.nominal] not in terms]
    regressors.leave_out({e.slug: "the equation has no term of its own with this input" for e in idle})
    items, without_range = [], []
    for effect in effects:
        if effect in idle:
            continue
        nominal = nominals.get(effect.names.get(effect.effect.nominal, ""), 0.0)
        about = {"nominal": nominal, "direction": -1 if nominals.get(effect.names.get(INPUT_ROLE, ""), 0.0) < 0 else 1}
        if not effect.effect.inner:
            items.append((effect.term(), {"effect": effect, **about}))
            continue
        chosen = (values or {}).get(effect.label) or first_values(effect, rows.columns, path)
        if chosen is None:
            without_range.append(effect.slug)
        else:
            items += at_values(effect, chosen, **about)
    regressors.add(EFFECT, items)
    regressors.leave_out(dict.fromkeys(without_range, ALWAYS_ZERO))
    return regressors

"""Free terms, corrections and effects of one equation, evaluated at its rows."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.program import Program
from bayes_greybox.model.scaling import discrepancy_box, features_per_variable
from bayes_greybox.physics.catalogue.effects import BoundEffect

from .columns import Values, at_values, first_values
from .regressors import CORRECTION, EFFECT, FREE, ZERO, Regressors

FEATURES = {1: 32, 2: 12, 3: 8}
"""Features per variable when the user names none: finer than in a fit, since what is missing may be finer than what is
left after it was added, and no chain has to pay for them."""


INPUT = "input"
"""Role of what drives: the usual signs of its effects are relative to the simulation's own."""


def regressors_of(
    model: Program, data: Trajectories, equation: str, effects: Sequence[BoundEffect],
    values: Mapping[str, Values] | None = None, shown: Float[np.ndarray, " n_row"] | float = 0.0,
) -> Regressors:  # fmt: skip
    """Return free terms, corrections and effects of one equation.

    Args:
        model: Simulation, free terms, and the discrepancy whose features are used.
        data: Training data.
        equation: The learned state.
        effects: Effects bound to columns.
        values: Values of nonlinear parameters by the effect's label; the first ones of all others.
        shown: What the sensors showed at the rows beyond what the data have, in the sensors' units.

    Raises:
        InputError: The simulation equals the measurement exactly; a variable of f that is constant or unknown.
    """
    plain = model.equation_rows(data, equation)
    rows = replace(plain, measured=plain.measured + shown / plain.gain)
    gp = model.discrepancy or OrthogonalGP()
    variables, centre, half_width = discrepancy_box(gp, rows.columns)
    simulation = model.simulator(data)
    remember = any(effect.effect.hidden for effect in effects)
    finer = FEATURES.get(len(variables))
    default = None if finer is None else (finer,) * len(variables)
    basis = HilbertBasis(gp.boundary, features_per_variable(gp, len(variables), default))
    path = model.rows.nodes(data, equation, simulation, whole=True) if remember else None
    found = Regressors(rows, variables, centre, half_width, basis, path=path)
    if model.dictionary.get(equation, ()):
        stated = model.stated(equation, data)
        spreads = {name: prior.sd for name, prior in stated.priors.items()}
        found.add(FREE, [(term, {"spread": spreads.get(term.name)}) for term in stated.learned])
    parts = simulation.additive_terms(equation)
    found.add(CORRECTION, [(term, {"nominal": value}) for term, value in parts])
    known = {term.name: value for term, value in parts}
    own = {term.name for term in (found.columns[i].formula for i in found.of_kind(FREE))} | set(known)
    # What acts late on another body, or as a factor, is no lag here.
    idle = [e for e in effects if e.effect.nominal and e.names[e.effect.nominal] not in own]
    found.leave_out({e.slug: "the equation has no term of its own with this input" for e in idle})
    items, lost = [], []
    for effect in effects:
        if effect in idle:
            continue
        nominal = known.get(effect.names.get(effect.effect.nominal, ""), 0.0)
        about = {"nominal": nominal, "direction": -1 if known.get(effect.names.get(INPUT, ""), 0.0) < 0 else 1}
        if not effect.effect.inner:
            items.append((effect.term(), {"effect": effect, **about}))
            continue
        chosen = (values or {}).get(effect.label) or first_values(effect, rows.columns, path)
        if chosen is None:
            lost.append(effect.slug)
        else:
            items += at_values(effect, chosen, **about)
    found.add(EFFECT, items)
    found.leave_out(dict.fromkeys(lost, ZERO))
    return found

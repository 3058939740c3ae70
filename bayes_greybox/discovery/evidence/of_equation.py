"""Sufficient statistics of one equation of a model: its terms, what may be off in its simulation, and effects."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.assemble import with_rounding
from bayes_greybox.model.gp.discrepancy import OrthogonalGP
from bayes_greybox.model.gp.features import HilbertBasis
from bayes_greybox.model.program import Program
from bayes_greybox.model.scaling import discrepancy_box, features_per_variable
from bayes_greybox.physics.catalogue.effects import BoundEffect

from .columns import nodes
from .sufficient_statistics import ZERO, SufficientStatistics

FEATURES = {1: 40, 2: 16, 3: 10}
"""Features per variable when the user names none: finer than in a fit, since what is missing may be finer than what is
left after it was added, and no chain has to pay for them."""


def sufficient_statistics(
    model: Program, data: Trajectories, equation: str, effects: Sequence[BoundEffect],
    shown: Float[np.ndarray, " n_row"] | float = 0.0, found: Mapping[str, Mapping[str, float]] | None = None,
) -> SufficientStatistics:  # fmt: skip
    """Free terms, corrections and effects of one equation, evaluated and multiplied out.

    Args:
        model: Simulation, free terms, and the discrepancy whose features are used.
        data: Training data.
        equation: The learned state.
        effects: Effects bound to columns.
        shown: What the sensors showed at the rows beyond what the data have, in the sensors' units.
        found: Inner parameters of effects whose hidden states the model has, by their labels.

    Raises:
        InputError: The simulation equals the measurement exactly; a variable of f that is constant or unknown.
    """
    plain = model.equation_rows(data, equation)
    rows = replace(plain, measured=plain.measured + shown / plain.gain)
    target_scale = rows.scale
    gp = model.discrepancy or OrthogonalGP()
    variables, centre, half_width = discrepancy_box(gp, rows.columns)
    simulation = model.simulator(data)
    remember = any(effect.effect.hidden for effect in effects)
    finer = FEATURES.get(len(variables))
    default = None if finer is None else (finer,) * len(variables)
    basis = HilbertBasis(gp.boundary, features_per_variable(gp, len(variables), default))
    floor = with_rounding(plain.measured / target_scale, model.noise_floor)
    statistics = SufficientStatistics(
        rows=rows,
        variables=variables,
        centre=centre,
        half_width=half_width,
        basis=basis,
        kernel=gp.kernel,
        prior=replace(model, discrepancy=gp).hyper_prior(floor, len(variables)),
        path=model.rows.nodes(data, equation, simulation, whole=True) if remember else None,
    )
    if model.dictionary.get(equation, ()):
        stated = model.stated(equation, data)
        spreads = {name: prior.sd for name, prior in stated.priors.items()}
        statistics.add("free", [(term, {"spread": spreads.get(term.name)}) for term in stated.learned])
    parts = simulation.additive_terms(equation)
    statistics.add("correction", [(term, {"nominal": value}) for term, value in parts])
    items = {
        effect: nodes(effect, rows.columns, path=statistics.path, known=(found or {}).get(effect.label))
        for effect in effects
    }
    known = {term.name: value for term, value in parts}
    own = {term.name for term in (statistics.columns[i].formula for i in statistics.of_kind("free"))} | set(known)
    # What acts late on another body, or as a factor, is no lag here.
    idle = [e for e in effects if e.effect.nominal and e.names[e.effect.nominal] not in own]
    statistics.leave_out({e.slug: "the equation has no term of its own with this input" for e in idle})
    effects = [e for e in effects if e not in idle]
    nominal = {effect: known.get(effect.names.get(effect.effect.nominal, ""), 0.0) for effect in effects}
    statistics.add("effect", [(t, {**about, "nominal": nominal[each]}) for each in effects for t, about in items[each]])
    statistics.leave_out({effect.slug: ZERO for effect, found in items.items() if not found})
    return statistics

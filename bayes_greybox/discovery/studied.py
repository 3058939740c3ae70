"""Which equations a study looks at."""

from bayes_greybox.data.trajectories import Trajectories
from bayes_greybox.model.program import Program
from bayes_greybox.running.errors import InputError


def studied_equations(model: Program, data: Trajectories) -> tuple[str, ...]:
    """Equations a study looks at: those of the dictionary, or all whose rate or output the simulation misses.

    Raises:
        InputError: There is none.
    """
    if model.dictionary:
        if len(model.equations) > len(model.blocks):
            raise InputError(
                f"A study on rows of samples looks at one equation, not at {', '.join(model.equations)} together: "
                "leave one in GreyBox(dictionary=...) and put what is known of the others into the simulation. Their "
                "coefficients can be estimated together by GreyBox.fit."
            )
        return model.equations
    simulation = model.simulator(data)
    if model.rows.shared:
        found = tuple(name for name in simulation.equations if not simulation.kinematic(name))
        if len(found) != 1:
            raise InputError(
                f"A study of samples looks at one equation, and the simulation has {len(found) or 'none'} that could "
                "lack something: name the one in question with an empty list of terms, "
                f"GreyBox(dictionary={{{(found or ('ydot',))[0]!r}: []}}, ...), or give rates: derivatives=..., or "
                "data.differentiate()."
            )
        return found
    names = (*data.derivative_names, *data.output_names)
    found = tuple(name for name in names if not simulation.kinematic(name))
    # Which equations of a function are kinematic cannot be read off it; but the data meet them exactly.
    left = tuple(name for name in found if not model.equation_rows(data, name).nothing_left)
    if found and not left:
        what = "output" if all(data.is_output(name) for name in found) else "derivative"
        raise InputError(f"The simulation equals every measured {what} exactly: there is nothing to look for.")
    if not found:
        raise InputError(
            "There is no equation to study: the data have no measured derivative of a state whose equation is more "
            "than another state; give derivatives=..., or compute them with data.differentiate()."
        )
    return left

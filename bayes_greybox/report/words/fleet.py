"""What a fleet of studies says, in sentences."""

from bayes_greybox.discovery.fleet import ONE_CAUSE, Fleet, Shared

from .formatting import formula, listed, number, probability_text, quantity


def fleet_sentence(fleet: Fleet) -> str:
    """The fleet in one sentence: how many assets lack what, and whether that is one cause."""
    n, gap, failed = len(fleet.studied), fleet.with_gap, len(fleet.failed)
    rest = f" {failed} of {n + failed} files could not be studied." if failed else ""
    if not n:
        return f"None of {failed} assets could be studied."
    if not gap:
        return f"Nothing is missing in {'the one asset' if n == 1 else f'any of {n} assets'}.{rest}"
    cause = fleet.cause
    if cause is None:
        lacking = [f"{s.name.lower()} ({len(s.assets)})" for s in fleet.shared[:4]]
        what = f"; what they lack differs: {listed(lacking)}" if lacking else ""
        return f"{gap} of {n} {'asset has' if n == 1 else 'assets have'} a gap{what}.{rest}"
    return (
        f"{len(cause.assets)} of {n} assets lack {cause.name.lower()} in the equation of {cause.equation}"
        f"{_of(cause)}.{rest}"
    )


def _of(cause: Shared) -> str:
    if cause.whole is None:
        return ""
    whole = cause.whole
    size = f"{quantity(whole.mean, cause.unit)} ± {number(whole.sd, 2)}"
    if whole.same > ONE_CAUSE:
        return f", with one coefficient in all of them: {size} (probability {probability_text(whole.same)})"
    if whole.same < 1 - ONE_CAUSE:
        between = f"a standard deviation of {number(whole.between)} between them"
        return f", with coefficients that differ: {size} on the whole, {between}"
    return f", with a coefficient of {size} on the whole; whether it differs between them these data do not tell"


def shared_text(shared: Shared) -> str:
    """An effect's heading: its name, formula and equation."""
    return f"{shared.name}, {formula(shared.expression)}, in the equation of {shared.equation}"

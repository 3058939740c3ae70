"""What a fleet of studies says, in sentences."""

from bayes_greybox.discovery.fleet import ONE_CAUSE, Fleet, Shared
from bayes_greybox.physics.catalogue.names import within

from .formatting import formula, listed, number, probability_text, quantity


def fleet_sentence(fleet: Fleet) -> str:
    """The fleet in one sentence: how many assets lack what, and whether that is one cause."""
    n, failed = len(fleet.studied), len(fleet.failed)
    if not n:
        return f"None of {_assets(failed)} could be studied."
    return f"{_found(fleet)}.{f' {failed} of {n + failed} files could not be studied.' if failed else ''}"


def shared_text(shared: Shared) -> str:
    """An effect's heading: its name, formula and equation."""
    return f"{shared.name}, {formula(shared.expression)}, in the equation of {shared.equation}"


def _found(fleet: Fleet) -> str:
    n, gap = len(fleet.studied), fleet.with_gap
    if not gap:
        return f"Nothing is missing in {'the one asset' if n == 1 else f'any of {n} assets'}"
    have = f"{gap} of {_assets(n)} {'has' if gap == 1 else 'have'} a gap"
    if not fleet.shared:
        return f"{have}, which no effect of the catalogue closes"
    if not fleet.causes:
        lacking = [f"{within(each.name)} ({len(each.assets)})" for each in fleet.shared[:4]]
        if gap == 1:
            return f"{have}: {fleet.shared[0].assets[0]} lacks {listed([within(each.name) for each in fleet.shared])}"
        return f"{have}; what they lack differs: {listed(lacking)}"
    first, *others = fleet.causes
    names = listed([f"{within(each.name)} in the equation of {each.equation}" for each in fleet.causes])
    of = "" if others else _of(first)
    return f"{len(first.assets)} of {_assets(n)} lack {names}{_maybe(first)}{of}"


def _maybe(cause: Shared) -> str:
    """Those whose data tell no more than that it may be this."""
    return f" ({len(cause.possible)} more may)" if cause.possible else ""


def _of(cause: Shared) -> str:
    if cause.whole is None:
        return ""
    whole = cause.whole
    size = f"{quantity(whole.mean, cause.unit)} ± {number(whole.sd, 2)}"
    if whole.same > ONE_CAUSE:
        return f", with one coefficient in all of them: {size} (probability {probability_text(whole.same)})"
    if whole.same < 1 - ONE_CAUSE:
        between = f"a standard deviation of {number(whole.between)} between them"
        return f", with coefficients that differ: {size} in their mean, {between}"
    return f", with a coefficient of {size} in their mean; whether it differs between them these data do not tell"


def _assets(n: int) -> str:
    return f"{n} asset" if n == 1 else f"{n} assets"

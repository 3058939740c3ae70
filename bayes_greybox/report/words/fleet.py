"""Sentences about a fleet of studies."""

from collections.abc import Iterable

from bayes_greybox.discovery.decision.criteria import Criteria
from bayes_greybox.discovery.fleet.shared import LACKING, ONE_CAUSE, AssetStudy, Fleet, Shared
from bayes_greybox.physics.catalogue.names import within

from .formatting import counted, formula, listed, number, probability_text, quantity, unit_text


def fleet_sentence(fleet: Fleet) -> str:
    """Return a fleet in a few words: how many assets lack something, its causes, and other faults."""
    n, failed = len(fleet.studied), len(fleet.failed)
    if not n:
        return f"None of {counted(failed, 'asset')} could be studied."
    off, wrong = fleet.recalibrated, fleet.mismeasured

    def so_many(k: int) -> str:
        return f"{'it' if n == 1 else k} {'has' if k == 1 else 'have'}"

    others = [f"{so_many(off)} a wrong coefficient"] if off else []
    others += [f"{wrong if off else so_many(wrong)} a fault of the measurement"] if wrong else []
    if fleet.lacking:
        text = f"{_lacking(fleet)}{f'. Of the others {listed(others)}' if others else ''}"
    else:
        text = f"Nothing is missing in {'the one asset' if n == 1 else f'any of {n} assets'}"
        text += f", but {listed(others)}" if others else ""
    return f"{text}.{f' {failed} of {n + failed} files could not be studied.' if failed else ''}"


def shared_text(shared: Shared) -> str:
    """Return the heading of an effect: its name, formula and equation."""
    return f"{shared.name}, {formula(shared.expression)}, in the equation of {shared.equation}"


def lacks_text(asset: AssetStudy) -> str:
    """Return the effects that an asset lacks, and those that it may lack; a dash for nothing."""
    return ", ".join([*asset.lacks, *(f"perhaps {within(name)}" for name in asset.may_lack)]) or "–"


def likely_text(probabilities: Iterable[float]) -> str:
    """Return probabilities in some assets as their range: 0.758, or 0.612 to 0.758; a dash for none."""
    ordered = sorted(probabilities)
    return " to ".join(dict.fromkeys(map(probability_text, (ordered[0], ordered[-1])))) if ordered else "–"


def unit_of(shared: Shared) -> str:
    """Return the unit of an effect's coefficient, all of them where assets differ; a dash where it is not known."""
    if shared.one_unit:
        return unit_text(shared.unit) or "–"
    return " or ".join(dict.fromkeys(unit_text(unit) or "not known" for unit in shared.units)) or "–"


def why_not_pooled(shared: Shared) -> str:
    """Return why the coefficients of several assets are not pooled, as a clause; "" where they are."""
    if len(shared.assets) < 2 or shared.whole is not None:
        return ""
    if not shared.one_unit:
        return f"their units differ ({unit_of(shared)})"
    if shared.differing:
        what = f"nonlinear parameter{'s' if len(shared.differing) > 1 else ''} {listed(shared.differing)}"
        return f"the {what} {'differ' if len(shared.differing) > 1 else 'differs'}"
    return f"that of {listed(shared.unsized)} has no standard deviation above zero"


def not_pooled(fleet: Fleet) -> list[str]:
    """Return a sentence on each effect whose coefficients are not pooled."""
    reasons = [(within(each.name), why) for each in fleet.shared if (why := why_not_pooled(each))]
    return list(dict.fromkeys(f"The coefficients of {name} are not pooled, as {why}." for name, why in reasons))


def _lacking(fleet: Fleet) -> str:
    n, k = len(fleet.studied), fleet.lacking
    have = f"{k} of {counted(n, 'asset')} {'lacks' if k == 1 else 'lack'} something"
    if not fleet.shared:
        return f"{have} that the catalogue does not have"
    if k == 1:
        (asset,) = (each.asset for each in fleet.studied if each.verdict in LACKING)
        sure = [within(each.name) for each in fleet.shared if each.assets]
        perhaps = [_perhaps(each, within(each.name)) for each in fleet.shared if not each.assets]
        return f"{have}: {asset} {listed([*([f'lacks {listed(sure)}'] if sure else []), *perhaps])}"
    if common := fleet.causes or fleet.suspected:
        causes = [_who(each, "" if place else f" of {counted(n, 'asset')}") for place, each in enumerate(common)]
        return f"{listed(causes)}{_of(common[0]) if len(common) == 1 else ''}"
    names = [within(each.name) for each in fleet.shared]
    effects = [
        # One name may be that of two formulas.
        f"{name}{f' {formula(each.expression)}' if names.count(name) > 1 else ''} ({_count(each)})"
        for name, each in zip(names, fleet.shared, strict=True)
    ]
    return f"{have}; what they lack differs: {listed(effects[:4])}"


def _who(shared: Shared, of: str) -> str:
    sure, more = len(shared.assets), len(shared.possible)
    what = f"{within(shared.name)} in the equation of {shared.equation}"
    if not sure:
        return f"{len(shared.likely)}{of} {_perhaps(shared, what)}"
    return f"{sure}{of} {'lacks' if sure == 1 else 'lack'} {what}{f' ({more} more may)' if more else ''}"


def _perhaps(shared: Shared, what: str) -> str:
    """Return that assets of which none is sure may lack an effect, or else have a fault of a sensor."""
    n, more = len(shared.likely), len(shared.possible) - len(shared.likely)
    lack = (
        f"most likely {'lacks' if n == 1 else 'lack'}"
        if min(shared.likely.values()) >= Criteria.missing
        else "may lack"
    )
    p = f"probability {likely_text(shared.likely.values())}{f'; {more} more may' if more else ''}"
    fault = f", or else a sensor is at fault ({', '.join(shared.faults)})" if shared.faults else ""
    return f"{lack} {what} ({p}){fault}"


def _count(shared: Shared) -> str:
    """Return the number of assets that lack an effect: 2; or 2, 1 more may; or 1 may."""
    sure, may = len(shared.assets), len(shared.possible)
    return ", ".join([*([str(sure)] if sure else []), *([f"{may} {'more ' if sure else ''}may"] if may else [])])


def _of(cause: Shared) -> str:
    if why := why_not_pooled(cause):
        return f", with coefficients that are not pooled, as {why}"
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

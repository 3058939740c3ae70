"""Forward rounds that add one effect at a time, and the backward check that every effect is still wanted."""

from collections.abc import Callable
from dataclasses import dataclass

from .hypotheses import Contest, Round

STOPS = ("no gap", "recalibrate", "unknown", "enough")
"""Explanations that are not effects."""

TIED = 0.05
"""An effect whose probability is at least this share of the best one's is tied with it."""

SAME = 1e-3
"""Effects whose log evidences differ by less are one effect under two names on these data."""

NEGLIGIBLE, SUBSTANTIAL = 0.05, 0.3
"""Share of the gap left to f up to which an effect names it, and from which even "partly named" is too much."""


@dataclass(frozen=True)
class Step:
    """One forward round: what was likeliest and what was added.

    Attributes:
        probabilities: By name, largest first.
        added: Slug that was added, or "".
        share_left: Share of the gap left to f after the likeliest explanation.
    """

    probabilities: dict[str, float]
    added: str
    share_left: float


@dataclass(frozen=True)
class Finding:
    """What the rounds came to for one equation.

    Attributes:
        verdict: "no gap", "recalibrate", "named", "partly named" or "unknown".
        base: Column of each effect that was added; none where the verdict is "unknown".
        probability: Posterior probability of each of these, given the others.
        ties: For each of these, the slugs that the data cannot tell it from.
        first: The first round.
        last: The round after the last effect.
        steps: The ladder.
        remainder: Probability that f remains.
        share_left: Share of the gap that f carries then.
    """

    verdict: str
    base: tuple[int, ...]
    probability: tuple[float, ...]
    ties: tuple[tuple[str, ...], ...]
    first: Round
    last: Round
    steps: tuple[Step, ...]
    remainder: float
    share_left: float


def search(
    contest: Contest, most: int, seed: int | None = None, report: Callable[[str], None] = lambda text: None
) -> Finding:
    """Add effects while one more is likelier than none, then check each against all others.

    Args:
        contest: Evaluates a round.
        most: Largest number of effects.
        seed: Seed of the chains that settle finalists by bridge sampling; None: no chains.
        report: Told in words what is being done.
    """
    base: tuple[int, ...] = ()
    steps: list[Step] = []

    def weigh(base: tuple[int, ...]) -> Round:
        return contest.round(base) if seed is None else contest.settle(base, seed)

    report("weighing explanations")
    first = last = weigh(())
    while True:
        probabilities = last.probabilities()
        slugs = [name for name in probabilities if name not in STOPS]
        stop = max((name for name in probabilities if name in STOPS), key=lambda name: probabilities[name])
        wanted = slugs and _with_twins(last, slugs) > probabilities[stop]
        best = last.best(slugs[0]) if wanted else last.best(stop)
        adding = bool(wanted) and len(base) < most
        steps.append(Step(probabilities, best.name if adding else "", best.share_left))
        if not adding or best.best is None:
            break
        base = (*base, best.best)
        report(f"added {best.name}, weighing what is left")
        last = weigh(base)
    base, changed = _checked(contest, base)
    if changed:
        last = weigh(base) if base else first
    probability, ties = [], []
    for k, index in enumerate(base):
        given = (contest.round((*base[:k], *base[k + 1 :])) if len(base) > 1 else first).probabilities()
        name = contest.evaluations.name(index)
        # Given that the others are in, "enough" takes the place of "no gap".
        probability.append(given.get(name, 0.0))
        ties.append(tuple(s for s in given if s not in (*STOPS, name) and given[s] >= TIED * given.get(name, 0.0)))
    remainder, share = _left(last)
    verdict = _verdict(first, base, remainder, share)
    if verdict == "unknown":
        # What only imitates the unknown is not added to anybody's model; the ladder shows that it was tried.
        base, probability, ties = (), [], []
    return Finding(verdict, base, tuple(probability), tuple(ties), first, last, tuple(steps), remainder, share)


def _checked(contest: Contest, base: tuple[int, ...]) -> tuple[tuple[int, ...], bool]:
    """Replace or drop effects that another, or none, explains better given the rest."""
    changed = False
    if len(base) < 2:
        return base, changed
    for _ in range(2):
        stable = True
        for k in range(len(base)):
            others = (*base[:k], *base[k + 1 :])
            again = contest.round(others)
            probabilities = again.probabilities()
            slugs = [name for name in probabilities if name not in STOPS]
            if slugs[0] == contest.evaluations.name(base[k]) and probabilities[slugs[0]] > 0.5:
                continue
            stop = max((name for name in probabilities if name in STOPS), key=lambda name: probabilities[name])
            if probabilities[stop] > _with_twins(again, slugs) and stop != "unknown":
                return others, True
            best = again.best(slugs[0]).best
            if best is not None and slugs[0] != contest.evaluations.name(base[k]):
                base, stable, changed = (*base[:k], best, *base[k + 1 :]), False, True
        if stable:
            break
    return base, changed


def _with_twins(found: Round, slugs: list[str]) -> float:
    """Probability of the likeliest effect, and of all that are the same to the data: names must not split a vote."""
    probabilities, top = found.probabilities(), found.best(slugs[0]).log_evidence
    return sum(probabilities[s] for s in slugs if abs(found.best(s).log_evidence - top) < SAME)


def _left(last: Round) -> tuple[float, float]:
    """Probability that f remains after the last effect, and the share of the gap it carries then."""
    probabilities = last.probabilities()
    enough, unknown = probabilities.get("enough", 0.0), probabilities.get("unknown", 0.0)
    if not last.base:
        return unknown, last.best("unknown").share_left
    more = sum(p for name, p in probabilities.items() if name not in STOPS)
    return unknown / max(enough + unknown, 1e-300) if more < 0.5 else 1.0, last.best("unknown").share_left


def _verdict(first: Round, base: tuple[int, ...], remainder: float, share: float) -> str:
    if not base:
        probabilities = {n: p for n, p in first.probabilities().items() if n in STOPS}
        return max(probabilities, key=lambda name: probabilities[name])
    if remainder < 0.5 or share < NEGLIGIBLE:
        return "named"
    # Effects that are stacked up and still leave a rest are more likely imitating one that the catalogue does not have.
    return "partly named" if share < SUBSTANTIAL and len(base) == 1 else "unknown"

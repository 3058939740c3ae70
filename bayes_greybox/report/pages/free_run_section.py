"""The section of a page with free runs: each state as measured, and as models run it from its start alone."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from bayes_greybox.criticism.bands import band_sources
from bayes_greybox.criticism.trial import Trial, trial
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report import plots as figures
from bayes_greybox.report.words.formatting import listed, number, percent_text, share_text

from .page import Pictures, Section, Table, Words, time_picture

ANCHOR = "free-run"


def free_run_section(
    title: str,
    lead: str,
    drawn: Mapping[str, Callable[[float], Figure]],
    holds: Iterable[str],
    further: Sequence[Any] = (),
    shown: str = "against the measurements",
) -> Section:
    """Return free runs as a section.

    Args:
        title: Its title.
        lead: Sentence on the data and the starts, which one on the bands follows.
        drawn: Draws the figure of each state at a width in inches.
        holds: Contents of the bands, as their legends have them.
        further: Blocks above the figures.
        shown: Contents of the figures beside the free run.
    """
    pictures = [time_picture(draw, f"Free run of {state} {shown}") for state, draw in drawn.items()]
    bands = f" Bands hold 90 % of the posterior draws{_varied(holds)}; a cross marks where a run failed."
    blocks = [*further, *([Pictures(pictures)] if pictures else [])]
    return Section(ANCHOR, title, lead + (bands if pictures else ""), blocks)


def trial_sections(fit: Posterior) -> list[Section]:
    """Return the section of a fit's errors and free run on held-out data, or else on the training data.

    Args:
        fit: The fit.

    Returns:
        The section; none for outputs alone, of which none were held out.
    """
    found = trial(fit)
    run = found.run
    rows = [
        *(
            (f"mean square error of the predicted {_rate(fit, name)}, over its variance", share_text(error))
            for name, error in found.nmse.items()
        ),
        *(
            (f"RMS error of the free run of {name}, over its standard deviation", percent_text(error))
            for name, error in _errors(found).items()
        ),
    ]
    if run is None and not (rows or found.why):
        return []
    blocks: list[Any] = [Table(("measure", "#value"), rows)] if rows else []
    if run is None:
        if found.why:
            blocks.append(Words(f"There is no free run. {found.why}"))
    else:
        blocks += [Words(text) for text in _failures(found)]
    size = f"{number(found.n_obs)} rows{f' in {found.n_run} runs' if found.n_run > 1 else ''}"
    lead = (
        f"{size} that the model did not learn from."
        if found.held_out
        else (f"On the training data, {size}, as none were held out.")
    )
    lead += " The model is started where the measurements start and then left alone." if run else ""
    drawn = {} if run is None else {state: partial(figures.simulated, run, state) for state in run.states}
    title = "How does it do on held-out data?" if found.held_out else "Does it follow the measurements by itself?"
    return [free_run_section(title, lead, drawn, [] if run is None else [run.holds], blocks)]


def _errors(found: Trial) -> dict[str, float]:
    return {} if found.run is None else {str(name): float(value) for name, value in found.run.nrmse().items()}


def _failures(found: Trial) -> list[str]:
    """Return the runs that blew up, and when, as a sentence."""
    assert found.run is not None
    run, unit = found.run, found.run.data.unit("t") or ""
    failed = [
        f"{percent_text(float(share))} of the draws{f' in run {name}' if found.n_run > 1 else ''} after "
        f"{number(float(at) - float(run.data.time[run.data.run == k][0]))} {unit}".strip()
        for k, (name, share, at) in enumerate(zip(run.data.run_names, run.failed, run.failed_at, strict=True))
        if share > 0
    ]
    return [f"The free run blows up: {listed(failed)}."] if failed else []


def _rate(fit: Posterior, name: str) -> str:
    return fit.data.target_label(name) if name in fit.model.equations else "samples"


def _varied(holds: Iterable[str]) -> str:
    """Return the quantities that vary between the draws, as a clause."""
    held = {band_sources(each) for each in holds} - {""}
    return f", which vary in {held.pop()}" if held else ""

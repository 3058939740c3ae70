"""The section of a page with free runs: each state as measured, and as models run it from its start alone."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from bayes_greybox.criticism.bands import band_sources
from bayes_greybox.criticism.free_run import FreeRun
from bayes_greybox.criticism.trial import trial
from bayes_greybox.inference.posterior import Posterior
from bayes_greybox.report import plots as figures
from bayes_greybox.report.words.fit import row_label
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

    There is none for outputs alone, of which none were held out.
    """
    tried = trial(fit)
    run = tried.run
    rows = []
    for name, error in tried.nmse.items():
        predicted = row_label(fit, name, "samples")
        rows.append((f"mean square error of the predicted {predicted}, over its variance", share_text(error)))
    for name, error in run.nrmse().items() if run else ():
        rows.append((f"RMS error of the free run of {name}, over its standard deviation", percent_text(float(error))))
    if run is None and not (rows or tried.why):
        return []
    blocks: list[Any] = [Table(("measure", "#value"), rows)] if rows else []
    if tried.why and run is None:
        blocks.append(Words(f"There is no free run. {tried.why}"))
    size = f"{number(tried.n_obs)} rows{f' in {tried.n_run} runs' if tried.n_run > 1 else ''}"
    if tried.held_out:
        title, lead = "How does it do on held-out data?", f"{size} that the model did not learn from."
    else:
        title = "Does it follow the measurements by itself?"
        lead = f"On the training data, {size}, as none were held out."
    if run is None:
        return [free_run_section(title, lead, {}, [], blocks)]
    lead += " The model is started where the measurements start and then left alone."
    drawn = {state: partial(figures.simulated, run, state) for state in run.states}
    return [free_run_section(title, lead, drawn, [run.holds], [*blocks, *map(Words, _failures(run))])]


def _failures(run: FreeRun) -> list[str]:
    """Return the runs that blew up, and when, as a sentence."""
    data, unit = run.data, run.data.unit("t") or ""
    failed = [
        f"{percent_text(float(share))} of the draws{f' in run {name}' if data.n_run > 1 else ''} after "
        f"{number(float(at) - float(data.time[data.run == k][0]))} {unit}".strip()
        for k, (name, share, at) in enumerate(zip(data.run_names, run.failed, run.failed_at, strict=True))
        if share > 0
    ]
    return [f"The free run blows up: {listed(failed)}."] if failed else []


def _varied(holds: Iterable[str]) -> str:
    """Return the quantities that vary between the draws, as a clause."""
    held = {band_sources(each) for each in holds} - {""}
    return f", which vary in {held.pop()}" if held else ""

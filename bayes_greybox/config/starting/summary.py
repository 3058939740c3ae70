"""Summary of a first configuration for its user: roles of columns, findings about the table, and next steps."""

from pathlib import Path

from bayes_greybox.data.reading.table import Layout
from bayes_greybox.discovery.decision.criteria import FEWEST_ROWS

from .plan import Plan


def summary_of(plan: Plan, layout: Layout, data: Path, config: Path) -> tuple[str, ...]:
    """Return the lines of the summary."""
    columns = _columns(plan)
    width = max(len(name) for name, _ in columns)
    findings = _findings(plan, layout)
    marked = "" if plan.measured else ", once its # are gone"
    without = ", once [dictionary] is taken out" if plan.measured else ""
    open_ = " and ".join(f'{name} = "..."' for name in plan.equations)
    return (
        f"What the columns of {data.name} were taken for:",
        *(f"  {name:<{width}}  {role}" for name, role in columns),
        *([f"Found: {'; '.join(findings)}."] if findings else []),
        *(_samples(plan) if plan.sampled else []),
        f"The configuration is {config}: check what was guessed, and write",
        f"  {open_}  in its section [simulation]. Then",
        f"  bayes-greybox discover {config}  finds what the simulation is missing{without};",
        f"  bayes-greybox fit {config}  learns the terms of [dictionary]{marked}.",
    )


def _columns(plan: Plan) -> list[tuple[str, str]]:
    guess = plan.guess
    roles: list[tuple[str, str]] = []
    if guess.time is not None:
        roles.append((guess.time, "time, dates that become seconds" if guess.dated else "time" + _in(plan, guess.time)))
    if guess.run is not None:
        roles.append((guess.run, "tells the runs apart"))
    for state in guess.states:
        what = "state" + _in(plan, state)
        if state in plan.second:
            what += f", a position: its rate {plan.second[state]} is a state too"
        elif state in plan.chained:
            what += f", whose rate is {plan.chained[state]}"
        roles.append((state, what))
    roles += [(rate, f"measured rate of {state}") for state, rate in plan.measured.items()]
    roles += [(name, "input" + _in(plan, name)) for name in guess.inputs]
    return [*roles, *((name, f"left out: it {why}") for name, why in guess.left_out.items())]


def _in(plan: Plan, column: str) -> str:
    return f" in {plan.unit(column)}" if plan.unit(column) else ""


def _findings(plan: Plan, layout: Layout) -> list[str]:
    """List findings about the table that a file states otherwise."""
    findings = []
    if isinstance(layout.skiprows, int) and layout.skiprows:
        lines = "1 line" if layout.skiprows == 1 else f"{layout.skiprows} lines"
        findings.append(f"{lines} above the names")
    if layout.columns is not None:
        findings.append(f"no names of columns, which are called {', '.join(layout.columns)}: give yours")
    if layout.decimal == ",":
        findings.append("decimal commas")
    if layout.encoding not in ("utf-8-sig", "utf-8"):
        findings.append(f"text in {layout.encoding}")
    if any("read as units" in remark for remark in plan.table.remarks):
        findings.append("a row of units")
    if plan.guess.shuffled:
        findings.append("time that goes back every few rows, which have to be sorted by it first")
    elif plan.guess.restart:
        clock = ", or a clock was set back" if plan.guess.set_back else ""
        findings.append(f"time that goes back, where a new run begins{clock}")
    if plan.guess.missing:
        rows = "1 row" if plan.guess.missing == 1 else f"{plan.guess.missing} rows"
        findings.append(f"{rows} with empty cells, which are left out")
    if (rows := sum(plan.guess.lengths.values())) < FEWEST_ROWS:
        findings.append(f"only {rows} rows, while discover needs {FEWEST_ROWS}")
    return findings


def _samples(plan: Plan) -> list[str]:
    one = ": discover looks at one equation at a time" if len(plan.equations) > 1 else ""
    if plan.followed and plan.guess.even:
        return ["Rows are samples, and no rate is computed."]
    why = "There are too few rows for a filter" if plan.guess.even else "Times are not even"
    return [f"{why}, so rows are samples, and no rate is computed{one}."]

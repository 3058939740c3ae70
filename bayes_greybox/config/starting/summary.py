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
    guess, rows = plan.guess, sum(plan.guess.lengths.values())
    titles = layout.skiprows if isinstance(layout.skiprows, int) else 0
    clock = ", or a clock was set back" if guess.set_back else ""
    findings = {
        f"{titles} line{'s' * (titles > 1)} above the names": titles,
        f"no names of columns, which are called {', '.join(layout.columns or ())}: give yours": layout.columns,
        "decimal commas": layout.decimal == ",",
        f"text in {layout.encoding}": layout.encoding not in ("utf-8-sig", "utf-8"),
        "a row of units": any("read as units" in remark for remark in plan.table.remarks),
        "time that goes back every few rows, which have to be sorted by it first": guess.shuffled,
        f"time that goes back, where a new run begins{clock}": guess.restart and not guess.shuffled,
        f"{guess.missing} row{'s' * (guess.missing > 1)} with empty cells, which are left out": guess.missing,
        f"only {rows} rows, while discover needs {FEWEST_ROWS}": rows < FEWEST_ROWS,
    }
    return [text for text, found in findings.items() if found]


def _samples(plan: Plan) -> list[str]:
    one = ": discover looks at one equation at a time" if len(plan.equations) > 1 else ""
    if plan.followed and plan.guess.even:
        return ["Rows are samples, and no rate is computed."]
    why = "There are too few rows for a filter" if plan.guess.even else "Times are not even"
    return [f"{why}, so rows are samples, and no rate is computed{one}."]

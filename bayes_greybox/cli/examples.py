"""Examples that the help of each command ends with, and the command that comes next."""

_EXAMPLES = {
    "init": ("init run.csv", "discover run.toml"),
    "fit": ("fit configs/first.toml", "report runs/first"),
    "discover": ("discover configs/discover_spring.toml", "next runs/discover_spring/study.nc"),
    "next": ("next runs/discover_spring/study.nc --signal sine", "init new_run.csv"),
    "export": ("export runs/discover_spring/study.nc amended.c", "report runs/discover_spring"),
    "compare": ("compare configs/compare_priors.toml", "report runs/compare_priors"),
    "report": ("report runs/discover_spring", "export runs/discover_spring/study.nc amended.c"),
    "schema": ("schema > bayes-greybox.schema.json", "init run.csv"),
    "datasets": ("datasets", "init run.csv"),
}
"""Arguments of an example of each command, and of the command that comes next."""


def ending(command: str) -> str:
    """Return the last lines of a command's help, a paragraph each."""
    example, after = (f"bayes-greybox {words}" for words in _EXAMPLES[command])
    return f"Example: {example}\n\nThen: {after}"

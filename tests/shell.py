"""The command line as a user meets it."""

from bayes_greybox import cli


def refuse(capsys, *words: str, main=cli.main) -> str:
    """Run, and return the one sentence of the refusal."""
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    # On a busy machine it may first be said what is being done.
    told = "".join(line for line in err.splitlines(keepends=True) if not line.endswith(" s so far\n"))
    assert told.startswith("Error: ") and told.count("\n") == 1 and "Traceback" not in told
    return told.removeprefix("Error: ").strip()

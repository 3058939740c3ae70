"""The command line as a user meets it."""

from bayes_greybox import cli


def refuse(capsys, *words: str) -> str:
    """Run, and return the one sentence of the refusal."""
    assert cli.main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("Error: ") and err.count("\n") == 1 and "Traceback" not in err
    return err.removeprefix("Error: ").strip()

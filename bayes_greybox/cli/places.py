"""Where a command's results go."""

from pathlib import Path

from bayes_greybox.config import Config
from bayes_greybox.report.folders.holding import free_folder, require_own


def place_of(settings: Config, command: str, output: Path | None) -> Path:
    """The folder for the results of a command, which overwrites no results but its own.

    Args:
        settings: The configuration, whose folder is that of the first command that was run with it; another one's is
            beside it, FOLDER-COMMAND.
        command: "fit", "discover" or "compare".
        output: The folder that was asked for.

    Raises:
        InputError: The folder that was asked for holds another command's results.
    """
    if output is None:
        return free_folder(settings.folder, command)
    require_own(output, command)
    return output

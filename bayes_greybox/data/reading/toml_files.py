"""TOML files of the user."""

import os
import tomllib
from pathlib import Path
from typing import Any

from bayes_greybox.running.errors import InputError


def read_toml(path: str | os.PathLike[str], what: str) -> tuple[dict[str, Any], str]:
    """Read a TOML file and return its content and its text; messages call it a `what` file."""
    try:
        text = Path(path).read_bytes().decode("utf-8-sig")
        return tomllib.loads(text), text
    except FileNotFoundError:
        raise InputError(f'There is no {what} file "{path}"; check the path.') from None
    except OSError as error:
        raise InputError(f'"{path}" cannot be read ({error.strerror}); give a TOML file.') from None
    except UnicodeDecodeError as error:
        raise InputError(f'"{path}" is not UTF-8 text (at byte {error.start}); give a TOML file.') from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f'"{path}" is not valid TOML: {error}; correct that line.') from None

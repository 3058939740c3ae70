"""Files of benchmarks: whole or absent, and plain values in them."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bayes_greybox.data.errors import InputError


def write_whole(file: Path, text: str) -> None:
    """Write all of a file or nothing of it."""
    part = file.with_name(f".{file.name}.part")
    part.write_text(text, encoding="utf-8", newline="")
    os.replace(part, file)


def unwritable(folder: Path, error: OSError) -> InputError:
    """What to say of a folder that cannot be written to."""
    return InputError(f'Cannot write to the folder "{folder}" ({error.strerror or error}); choose another one.')


def plain_values(value: Any) -> Any:
    """Values that JSON can hold; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(item) for item in value]
    value = value.item() if isinstance(value, np.generic) else value
    return None if isinstance(value, float) and not np.isfinite(value) else value

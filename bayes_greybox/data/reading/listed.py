"""Sources one by one: lists of them, and patterns that stand for files."""

import glob
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bayes_greybox.running.errors import InputError

from .sources import require_path


def listed(source: Any) -> list[tuple[str | None, Any]]:
    """Return the sources, each with the name of its run: that of its file, or None if there is only one source."""
    if isinstance(source, str | Path):
        if not _is_pattern(source):
            return [(None, source)]
        source = _matching(source)
    elif not isinstance(source, list | tuple):
        return [(None, source)]
    elif any(isinstance(each, str | Path) and _is_pattern(each) for each in source):
        source = _opened(source)
    if not source:
        raise InputError("There is nothing to read: the list of sources is empty.")
    stems = [Path(each).stem if isinstance(each, str | Path) else str(i) for i, each in enumerate(source)]
    if len(set(stems)) < len(stems):
        stems = [str(each) if isinstance(each, str | Path) else str(i) for i, each in enumerate(source)]
    return list(zip(stems, source, strict=True))


def _is_pattern(source: str | Path) -> bool:
    """Return True if a path stands for all files that it matches."""
    require_path(source)
    return glob.has_magic(str(source)) and not Path(source).exists()


def _matching(pattern: str | Path) -> list[Any]:
    """Return the files of a pattern, run 2 before run 10."""
    files = sorted(glob.glob(str(pattern), recursive=True), key=_in_order)
    if not files:
        raise InputError(f'No file matches "{pattern}"; check the folder and the pattern.')
    return files


def _opened(sources: Sequence[Any]) -> list[Any]:
    """Replace patterns by their files; a file that two of them match, or that is named besides, is read once."""
    named = {Path(each) for each in sources if isinstance(each, str | Path) and not _is_pattern(each)}
    opened: list[Any] = []
    for each in sources:
        if isinstance(each, str | Path) and _is_pattern(each):
            files = [path for path in _matching(each) if Path(path) not in named]
            named |= {Path(path) for path in files}
            opened += files
        else:
            opened.append(each)
    return opened


def _in_order(name: str) -> list[tuple[int, str]]:
    """Return a key by which run 2 stands before run 10."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]

"""LabVIEW measurement files (.lvm): text with a header above each segment of samples."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pandas as pd

from bayes_greybox.data.reading.table import Layout, Table
from bayes_greybox.running.errors import InputError

END_OF_HEADER = "***End_of_Header***"
STAMPS = "X_Value"


@dataclass
class _Segment:
    """One segment: its header by key, the names of its columns, its rows as cells."""

    header: dict[str, list[str]]
    names: list[str] = field(default_factory=list)
    rows: list[list[str]] = field(default_factory=list)


def read_lvm(path: Path, layout: Layout) -> Table:
    """Read a LabVIEW measurement file; `layout` gives its encoding, while separator and decimal mark stand in the file.

    Several segments are several runs, told apart by the column `segment`. Without a column of stamps these are
    X0 + i Delta_X of the segment's header.
    """
    lines = path.read_text(encoding=layout.encoding).splitlines()
    if not lines or not lines[0].startswith("LabVIEW Measurement"):
        raise InputError(f'"{path}" is no LabVIEW measurement file; rename it to .txt if it is another kind of text.')
    written = {
        key: value.strip("\t ") for key, value in re.findall(r"(?m)^(\w+)[\t,]([^\t\r\n]*)", "\n".join(lines[:40]))
    }
    separator = {"Tab": "\t", "Comma": ","}.get(written.get("Separator", "Tab").rstrip(","))
    if separator is None:
        raise InputError(f'"{path}" has a separator that is neither Tab nor Comma; export the file with one of them.')
    decimal = written.get("Decimal_Separator", ".")[:1] or "."
    segments = [segment for segment in _segments(lines, separator) if segment.rows]
    if not segments:
        raise InputError(f'"{path}" has no samples below its header; export the file again.')
    frames = [_frame(segment, decimal, path) for segment in segments]
    for number, (segment, frame) in enumerate(zip(segments, frames, strict=True)):
        _require_one_time(segment, frame, decimal, path)
        if len(frames) > 1:
            frame.insert(0, "segment", number)
    # Units stand beside the columns of samples, which follow the stamps.
    first = segments[0]
    labels = first.header.get("Y_Unit_Label", [])
    stated = zip(first.names[1:], labels, strict=False)
    units = {name: unit for name, unit in stated if unit.strip() and not _is_stamps(name) and name != "Comment"}
    if (first.header.get("X_Dimension") or ["Time"])[0].strip() == "Time":
        units[STAMPS] = "s"
    table = Table(pd.concat(frames, ignore_index=True), f'"{path}"', units)
    remarks = (f'the {len(frames)} segments of "{path}" are runs',)
    return replace(table, remarks=remarks, run="segment") if len(frames) > 1 else table


def _segments(lines: list[str], separator: str) -> Iterator[_Segment]:
    header: dict[str, list[str]] = {}
    segment: _Segment | None = None
    for line in lines:
        cells = line.rstrip("\r\n").split(separator)
        if cells[0].strip() == END_OF_HEADER:
            # The header of the file ends in the same way as that of a segment.
            segment = _Segment(header)
        elif cells[0].strip() == STAMPS and segment is not None:
            names = [cell.strip() for cell in cells]
            # Later names that are the same are numbered.
            segment.names = [f"{n}.{names[:i].count(n)}" if n in names[:i] else n for i, n in enumerate(names)]
        elif segment is not None and segment.names and any(cell.strip() for cell in cells):
            # Samples begin with a number, or with nothing and then something.
            if not cells[0].strip() or cells[0].strip()[0] in "+-.0123456789":
                segment.rows.append(cells)
                continue
            yield segment
            header, segment = {cells[0].strip(): cells[1:]}, None
        elif segment is None or not segment.names:
            header = {**header, cells[0].strip(): cells[1:]}
    if segment is not None:
        yield segment


def _frame(segment: _Segment, decimal: str, path: Path) -> pd.DataFrame:
    """Return one segment as numbers, its stamps filled from its header where the file has none."""
    kept = [i for i, name in enumerate(segment.names) if name and name != "Comment"]
    try:
        rows = [[_number(row[i] if i < len(row) else "", decimal) for i in kept] for row in segment.rows]
    except ValueError as error:
        raise InputError(f'"{path}" has a cell that is no number ({error}); correct it.') from None
    frame = pd.DataFrame(rows, columns=[segment.names[i] for i in kept], dtype=float)
    if np.isnan(frame[STAMPS].to_numpy()).all():
        start, step = (_number((segment.header.get(key) or ["0"])[0], decimal) for key in ("X0", "Delta_X"))
        if not step > 0.0:
            raise InputError(f'"{path}" has neither stamps nor their spacing Delta_X; export it with a column of time.')
        frame[STAMPS] = start + step * np.arange(len(frame))
    return frame


def _require_one_time(segment: _Segment, frame: pd.DataFrame, decimal: str, path: Path) -> None:
    """Refuse channels that have stamps of their own, of another start or step: rows have one time."""
    columns = [name for name in frame if _is_stamps(str(name))]
    slack = 1e-3 * float(np.median(np.abs(np.diff(frame[STAMPS])))) if len(frame) > 1 else 0.0
    for name in columns[1:]:
        stamps = frame[name].to_numpy()
        if np.isnan(stamps).all():
            at = segment.names.index(str(name))
            # The headers of the channel behind a column of stamps.
            cells = (segment.header.get(key) or ["0"] for key in ("X0", "Delta_X"))
            start, step = (_number(row[at] if at < len(row) else row[0], decimal) for row in cells)
            stamps = start + step * np.arange(len(frame))
        if np.any(np.abs(stamps - frame[STAMPS].to_numpy()) > slack):
            channel = segment.names[segment.names.index(str(name)) + 1 :][:1]
            raise InputError(
                f'"{path}" has times of its own for the channel {"".join(channel)!r}, and rows have one time: export '
                "channels of one sampling into one file, or each into its own."
            )


def _is_stamps(name: str) -> bool:
    return name == STAMPS or name.startswith(f"{STAMPS}.")


def _number(cell: str, decimal: str) -> float:
    cell = cell.strip()
    return float(cell.replace(decimal, ".")) if cell else float("nan")

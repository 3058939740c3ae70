"""Remedies in the words of a command's user: an error names arguments of Python, a file has keys."""

import ast
import json
import re
from collections.abc import Callable

_VALUE = r'"([^"]*)"'

_QUOTATION = r"""(?<!\w)(?:"[^"]*"|'(?:[^'\\]|\\.)*')(?!\w)"""
"""A quotation: a name, or the value of an argument that begins before it; an apostrophe in a word quotes nothing."""

_TABLE = r"""\{(?=['"])(?:'(?:[^'\\]|\\.)*'|"(?:[^"\\]|\\.)*"|[^{}'"])*\}"""
"""A mapping of names to columns as Python shows it."""

_IN_FILES: tuple[tuple[str, Callable[[re.Match[str]], str]], ...] = (
    (r"GreyBox\(dictionary=\{'(\w+)': (\[.*?\])\}", lambda m: f"[dictionary] {m[1]} = {m[2]}".replace("'", '"')),
    (r"GreyBox\(dictionary=\.\.\.\)", lambda m: "[dictionary]"),
    (r"bg\.(Derivative|Trajectory|Weak)Rows\(", lambda m: f'[rows] kind = "{m[1].lower()}"'),
    (r"data\.differentiate\(", lambda m: '[data.differentiate] method = "savgol"'),
    (r"data\.resample\(([^()]+)\)", lambda m: f"[data] resample = {m[1]}"),
    (r"\b(sep|decimal|thousands|encoding|missing|constant|restart)=" + _VALUE, lambda m: f'[data] {m[1]} = "{m[2]}"'),
    (r"\bskiprows=(\d+)", lambda m: f"[data] skiprows = {m[1]}"),
    (r"\bskiprows=(?!\d)", lambda m: "[data] skiprows = lines above the names"),
    (r"\bdayfirst=(True|False)", lambda m: f"[data] dayfirst = {m[1].lower()}"),
    (r"\bcolumns=\[", lambda m: '[data] columns = ["name", ...]'),
    (r"\b(derivatives|rates)=(?:\{\"(\w+)\": \"(\w+)\"\}|\.\.\.)",
     lambda m: f'[data] {m[1]} = {{ {m[2] or "state"} = "{m[3] or "column of its rate"}" }}'),
    (rf"(?<=: )(states|inputs|outputs)=({_TABLE})", lambda m: f"[data] {m[1]} = {_inline(m[2])}"),
    (r"\boutputs=\.\.\.", lambda m: "[data] outputs"),
    (r"\bdt=", lambda m: "[data] dt = distance of rows"),
    (r"roles=\{'(\w+)'", lambda m: f'[study.roles] {m[1]} = "column"'),
    (r"\b(settle|free_runs)=(True|False)", lambda m: f"[study] {m[1]} = {m[2].lower()}"),
    (r"bg\.FMU\(\.\.\., (\w+)=", lambda m: f"[simulation] {m[1]}"),
    (r"GreyBox\(noise=", lambda m: "[noise]"),
    (r"\bdiscrepancy=None", lambda m: "[discrepancy] enabled = false"),
    (r"bg\.(SpikeAndSlab|Laplace|RegularisedHorseshoe|Normal)\(", lambda m: f'[prior] kind = "{_snake(m[1])}"'),
    (r"bg\.find_missing_effects\(", lambda m: "bayes-greybox discover"),
)  # fmt: skip
"""Arguments in Python, and the keys of a file."""

_INIT_OPTIONS: tuple[tuple[str, str], ...] = (
    (r"dayfirst=True or dayfirst=False", "--dayfirst or --monthfirst"),
    (r"\b(sep|decimal|thousands|encoding|sheet)=" + _VALUE, r'--\1 "\2"'),
    (r"\bskiprows=(\d+)", r"--skiprows \1"),
    (r"\bskiprows=(?!\d)", "--skiprows "),
)
"""Arguments in Python, and the options of the command init."""


def as_typed(command: str, message: str) -> str:
    """Rewrite an error, whose remedies are arguments of Python's functions, to fit the command that was typed.

    For a command that reads a configuration the keys of the file are added at its end; for init its options stand in
    the place of arguments. Quotations, such as the name of a file or a column, stay as they are.
    """
    if command == "init":
        for python, option in _INIT_OPTIONS:
            # From the end on, so that places stay.
            for match in reversed(_remedies(python, message)):
                message = message[: match.start()] + match.expand(option) + message[match.end() :]
        return message
    if command not in ("fit", "discover", "compare", "next"):
        return message
    places = [(match.start(), key(match)) for python, key in _IN_FILES for match in _remedies(python, message)]
    keys = [key for key in dict.fromkeys(key for _, key in sorted(places)) if key not in message]
    return f"{message} In a file: {'; or '.join(keys)}." if keys else message


def _remedies(python: str, message: str) -> list[re.Match[str]]:
    """Find where a message has an argument, and not a name that reads like one."""
    quotations = [match.span() for match in re.finditer(_QUOTATION, message)]
    return [match for match in re.finditer(python, message) if not any(a < match.start() < b for a, b in quotations)]


def _inline(table: str) -> str:
    """Write Python's mapping as an inline table of TOML; keys have no quotes where they need none."""
    keys = {
        key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key, ensure_ascii=False): column
        for key, column in ast.literal_eval(table).items()
    }
    pairs = ", ".join(f"{key} = {json.dumps(column, ensure_ascii=False)}" for key, column in keys.items())
    return f"{{ {pairs} }}"


def _snake(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower()

"""Inputs as hypothesis draws them: formulas, tables and TOML that were written by nobody who means well."""

import json
import random
import tomllib
from pathlib import Path

from hypothesis import strategies as st
from probes import NAMES

ROOT = Path(__file__).parents[2]

ATOMS = st.sampled_from(
    (
        *NAMES,
        "pi",
        "0",
        "1",
        "2",
        "100",
        "101",
        "1e308",
        "1e-320",
        "0.1",
        "9**9",
        "1/3",
        "ｙ",
        "y²",
        "1j",
        "__import__",
        "open('pwned')",
    )
)
FUNCTIONS = ("sin", "log", "sqrt", "abs", "sign", "min", "max", "exp", "tan", "heaviside", "asin", "eval", "open")

FORMULAS = st.recursive(
    ATOMS,
    lambda part: st.one_of(
        st.tuples(part, st.sampled_from(("+", "-", "*", "/", "**", "//", "@", "<", ",")), part).map("".join),
        st.tuples(st.sampled_from(FUNCTIONS), part).map(lambda of: f"{of[0]}({of[1]})"),
        st.tuples(st.sampled_from(("min", "max")), part, part).map(lambda of: f"{of[0]}({of[1]}, {of[2]})"),
        part.map(lambda inside: f"({inside})"),
        part.map(lambda inside: f"-{inside}"),
        st.tuples(part, st.sampled_from((".real", "[0]", "**100", "**-0.5", "()", "**y"))).map("".join),
    ),
    max_leaves=25,
)
"""What looks like a formula, most of it one."""

WORDS = st.one_of(st.text(max_size=40), st.text("y+-*/()^.,0123456789eE_'\"\\\0[]{}:=@!#\n ", max_size=60))
"""What does not."""

VALUES = st.sampled_from(
    [
        None, True, -1, 0, 10**30, 2**63, 1e308, float("nan"), float("inf"), "", "x", "../../x", "\0", "y" * 3000, [],
        {}, [[]], [None], {"": 1}, {"a": {"b": {}}}, "open('pwned', 'w')", "1e999999999", "9**9**9", "\ud800",
        "$(touch pwned)", "{{ 7 * 7 }}", "%s%n", ["y", "y"], [1, "y"],
    ]
)  # fmt: skip
"""What stands where something else should."""


def places(value: object, at: tuple = ()) -> list[tuple]:
    """Every place in nested tables and lists."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [at, *(place for key, each in inside for place in places(each, (*at, key)))]


def changed(content: dict, seed: int, bad: object) -> dict:
    """A copy of nested tables with something else, nothing, or another key at one or two places."""
    rng, copy = random.Random(seed), json.loads(json.dumps(content, default=str))
    for _ in range(rng.choice((1, 1, 2))):
        *way, last = rng.choice(places(copy)[1:] or [("x",)])
        inside = copy
        for key in way:
            inside = inside[key]
        what = rng.randrange(4)
        if what == 0:
            del inside[last]
        elif what == 1 and isinstance(inside, dict):
            inside[rng.choice(("zz", "", "__class__", "path", "kind"))] = inside.pop(last)
        else:
            inside[last] = bad
    return copy


def toml(value: object) -> str:
    """A value as TOML writes it in one line; what TOML lacks becomes text."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(str(key))} = {toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, int | float):
        return str(value)
    return json.dumps(str(value), ensure_ascii=False)


def file_of(content: dict) -> bytes:
    """Nested tables as a TOML file."""
    return "\n".join(f"{json.dumps(str(k))} = {toml(v)}" for k, v in content.items()).encode("utf-8", "surrogatepass")


CONFIGS = [tomllib.loads(file.read_text(encoding="utf-8")) for file in sorted((ROOT / "configs").glob("*.toml"))]
CATALOGUES = [
    tomllib.loads(file.read_text(encoding="utf-8"))
    for file in sorted((ROOT / "bayes_greybox/physics/catalogue").glob("*.toml"))
]


def mutated(shipped: list[dict]) -> st.SearchStrategy[bytes]:
    """Files of the package with something changed in them."""
    return st.builds(
        lambda content, seed, bad: file_of(changed(content, seed, bad)),
        st.sampled_from(shipped),
        st.integers(0, 2**32),
        VALUES,
    )


def broken(shipped: list[Path]) -> st.SearchStrategy[bytes]:
    """Files of the package with bytes changed, left out or put in."""
    return st.builds(
        lambda file, at, length, put: _spliced(file.read_bytes(), at, length, put),
        st.sampled_from(shipped),
        st.floats(0, 1),
        st.integers(0, 30),
        st.binary(max_size=12),
    )


def _spliced(text: bytes, at: float, length: int, put: bytes) -> bytes:
    start = int(at * len(text))
    return text[:start] + put + text[start + length :]

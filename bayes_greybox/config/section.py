"""What every table of a configuration file has in common, and the sentence for what is wrong in one."""

import difflib
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import PydanticCustomError


class Section(BaseModel):
    """A table of the file: no keys but its own, no silent conversion of values."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _check_keys(cls, given: Any) -> Any:
        for key in given if isinstance(given, Mapping) else ():
            if key not in cls.model_fields:
                raise wrong(f"unknown key {key!r}; {suggestion(str(key), list(cls.model_fields))}")
        return given

    def given(self, *leave_out: str) -> dict[str, Any]:
        """The keys that the file has; for the others the package's own defaults hold."""
        return self.model_dump(exclude_unset=True, exclude=set(leave_out))


def wrong(text: str) -> PydanticCustomError:
    """The error of a validator, with its sentence."""
    return PydanticCustomError("config", "{text}", {"text": text})


def suggestion(word: str, known: list[str]) -> str:
    """The nearest known word, or all of them."""
    near = difflib.get_close_matches(word.lower(), known, n=1, cutoff=0.6)
    return f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}."


def sentence(error: ValidationError) -> str:
    """One sentence for the first thing that is wrong, starting with its place: [section] key."""
    first = error.errors()[0]
    # Names in angle brackets tell the kinds of a section apart and are not in the file.
    place = [part for part in first["loc"] if not str(part).startswith("<")]
    message, given = first["msg"], first["input"]
    if first["type"] == "config" and isinstance(given, Mapping | Section):
        return _finished(f"{_section(place)}{message}")
    # The value of a key: its place is the table around it.
    key = str(place.pop())
    if key.isdigit() and place:
        key = f"{place.pop()}[{key}]"
    if first["type"] == "missing":
        return f"{_section(place)}needs the key {key!r}."
    if first["type"] == "literal_error":
        expected = first.get("ctx", {}).get("expected", "").replace(" or ", ",")
        known = [word.strip(" '") for word in expected.split(",") if word.strip()]
        message = f"is not available; {suggestion(str(given), known)}"
    elif first["type"] != "config":
        wanted = _WANTED.get(first["type"]) or message.removeprefix("Input should be ")
        message = f"cannot be used; it must be {wanted}"
    return _finished(f"{_section(place)}{key} = {_shown(given)} {message}")


# The library's own words for these are for programmers.
_WANTED = {
    "int_type": "a whole number",
    "float_type": "a number",
    "string_type": "text in quotes",
    "bool_type": "true or false",
    "list_type": "a list",
    "model_type": "a table of keys and values",
    "dict_type": "a table of keys and values",
}


def _section(place: list[Any]) -> str:
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place).removeprefix(".")
    return f"[{text}] " if text else ""


def _finished(text: str) -> str:
    return text if text.endswith(("?", ".")) else f"{text}."


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."

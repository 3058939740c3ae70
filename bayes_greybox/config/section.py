"""The base of all tables of a configuration file, and the sentences for errors in one."""

import difflib
from collections.abc import Callable, Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError, model_validator
from pydantic_core import ErrorDetails, InitErrorDetails, PydanticCustomError


class Section(BaseModel):
    """A table of the file: no keys but its own, no silent conversion of values."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    @model_validator(mode="wrap")
    @classmethod
    def _check_keys(cls, given: Any, handler: Callable[[Any], Any]) -> Any:
        """Report unknown keys beside all other errors in the table, so that all are shown at once."""
        known = list(cls.model_fields)
        unknown = [key for key in given if key not in known] if isinstance(given, Mapping) else []
        if not unknown:
            return handler(given)
        texts = [f"unknown key {key!r}; {suggestion(str(key), known)}" for key in unknown]
        errors = [InitErrorDetails(type=wrong(text), input=given) for text in texts]
        try:
            handler({key: value for key, value in given.items() if key in known})
        except ValidationError as error:
            errors += [_again(each) for each in error.errors()]
        raise ValidationError.from_exception_data(cls.__name__, errors)

    def given(self, *leave_out: str) -> dict[str, Any]:
        """Return the keys that the file has; for the others the package's own defaults hold."""
        return self.model_dump(exclude_unset=True, exclude=set(leave_out))


def wrong(text: str) -> PydanticCustomError:
    """Return the error of a validator, with its sentence."""
    return PydanticCustomError("config", "{text}", {"text": text})


def suggestion(word: str, known: list[str]) -> str:
    """Suggest the nearest known word, or list all of them."""
    near = difflib.get_close_matches(word.lower(), known, n=1, cutoff=0.6)
    return f"did you mean {near[0]!r}?" if near else f"known: {', '.join(known)}."


def sentences(error: ValidationError) -> str:
    """Write a sentence for each error, starting with its place: [section] key."""
    return " Also: ".join(dict.fromkeys(_sentence(each) for each in error.errors()))


def _again(error: ErrorDetails) -> InitErrorDetails:
    """Prepare an error to be raised again, with others."""
    kind: Any = error["type"]
    if kind == "config":
        kind = wrong(str(error.get("ctx", {}).get("text", error["msg"])))
    return InitErrorDetails(type=kind, loc=error["loc"], input=error["input"], ctx=error.get("ctx", {}))


def _sentence(first: ErrorDetails) -> str:
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
        choices = [word.strip(" '") for word in expected.split(",") if word.strip()]
        message = f"is not available; {suggestion(str(given), choices)}"
    elif first["type"] != "config":
        wanted = _EXPECTED.get(first["type"]) or message.removeprefix("Input should be ")
        message = f"cannot be used; it must be {wanted}"
    shown = repr(given)
    shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
    return _finished(f"{_section(place)}{key} = {shown} {message}")


# The library's own words for these are for programmers.
_EXPECTED = {
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

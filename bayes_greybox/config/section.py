"""The base of all tables of a configuration file, tables that are classes of the package, and sentences for errors."""

import dataclasses
import difflib
from collections.abc import Callable, Mapping
from functools import cache
from types import UnionType
from typing import Annotated, Any, ClassVar, Union, get_args, get_origin, get_type_hints

from pydantic import BaseModel, BeforeValidator, ConfigDict, TypeAdapter, ValidationError, create_model, model_validator
from pydantic_core import CoreSchema, ErrorDetails, InitErrorDetails, PydanticCustomError, core_schema

from bayes_greybox.running.limits import OneOf, Rule


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
    kind: Any = wrong(error["msg"]) if error["type"] == "config" else error["type"]
    return InitErrorDetails(type=kind, loc=error["loc"], input=error["input"], ctx=error.get("ctx", {}))


def _sentence(first: ErrorDetails) -> str:
    # Names in angle brackets tell the kinds of a section apart and are not in the file.
    place = [part for part in first["loc"] if not str(part).startswith("<")]
    kind, message, given = first["type"], first["msg"], first["input"]
    if kind == "value_error":
        # An InputError of the package.
        kind, message = "config", message.removeprefix("Value error, ")
    if kind == "config" and isinstance(given, Mapping | Section):
        return _finished(f"{_section(place)}{message}")
    # The value of a key: its place is the table around it.
    key = str(place.pop())
    if key.isdigit() and place:
        key = f"{place.pop()}[{key}]"
    if kind == "missing":
        return f"{_section(place)}needs the key {key!r}."
    if kind == "literal_error":
        expected = first.get("ctx", {}).get("expected", "").replace(" or ", ",")
        choices = [word.strip(" '") for word in expected.split(",") if word.strip()]
        message = f"is not available; {suggestion(str(given), choices)}"
    elif kind != "config":
        wanted = _EXPECTED.get(kind) or message.removeprefix("Input should be ")
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


class Derived(Section):
    """The fields of a class of the package, `made`; keys that the file leaves out have the defaults of the class."""

    made: ClassVar[Callable[..., Any]]

    def build(self) -> Any:
        """Return the object of the package."""
        fields = self.given("kind", "enabled")
        return type(self).made(**{key: tuple(v) if isinstance(v, list) else v for key, v in fields.items()})


class Kind(Derived):
    """The fields of one of several classes, which the key `kind` chooses."""

    kind: str


class Switch(Derived):
    """The fields of a class, and a switch for the whole part."""

    enabled: bool = True

    def build(self) -> Any:
        """Return the object of the package, or None where it is switched off."""
        return super().build() if self.enabled else None


@cache
def section_of(part: type, base: type[Derived] = Derived) -> type[Derived]:
    """Return the section with the keys of a base and the fields of a dataclass, whose types state its limits."""
    hints = get_type_hints(part, include_extras=True)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(part):
        required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if field.init:
            fields[field.name] = (_in_toml(hints[field.name]), ... if required else None)
    section = create_model(part.__name__, __base__=base, __doc__=f"The fields of `{part.__name__}`.", **fields)
    section.made = part
    return section


@dataclasses.dataclass(frozen=True)
class Table:
    """Annotation of a table whose section is imported when it is read, because it needs the room of models.

    `section` is chosen by the table's content; `shown` is the JSON schema of all of them, None if there is but one.
    """

    section: Callable[[Any], type[Section]]
    shown: Callable[[], dict[str, Any]] | None = None

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self._checked)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        return self.section(None).model_json_schema() if self.shown is None else self.shown()

    def _checked(self, given: Any) -> Any:
        return given if isinstance(given, Section) else self.section(given).model_validate(given)


def table_of_kinds(kinds: Callable[[], Mapping[str, type]], example: str) -> Table:
    """Annotate a table whose key `kind`, such as the example, names the class of a registry for its fields."""

    def section(given: Any) -> type[Section]:
        if not isinstance(given, Mapping):
            raise wrong(f'should be a table with the key kind, such as {{ kind = "{example}" }}')
        known = kinds()
        if "kind" not in given:
            raise wrong(f"needs the key 'kind'; known: {', '.join(known)}")
        if not isinstance(given["kind"], str) or given["kind"] not in known:
            raise wrong(f"kind = {given['kind']!r} is not available; {suggestion(str(given['kind']), list(known))}")
        return section_of(known[given["kind"]], Kind)

    def shown() -> dict[str, Any]:
        each = {kind: section_of(made, Kind).model_json_schema() for kind, made in kinds().items()}
        for kind, fields in each.items():
            fields["properties"]["kind"] = {"const": kind}
        return {"oneOf": list(each.values())}

    return Table(section, shown)


@dataclasses.dataclass(frozen=True)
class AlsoAs:
    """Annotation of a value that a file may write in other ways (`only` in these), which a validator turns into one."""

    types: tuple[Any, ...]
    only: bool = False

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        usual = [] if self.only else [handler(schema)]
        return {"anyOf": [*(handler(TypeAdapter(each).core_schema) for each in self.types), *usual]}


def _in_toml(hint: Any) -> Any:
    """Return a type of the package as a file can state it: lists for tuples, limits as checks with their sentences."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is Annotated:
        checks = [_check(limit) for limit in arguments[1:]]
        return Annotated[(_in_toml(arguments[0]), *checks)]  # pyright: ignore[reportInvalidTypeArguments]
    if origin is tuple:
        return list[_in_toml(arguments[0])]
    if origin in (Union, UnionType):
        return Union[tuple(map(_in_toml, arguments))]  # noqa: UP007 - of a number that is not known here
    return hint


def _check(limit: Any) -> Any:
    """Return a limit in the form that Pydantic checks."""
    if isinstance(limit, OneOf):
        return _Choice(limit)
    if isinstance(limit, Rule):

        def kept(value: Any) -> Any:
            if not limit.holds(value):
                raise wrong(limit.words)
            return value

        return BeforeValidator(kept)
    return limit


@dataclasses.dataclass(frozen=True)
class _Choice:
    """Annotation of a value that is one of the keys of a registry."""

    limit: OneOf

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> CoreSchema:
        known = self.limit.known

        def one_of(value: Any) -> Any:
            if not isinstance(value, str) or value not in known:
                raise wrong(f"is not available; {suggestion(str(value), list(known))}")
            return value

        return core_schema.no_info_before_validator_function(one_of, handler(source))

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: Any) -> dict[str, Any]:
        return {**handler(schema), "enum": list(self.limit.known)}

"""Sections that are classes of the package: their keys, types and limits are those of the class."""

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from types import UnionType
from typing import Annotated, Any, ClassVar, Union, get_args, get_origin, get_type_hints

from pydantic import BeforeValidator, PlainValidator, create_model

from bayes_greybox.data.limits import OneOf, Rule

from .section import Section, suggestion, wrong


class Derived(Section):
    """The fields of a class of the package; what the file leaves out has the default of the class."""

    made: ClassVar[Callable[..., Any]]

    def build(self) -> Any:
        """The object of the package."""
        fields = self.given(*self._own())
        return type(self).made(**{key: tuple(v) if isinstance(v, list) else v for key, v in fields.items()})

    @classmethod
    def _own(cls) -> Iterable[str]:
        """Keys that say which object is built, or whether one is."""
        return ()


class Kind(Derived):
    """The fields of one of several classes, which the key `kind` chooses."""

    kind: str

    @classmethod
    def _own(cls) -> Iterable[str]:
        return ("kind",)


class Switch(Derived):
    """The fields of a class, and whether there is such a part at all."""

    enabled: bool = True

    def build(self) -> Any:
        """The object of the package, or None where it is switched off."""
        return super().build() if self.enabled else None

    @classmethod
    def _own(cls) -> Iterable[str]:
        return ("enabled",)


@cache
def section_of(part: type, base: type[Derived] = Derived) -> type[Derived]:
    """The section that has the fields of a dataclass.

    Args:
        part: The dataclass; its types state its limits (see `data.limits`).
        base: The keys that the section has before those of the class.
    """
    hints = get_type_hints(part, include_extras=True)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(part):
        required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if field.init:
            fields[field.name] = (_in_toml(hints[field.name]), ... if required else None)
    section = create_model(part.__name__, __base__=base, __doc__=f"The fields of `{part.__name__}`.", **fields)
    section.made = part
    return section


def table(section: Callable[[Any], type[Section]]) -> PlainValidator:
    """Annotation of a table whose section is found when it is read, because that imports the room of models.

    Args:
        section: Finds the section for what the file has there.
    """

    def check(given: Any) -> Any:
        return given if isinstance(given, Section) else section(given).model_validate(given)

    return PlainValidator(check)


def table_of_kinds(kinds: Callable[[], Mapping[str, type]], example: str) -> PlainValidator:
    """Annotation of a table whose key `kind` says which class of a registry it has the fields of.

    Args:
        kinds: Imports the registry: classes by kind.
        example: One of its kinds.
    """

    def section(given: Any) -> type[Section]:
        if not isinstance(given, Mapping):
            raise wrong(f'should be a table with the key kind, such as {{ kind = "{example}" }}')
        known = kinds()
        if "kind" not in given:
            raise wrong(f"needs the key 'kind'; known: {', '.join(known)}")
        if not isinstance(given["kind"], str) or given["kind"] not in known:
            raise wrong(f"kind = {given['kind']!r} is not available; {suggestion(str(given['kind']), list(known))}")
        return section_of(known[given["kind"]], Kind)

    return table(section)


def _in_toml(hint: Any) -> Any:
    """A type of the package as a file can say it: lists for tuples, and limits as checks with their sentences."""
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
    """A limit as Pydantic checks it."""
    if isinstance(limit, OneOf):
        return BeforeValidator(lambda value: _one_of(value, limit.known))
    if isinstance(limit, Rule):
        return BeforeValidator(lambda value: _kept(value, limit))
    return limit


def _one_of(value: Any, known: Mapping[str, Any]) -> Any:
    if not isinstance(value, str) or value not in known:
        raise wrong(f"is not available; {suggestion(str(value), list(known))}")
    return value


def _kept(value: Any, rule: Rule) -> Any:
    if not rule.holds(value):
        raise wrong(rule.words)
    return value

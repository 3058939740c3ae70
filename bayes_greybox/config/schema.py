"""The JSON schema of configuration files, for editors: derived from the sections that check a file."""

from typing import Any

from .file import Config


def json_schema() -> dict[str, Any]:
    """Return keys, types, limits and choices of a configuration file as JSON Schema.

    Rules about more than one key, such as `test_fraction` beside `test`, are known to the checker alone.
    """
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    return _without_nothing({**dialect, **Config.model_json_schema(), "title": "Configuration of bayes-greybox"})


def _without_nothing(schema: Any) -> Any:
    """Remove null from the schema, which TOML does not have: keys that a file leaves out have the package's default."""
    if isinstance(schema, list):
        return [_without_nothing(each) for each in schema if each != {"type": "null"}]
    if not isinstance(schema, dict):
        return schema
    kept = {key: _without_nothing(value) for key, value in schema.items() if not (key == "default" and value is None)}
    # Defaults of whole sections are those of their keys.
    if isinstance(kept.get("default"), dict):
        del kept["default"]
    alternatives = kept.get("anyOf")
    if isinstance(alternatives, list) and len(alternatives) == 1:
        del kept["anyOf"]
        return {**alternatives[0], **kept}
    return kept

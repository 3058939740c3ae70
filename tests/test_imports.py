"""Imports that the contract of import-linter cannot see: none is hidden in a string, none goes through the root."""

import ast
import re
from functools import cache
from pathlib import Path

import bayes_greybox

PACKAGE = Path(bayes_greybox.__file__).parent
FILES = sorted(PACKAGE.rglob("*.py"))
FOREIGN = re.compile(r"""import_module\(["'](?!bayes_greybox)\w+["']\)""")
HIDDEN = re.compile(r"import_module|__import__|find_spec|load_module|attach_stub|lazy_loader|lazy\.(attach|load)")


@cache
def imports(path: Path) -> list[str]:
    """Modules that a file imports by statements, absolute ones."""
    found = []
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and not node.level:
            found.append(node.module or "")
    return found


def test_no_room_hides_an_import_or_imports_the_root():
    assert [path for path in FILES if "bayes_greybox" in imports(path)] == []
    # What times imports names what imports.
    exempt = (PACKAGE / "__init__.py", PACKAGE / "benchmarks" / "account.py")
    # A package that may be missing, such as PySINDy, is looked for by its name.
    texts = {path: FOREIGN.sub("", path.read_text(encoding="utf-8")) for path in FILES if path not in exempt}
    assert [path for path, text in texts.items() if HIDDEN.search(text)] == []


def test_what_must_be_found_is_found(tmp_path):
    file = tmp_path / "room.py"
    file.write_text("import numpy\n\ndef late():\n    import bayes_greybox as bg\n    from bayes_greybox import Fit\n")
    assert imports(file).count("bayes_greybox") == 2
    hidden = 'importlib.import_module("bayes_greybox.report")'
    assert HIDDEN.search(hidden) and FOREIGN.sub("", hidden) == hidden


def test_the_command_line_is_not_imported_by_any_room():
    others = [path for path in FILES if path.relative_to(PACKAGE).parts[0] not in ("cli", "__main__.py")]
    assert not [path for path in others if any(name.startswith("bayes_greybox.cli") for name in imports(path))]

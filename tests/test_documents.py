"""The documents hold together: README stays short, links and the files named in commands exist, metadata parse."""

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parent.parent
GUIDES = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")]
DOCS = sorted(page for page in (ROOT / "docs").rglob("*.md") if "generated" not in page.parts)
README_LIMIT = 8_000
"""Bytes: what a newcomer reads in five minutes."""
PICTURE_LIMIT = 150_000


def name_of(path):
    return path.relative_to(ROOT).as_posix()


def links(text):
    """Targets of the links and pictures of a page, but not of its code."""
    text = re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.DOTALL)
    return re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r'<img[^>]*\ssrc="([^"]+)"', text)


def anchors(text):
    """Anchors that a code host makes of the headings of a page."""
    headings = re.findall(r"^#+ +(.+?)\s*$", re.sub(r"```.*?```", "", text, flags=re.DOTALL), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def broken_links(page):
    """Relative links of a page that lead nowhere."""
    found = []
    for link in links(page.read_text(encoding="utf-8")):
        if re.match(r"[a-z]+:", link):
            continue
        path, _, anchor = link.partition("#")
        target = page.parent / path if path else page
        if not target.exists() or (anchor and anchor not in anchors(target.read_text(encoding="utf-8"))):
            found.append(link)
    return found


def missing_files(text):
    """Tests, configs and notebooks that a page names and that are not there."""
    named = re.findall(r"\b(?:tests|configs|notebooks|docs)/[\w/.-]*\.(?:py|toml|ipynb|csv|png)\b", text)
    return [name for name in named if not (ROOT / name).is_file()]


def test_readme_is_read_in_five_minutes():
    size = len((ROOT / "README.md").read_bytes())
    assert size <= README_LIMIT, f"README.md has {size} bytes; move what a newcomer does not need to docs/"
    pictures = re.findall(r'<img[^>]*\ssrc="([^"]+)"', (ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(pictures) == 1
    assert (ROOT / pictures[0]).stat().st_size <= PICTURE_LIMIT


def test_readme_begins_with_the_two_commands_that_ci_runs():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    marked = re.findall(r"^<!-- ci -->\n```bash\n(.*?)```", text, flags=re.DOTALL | re.MULTILINE)
    assert len(marked) == text.count("<!-- ci -->") == 2
    assert marked == re.findall(r"```\w+\n(.*?)```", text, flags=re.DOTALL)[:2]


@pytest.mark.parametrize("page", GUIDES + DOCS, ids=name_of)
def test_relative_links_lead_somewhere(page):
    assert not broken_links(page)


@pytest.mark.parametrize("page", [ROOT / "README.md", *DOCS], ids=name_of)
def test_files_named_in_commands_exist(page):
    assert not missing_files(page.read_text(encoding="utf-8"))


def test_every_page_of_results_is_in_their_index():
    index = ROOT / "docs" / "results" / "README.md"
    listed = set(links(index.read_text(encoding="utf-8")))
    assert {page.name for page in index.parent.glob("*.md")} - {index.name} <= listed


def test_a_broken_link_and_a_missing_file_are_found(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "# A page\n[gone](gone.md) [here](page.md#a-page) [no part](#a-chapter) `[code](x.md)` "
        '[far](https://example.org/x) <img src="no.png">',
        encoding="utf-8",
    )
    assert broken_links(page) == ["gone.md", "#a-chapter", "no.png"]
    assert missing_files("`python -m pytest tests/test_gone.py`, configs/first.toml") == ["tests/test_gone.py"]


def test_the_citation_is_that_of_this_package():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert citation["cff-version"] == "1.2.0"
    assert (citation["version"], citation["license"]) == (project["version"], project["license"])
    assert citation["authors"] == [{"name": "The bayes_greybox developers"}]
    (paper,) = citation["references"]
    assert [author["family-names"] for author in paper["authors"]] == ["Manna", "Rogers", "Bull"]
    assert paper["title"] in (ROOT / "README.md").read_text(encoding="utf-8").replace("\n", " ")


def test_the_hooks_are_local_and_those_of_ci():
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))
    assert [repo["repo"] for repo in config["repos"]] == ["local"]
    hooks = config["repos"][0]["hooks"]
    assert {hook["language"] for hook in hooks} == {"system"}
    checks = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    assert all(hook["entry"] in checks for hook in hooks)
    assert {hook["entry"] for hook in hooks} == {"ruff check", "ruff format", "pyright", "lint-imports"}


def test_the_source_distribution_has_the_documents():
    hatch = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]
    included = set(hatch["build"]["targets"]["sdist"]["include"])
    assert {"README.md", "CHANGELOG.md", "CONTRIBUTING.md", "CITATION.cff", "LICENSE", "docs", "notebooks"} <= included

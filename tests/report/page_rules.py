"""What every page has to keep to, whatever its verdict; `broken` says what a page does not."""

import re
from html import unescape
from html.parser import HTMLParser

from bayes_greybox.physics.catalogue.loading import load_catalogue

MOST_BYTES = 800_000
EMPTY = {"area", "base", "br", "col", "hr", "img", "input", "link", "meta", "source", "wbr"}
# Code, settings and configuration files call things by the names that a program takes.
VERBATIM = {"code", "style", "script"}

SITE = re.compile(r"_(theta|gamma|sigma|amplitude|length_scale|pi|tau|prior_sd|lambda|slab)\b")
SLUGS = {effect.slug for effect in load_catalogue("all") if "-" in effect.slug}
POWER = re.compile(r"\w\*\*|\w\^\d")
STROKES = re.compile(r"[A-Za-z1]/[A-Za-z²³]+/[A-Za-z]|[A-Za-z]\^-?\d|\d ?/ ?\(?[A-Za-z]+\*")
HYPHEN = re.compile(r"(?<![\w.\]-])-\d")


class Outline(HTMLParser):
    """Tags with attributes, every text, and the texts outside what is verbatim, each with the tag that it stands in."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[tuple[str, dict]] = []
        self.tags: list[tuple[str, dict]] = []
        self.texts: list[tuple[str, str]] = []
        self.every: list[str] = []
        self.faults: list[str] = []
        self.feed(text)
        self.faults += [f"<{tag}> is not closed" for tag, _ in self.open]

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in EMPTY:
            self.open.append((tag, dict(attrs)))

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        if not self.open or self.open[-1][0] != tag:
            self.faults.append(f"</{tag}> closes {self.open[-1:]}")
        self.open.pop()

    def handle_data(self, data):
        if not {"style", "script"} & {tag for tag, _ in self.open}:
            self.every.append(data)
        settings = any(about.get("id") == "settings" for _, about in self.open)
        if data.strip() and not settings and not VERBATIM & {tag for tag, _ in self.open}:
            self.texts.append((self.open[-1][0] if self.open else "", data))

    @property
    def words(self) -> str:
        """All that a reader sees outside what is verbatim."""
        return "\n".join(text for _, text in self.texts)


def broken(html: str) -> list[str]:
    """Rules that a page breaks, in words; none is the aim."""
    page = Outline(html)
    found = list(page.faults)
    if len(html.encode()) >= MOST_BYTES:
        found.append(f"{len(html.encode())} bytes")
    found += _fetched(page, html)
    found += _tables(html)
    found += _figures(page)
    words = page.words
    for name, pattern in (("a site", SITE), ("a power", POWER), ("a unit", STROKES), ("a hyphen for a minus", HYPHEN)):
        found += [f"{name}: {_around(words, match)}" for match in pattern.finditer(words)]
    found += [f"the slug {slug}" for slug in SLUGS if re.search(rf"(?<![\w-]){slug}(?![\w-])", words)]
    zero, below = re.search(r"(?<![\d.])0\u00a0%", words), re.search(r"<\u00a00\.01\u00a0%", words)
    if zero and below:
        found.append(f"0 % beside < 0.01 %: {_around(words, zero)}")
    if re.search(r"\bnan\b|\bNone\b(?! of)|\binf\b", words):
        found.append("a number that is none")
    return found


def _fetched(page: Outline, html: str) -> list[str]:
    found = []
    for tag, about in page.tags:
        for name in ("src", "srcset", "href", "data", "action", "xlink:href"):
            if not about.get(name, "#").startswith(("data:", "#")):
                found.append(f"{tag} fetches {about[name]}")
        if tag in ("link", "iframe", "object", "embed", "base"):
            found.append(f"there is a {tag}")
    found += [f"a style fetches {match}" for match in re.findall(r"url\((?!#)[^)]*\)|@import", html)]
    policy = next(
        (about["content"] for _, about in page.tags if about.get("http-equiv") == "Content-Security-Policy"), ""
    )
    if not policy.startswith("default-src 'none'") or "script-src 'sha256-" not in policy or "http" in policy:
        found.append(f"the policy is {policy}")
    return found


def _tables(html: str) -> list[str]:
    found = []
    for table in re.findall(r"<table>.*?</table>", html, re.DOTALL):
        if not re.search(r"<caption><span>[^<]+</span></caption>", table):
            found.append(f"a table without a caption: {table[:120]}")
        for row in re.findall(r"<tr.*?</tr>", table.split("<tbody>")[1], re.DOTALL):
            if row.count('scope="row"') != 1:
                found.append(f"a row without a header: {row[:120]}")
    return found


def _figures(page: Outline) -> list[str]:
    found, ids = [], [about["id"] for _, about in page.tags if "id" in about]
    found += [f"the id {name} twice" for name in sorted({name for name in ids if ids.count(name) > 1})]
    for tag, about in page.tags:
        if tag == "svg" and (about.get("role") != "img" or len(about.get("aria-label", "")) < 20):
            found.append(f"a figure without words: {about.get('aria-label')}")
        href = about.get("href", "") if tag == "use" else ""
        if href.startswith("#") and href[1:] not in ids:
            found.append(f"{href} leads nowhere")
    return found


def _around(words: str, match: re.Match) -> str:
    return unescape(words[max(0, match.start() - 40) : match.end() + 25]).replace("\n", " | ")

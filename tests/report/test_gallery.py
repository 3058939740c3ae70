"""A page of every kind of verdict keeps to the rules for pages."""

import pytest
from gallery import MADE
from page_rules import broken


@pytest.mark.slow
@pytest.mark.parametrize("kind", MADE)
def test_a_page_of_every_kind_keeps_to_the_rules(kind, tmp_path):
    MADE[kind]().to_html(tmp_path / "page.html")
    assert broken((tmp_path / "page.html").read_text(encoding="utf-8")) == []

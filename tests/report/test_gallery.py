"""A page of every kind of verdict keeps to the rules for pages."""

import pytest
from gallery import MADE
from page_rules import broken

from bayes_greybox.discovery.decision.decide import VERDICTS


@pytest.mark.slow
@pytest.mark.parametrize("kind", MADE)
def test_a_page_of_every_kind_keeps_to_the_rules(kind, tmp_path):
    made = MADE[kind]()
    made.to_html(tmp_path / "page.html")
    # A page is of the verdict that it is to show.
    verdict = kind.replace("-", " ")
    assert verdict not in VERDICTS or made.verdict == verdict
    assert broken((tmp_path / "page.html").read_text(encoding="utf-8")) == []

"""Laws next to what was found, where there are none to weigh."""

import os
from types import SimpleNamespace

import pytest

from bayes_greybox.discovery.weighing.path.laws import weigh_laws


@pytest.mark.skipif(
    os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1", reason="what stands for explanations has no types"
)
@pytest.mark.parametrize("core", [(1,), (0, 2)], ids=["an inner parameter", "a finer value that only noise asked for"])
def test_what_has_an_inner_parameter_has_no_laws_next_to_it(core):
    columns = [SimpleNamespace(inner=()), SimpleNamespace(inner=(("limit", 0.5),))]
    never = lambda *_: pytest.fail("asked for laws")  # noqa: E731
    base = SimpleNamespace(statistics=SimpleNamespace(columns=columns), laws=never)
    near = SimpleNamespace(base=base, sets=SimpleNamespace(likeliest=lambda: core))
    weigh_laws(near, never)

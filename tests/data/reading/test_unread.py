"""Tables given where measurements belong: the answer names the door."""

import os

import numpy as np
import pandas as pd
import pytest

import bayes_greybox as bg

pytestmark = pytest.mark.skipif(
    os.environ.get("BAYES_GREYBOX_TYPECHECK", "0") == "1", reason="the checker of types answers first"
)
T = np.linspace(0.0, 1.0, 11)
FRAME = pd.DataFrame({"t": T, "y": np.sin(T), "v": np.cos(T)})
MODEL = bg.GreyBox(simulation={"y": "v"}, dictionary={"y": ["y"]})
DATA = bg.read(FRAME, time="t", states=["y", "v"], derivatives={"y": "v"})


@pytest.mark.parametrize(
    "table", [FRAME, FRAME.to_numpy(), {"t": T}, "run.csv"], ids=lambda table: type(table).__name__
)
@pytest.mark.parametrize(
    "call",
    [
        MODEL.fit,
        MODEL.complete,
        lambda table: bg.find_missing_effects(MODEL, table),
        lambda table: bg.find_missing_effects(MODEL, DATA, table),
        lambda table: bg.compare_priors(MODEL, table),
    ],
    ids=["fit", "predict", "study", "held-out data", "compare priors"],
)
def test_a_table_that_was_not_read_is_answered_with_bg_read(call, table):
    with pytest.raises(bg.InputError, match=rf"not a {type(table).__name__}, .*bg\.read\(table, time=") as refused:
        call(table)
    assert "\n" not in str(refused.value)

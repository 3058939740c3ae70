"""No table crashes its reader: frames with odd cells and headers, and text that is hardly a table."""

import pandas as pd
import probes
from hypothesis import given, settings
from hypothesis import strategies as st

import bayes_greybox as bg

SETTINGS = settings(derandomize=True, deadline=None, max_examples=80, database=None)

CELLS = st.one_of(
    st.floats(width=32),
    st.sampled_from(
        [
            None,
            "",
            "nan",
            "1,5",
            "1e999",
            "-inf",
            "2024-02-30",
            "12:61",
            "3.4.2024",
            "=1+1",
            "\0",
            "ü",
            10**40,
            True,
            1j,
            b"x",
        ]
    ),
)
HEADERS = ["t", "y", "v", "t ", "y [m]", "", "exec", "sin", "<b>", "y\n", "1", "ｙ", "run"]


def read(source, **settings):
    """What `read` says of the columns t and y."""
    with probes.no_code():
        try:
            data = bg.read(source, time="t", states=["y"], inputs=["v"], **settings)
            assert len(data.time) == len(data.states["y"]) > 0
        except bg.InputError as error:
            probes.sentence(error)


@SETTINGS
@given(
    st.lists(st.lists(CELLS, min_size=3, max_size=3), max_size=8),
    st.lists(st.sampled_from(HEADERS), min_size=3, max_size=3),
    st.sampled_from(({}, {"missing": "drop"}, {"restart": "run"}, {"constant": "keep", "missing": "drop"})),
)
def test_frames_are_read_or_refused(rows, headers, settings):
    names = headers if headers[0] != "t" else ["t", "y", "v"]
    read(pd.DataFrame(rows, columns=names), **settings)


GOOD = b"t,y,v\n" + b"".join(f"{k}.0,{k * k},{-k}\n".encode() for k in range(8))


@SETTINGS
@given(
    st.integers(0, len(GOOD)), st.integers(0, 20), st.binary(max_size=10), st.sampled_from((b",", b";", b"\t", b" "))
)
def test_text_is_read_or_refused(tmp_path_factory, at, length, put, mark):
    file = _folder(tmp_path_factory) / "run.csv"
    file.write_bytes((GOOD[:at] + put + GOOD[at + length :]).replace(b",", mark))
    read(file)


_folders = {}


def _folder(tmp_path_factory):
    return _folders.setdefault("one", tmp_path_factory.mktemp("tables"))

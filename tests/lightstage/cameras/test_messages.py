"""Messages between a capture and its cameras' processes."""

from __future__ import annotations

import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lightstage.cameras import messages

VALUES = st.dictionaries(
    st.text(max_size=8),
    st.none() | st.text(max_size=20) | st.integers(-(10**12), 10**12) | st.lists(st.text()),
    max_size=5,
)


@given(st.lists(VALUES, max_size=4), st.integers(0, 400))
def test_messages_survive_their_stream_and_a_cut_one_is_none(sent, cut):
    data = b"".join(map(messages.pack, sent))
    stream = io.BytesIO(data)
    assert [messages.read(stream.read) for _ in sent] == sent
    assert messages.read(stream.read) is None
    short = io.BytesIO(data[: min(cut, len(data))])
    whole = []
    while (message := messages.read(short.read)) is not None:
        whole.append(message)
    assert whole == sent[: len(whole)]


@given(st.binary(min_size=8, max_size=64).filter(lambda data: not data.startswith(b"cam2")))
def test_what_is_no_message_is_reported(data):
    with pytest.raises(ValueError, match="no message"):
        messages.read(io.BytesIO(data).read)


def test_a_length_beyond_all_reason_is_no_message():
    with pytest.raises(ValueError, match="no message"):
        messages.read(io.BytesIO(b"cam2\xff\xff\xff\xff" + b"x" * 100).read)
    with pytest.raises(ValueError, match="no object"):
        messages.read(io.BytesIO(b"cam2\x02\0\0\0[]").read)

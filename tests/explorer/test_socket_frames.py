"""The socket's frames are those of RFC 6455: its own examples, every length, every fault."""

import io

import pytest

from sampling_design.explorer.server import (
    BROKEN,
    CLOSE,
    CONTINUED,
    NORMAL,
    PING,
    PONG,
    TEXT,
    TOO_LARGE,
    accepted,
    frame,
    messages,
)

KEY = bytes.fromhex("37fa213d")
BINARY = 0x2


def masked(kind, payload, last=True, key=KEY):
    """A browser's frame, bit by bit as section 5.2 draws it."""
    size = len(payload)
    length = (
        bytes([128 | size])
        if size < 126
        else b"\xfe" + size.to_bytes(2, "big") if size < 65536 else b"\xff" + size.to_bytes(8, "big")
    )  # fmt: skip
    return bytes([128 * last | kind]) + length + key + bytes(b ^ key[i % 4] for i, b in enumerate(payload))


def heard(*frames, largest=1_000_000):
    sink = io.BytesIO()
    found = list(messages(io.BytesIO(b"".join(frames)), sink, largest))
    return found, sink.getvalue()


def goodbye(code):
    return bytes([128 | CLOSE, 2]) + code.to_bytes(2, "big")


def test_the_examples_of_the_standard():
    assert accepted("dGhlIHNhbXBsZSBub25jZQ==") == "s3pPLMBiTxaQ9kYGzzhZRbK+xOo="
    assert frame(TEXT, b"Hello") == bytes.fromhex("810548656c6c6f")
    assert masked(TEXT, b"Hello") == bytes.fromhex("818537fa213d7f9f4d5158")
    assert heard(bytes.fromhex("818537fa213d7f9f4d5158")) == (["Hello"], b"")
    assert heard(masked(TEXT, b"Hel", last=False), masked(CONTINUED, b"lo")) == (["Hello"], b"")
    assert frame(TEXT, bytes(256))[:4] == bytes.fromhex("817e0100")
    assert frame(TEXT, bytes(65536))[:10] == bytes.fromhex("817f0000000000010000")


@pytest.mark.parametrize("size", [0, 1, 3, 4, 125, 126, 127, 65535, 65536])
def test_every_length_is_read_back(size):
    text = ("grüße " * size).encode()[:size].decode("utf-8", "ignore").ljust(size, ".")[:size]
    payload = text.encode()
    assert heard(masked(TEXT, payload), masked(TEXT, b"next")) == ([text, "next"], b"")
    assert frame(TEXT, payload).endswith(payload)


def test_pings_are_answered_between_the_parts_of_a_message_and_goodbyes_returned():
    found, sent = heard(
        masked(TEXT, b"", last=False), masked(PING, b"there?"), masked(PONG, b""), masked(CONTINUED, b"yes"),
        masked(CLOSE, b"\x03\xe8"), masked(TEXT, b"too late"),
    )  # fmt: skip
    assert found == ["yes"]
    assert sent == frame(PONG, b"there?") + goodbye(NORMAL)


@pytest.mark.parametrize(
    ("frames", "code"),
    [
        ([frame(TEXT, b"not masked")], BROKEN),
        ([masked(BINARY, b"no text")], BROKEN),
        ([masked(CONTINUED, b"of nothing")], BROKEN),
        ([masked(TEXT, b"a", last=False), masked(TEXT, b"b")], BROKEN),
        ([masked(PING, b"cut", last=False)], BROKEN),
        ([masked(PING, bytes(126))], BROKEN),
        ([bytes([0xC1]) + masked(TEXT, b"packed")[1:]], BROKEN),
        ([masked(TEXT, bytes(1001))], TOO_LARGE),
        ([masked(TEXT, bytes(600), last=False), masked(CONTINUED, bytes(401))], TOO_LARGE),
    ],
)
def test_what_is_no_question_ends_the_connection(frames, code):
    assert heard(masked(TEXT, b"before"), *frames, masked(TEXT, b"after"), largest=1000) == (["before"], goodbye(code))


def test_who_is_gone_is_told_nothing():
    whole = masked(TEXT, b"Hello there")
    for kept in range(len(whole)):
        assert heard(whole[:kept]) == ([], b"")

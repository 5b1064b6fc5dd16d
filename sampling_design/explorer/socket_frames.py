"""The frames of a WebSocket (RFC 6455), as far as one browser that asks and one explorer that answers need them."""

from __future__ import annotations

import base64
import hashlib
from collections.abc import Iterator
from io import BufferedIOBase

KEY_SUFFIX = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"
"""What every server appends to a browser's key (RFC 6455, section 1.3)."""

CONTINUED, TEXT, CLOSE, PING, PONG = 0x0, 0x1, 0x8, 0x9, 0xA
LAST, MASKED = 0x80, 0x80
"""First bit of a frame's first byte: the message ends here; of its second: the payload is masked."""

MOST_CONTROL = 125  # bytes of a ping, a pong or a goodbye
NORMAL, BROKEN, TOO_LARGE = 1000, 1002, 1009  # why a connection is closed (section 7.4.1)


class ConnectionOver(Exception):
    """Nothing more is read; `code` says why, None where the other side is gone without a word."""

    def __init__(self, code: int | None) -> None:
        super().__init__(code)
        self.code = code


def accepted(key: str) -> str:
    """Return what proves to a browser that its key was read by somebody who speaks this protocol."""
    return base64.b64encode(hashlib.sha1((key + KEY_SUFFIX).encode(), usedforsecurity=False).digest()).decode()


def frame(kind: int, payload: bytes) -> bytes:
    """Return one whole unmasked frame, as servers send them."""
    size = len(payload)
    if size <= MOST_CONTROL:
        length = bytes([size])
    elif size < 1 << 16:
        length = bytes([126]) + size.to_bytes(2, "big")
    else:
        length = bytes([127]) + size.to_bytes(8, "big")
    return bytes([LAST | kind]) + length + payload


def messages(source: BufferedIOBase, sink: BufferedIOBase, largest: int) -> Iterator[str]:
    """Yield the texts that a browser sends until it says goodbye; pings are answered, goodbyes returned.

    Parameters
    ----------
    source, sink : binary streams
        Of the connection.
    largest : int
        Bytes of a message; a longer one ends the connection before it is read.
    """
    try:
        while True:
            yield _message(source, sink, largest)
    except ConnectionOver as over:
        if over.code is not None:
            sink.write(frame(CLOSE, over.code.to_bytes(2, "big")))
            sink.flush()


def _message(source: BufferedIOBase, sink: BufferedIOBase, largest: int) -> str:
    """The next text, its parts joined."""
    parts: list[bytes] = []
    begun = False
    while True:
        last, kind, payload = _frame(source, largest - sum(map(len, parts)))
        if kind == CLOSE:
            raise ConnectionOver(NORMAL)
        if kind == PING:
            sink.write(frame(PONG, payload))
            sink.flush()
        elif kind != PONG:
            if kind != (CONTINUED if begun else TEXT):
                raise ConnectionOver(BROKEN)
            begun = True
            parts.append(payload)
            if last:
                return b"".join(parts).decode("utf-8", "replace")


def _frame(source: BufferedIOBase, most: int) -> tuple[bool, int, bytes]:
    """Whether a message ends with the next frame, its kind, and its payload."""
    first, second = _exactly(source, 2)
    kind, size = first & 0x0F, second & 0x7F
    if first & 0x70 or not second & MASKED or (kind >= CLOSE and (size > MOST_CONTROL or not first & LAST)):
        raise ConnectionOver(BROKEN)
    if size > MOST_CONTROL:
        size = int.from_bytes(_exactly(source, 2 if size == 126 else 8), "big")
    if size > max(most, MOST_CONTROL if kind >= CLOSE else 0):
        raise ConnectionOver(TOO_LARGE)
    mask, payload = _exactly(source, 4), _exactly(source, size)
    key = int.from_bytes((mask * (size // 4 + 1))[:size], "big")
    return bool(first & LAST), kind, (int.from_bytes(payload, "big") ^ key).to_bytes(size, "big")


def _exactly(source: BufferedIOBase, size: int) -> bytes:
    """So many bytes."""
    found = source.read(size)
    if len(found) < size:
        raise ConnectionOver(None)
    return found

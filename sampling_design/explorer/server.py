"""The explorer on this machine's loopback: its page, its one module, and answers for whoever has the token."""

from __future__ import annotations

import base64
import hashlib
import secrets
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BufferedIOBase
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from sampling_design.errors import ArgumentError
from sampling_design.explorer.schedule_explorer import ScheduleExplorer
from sampling_design.records import checks
from sampling_design.records.budget import now

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


MODULE = Path(__file__).with_name("explorer.js")
LARGEST = 1_000_000
"""Bytes of a question; 400 samples of 30 sensors take a tenth of it."""
_LINGER = 2.0  # seconds that whoever still sends is listened to after the last answer
_UNREAD = 20 * LARGEST  # bytes that are thrown away meanwhile
_BLOCK = 65536  # of them at a time

PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>Explorer</title></head><body><main id="explorer"></main>
<script type="module" nonce="{nonce}">
import {{ mount }} from "/explorer.js?token={token}";
/* Questions go through one open socket, and answers come back in their order; by POST where it is not open. */
const ENDED = "the explorer on this machine has ended; start the command again";
let socket = null;
const waiting = [];
function connect() {{
  socket = new WebSocket(`ws://${{location.host}}/ask?token={token}`);
  socket.onmessage = (message) => waiting.shift()[0](JSON.parse(message.data));
  socket.onclose = () => {{
    for (const [, failed] of waiting.splice(0)) failed(new Error(ENDED));
    socket = null;
  }};
}}
async function post(text) {{
  const answer = await fetch("/ask", {{
    method: "POST",
    headers: {{ "Content-Type": "application/json", "X-Token": "{token}" }},
    body: text,
  }}).catch(() => {{ throw new Error(ENDED); }});
  if (!answer.ok) throw new Error(`the explorer on this machine says ${{answer.status}}`);
  return answer.json();
}}
const ask = (question) => {{
  const text = JSON.stringify(question);
  if (socket === null) connect();
  if (socket.readyState !== WebSocket.OPEN) return post(text);
  return new Promise((answered, failed) => {{
    waiting.push([answered, failed]);
    socket.send(text);
  }});
}};
mount(document.getElementById("explorer"), ask);
</script></body></html>
"""


class Server(ThreadingHTTPServer):
    """Answers on loopback, to its own name and to the token of its address."""

    daemon_threads = True

    def __init__(self, explorer: ScheduleExplorer, port: int = 0) -> None:
        super().__init__(("127.0.0.1", port), Handler)
        self.explorer, self.token = explorer, secrets.token_urlsafe(24)
        self.lock = threading.Lock()
        self.last_request = now()
        self.timeout = 0.2

    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that has gone away is no defect; anything else is told."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]

    def shutdown_request(self, request: socket.socket | tuple[bytes, socket.socket]) -> None:
        """End a connection once its peer has: closed with bytes unread it is reset, and the last answer is lost."""
        assert isinstance(request, socket.socket)  # a pair is what servers of datagrams are given
        until, unread = now() + _LINGER, _UNREAD
        with suppress(OSError):  # gone, or silent for too long
            request.shutdown(socket.SHUT_WR)
            while unread > 0 and (left := until - now()) > 0:
                request.settimeout(left)
                thrown = len(request.recv(_BLOCK))
                if not thrown:
                    break
                unread -= thrown
        self.close_request(request)

    @property
    def address(self) -> str:
        """What a browser opens."""
        return f"http://127.0.0.1:{self.server_port}/?token={self.token}"


class Handler(BaseHTTPRequestHandler):
    """GET the page and its module, POST a question."""

    server: Server
    timeout = 30
    protocol_version = "HTTP/1.1"
    # an answer leaves as one packet: its body would wait for the acknowledgement of its head, ten milliseconds a drag
    wbufsize = 65536
    disable_nagle_algorithm = True

    def log_message(self, format: str, *args: object) -> None:
        """Say nothing: the terminal belongs to whoever started the explorer."""

    def do_GET(self) -> None:
        """Send the page or the module."""
        parts = urlsplit(self.path)
        given = parse_qs(parts.query).get("token", [""])[0]
        if not self._welcome(given):
            return
        if parts.path == "/":
            nonce = secrets.token_urlsafe(12)
            page = PAGE.format(token=self.server.token, nonce=nonce)
            policy = (
                f"default-src 'none'; script-src 'self' 'nonce-{nonce}'; connect-src 'self' "
                f"ws://{self.headers['Host']}; style-src 'unsafe-inline'; base-uri 'none'; "
                "form-action 'none'; frame-ancestors 'none'"
            )
            self._send(200, "text/html; charset=utf-8", page.encode(), policy)
        elif parts.path == "/ask" and self.headers.get("Upgrade", "").lower() == "websocket":
            self._converse()
        elif parts.path == "/explorer.js":
            self._send(200, "text/javascript; charset=utf-8", MODULE.read_bytes())
        else:
            self._send(404, "text/plain", b"There is nothing here.\n")

    def do_POST(self) -> None:
        """Answer a question."""
        length = self.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > LARGEST:
            self.close_connection = True
            self._send(413, "text/plain", b"A question has a length, and not so large a one.\n")
            return
        text = self.rfile.read(int(length))
        if not self._welcome(self.headers.get("X-Token", "")):
            return
        if urlsplit(self.path).path != "/ask":
            self._send(404, "text/plain", b"There is nothing here.\n")
            return
        self._send(200, "application/json", self._answer(text.decode("utf-8", "replace")))

    def _converse(self) -> None:
        """Answer the questions of one page until it goes away: a drag asks too often for a request each."""
        key, version = self.headers.get("Sec-WebSocket-Key", ""), self.headers.get("Sec-WebSocket-Version")
        self.close_connection = True
        # another site's script could not read the token, and may not ask either
        if self.headers.get("Origin") != f"http://{self.headers['Host']}" or not key or version != "13":
            self._send(403, "text/plain", b"Open the address that the explorer printed when it began.\n")
            return
        self.send_response(101)
        for name, value in (
            ("Upgrade", "websocket"),
            ("Connection", "Upgrade"),
            ("Sec-WebSocket-Accept", accepted(key)),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.flush()
        # a page may lie open for long between two questions
        self.connection.settimeout(None)
        for text in messages(self.rfile, self.wfile, LARGEST):
            self.server.last_request = now()
            self.wfile.write(frame(TEXT, self._answer(text)))
            self.wfile.flush()

    def _answer(self, text: str) -> bytes:
        """What the explorer answers; one question at a time, since its samples are one."""
        with self.server.lock:
            return self.server.explorer.answer_json(text).encode()

    def _welcome(self, token: str) -> bool:
        """Whether this is for us: under our own name (no other site's name may lead here) and with our token."""
        own = {f"127.0.0.1:{self.server.server_port}", f"localhost:{self.server.server_port}"}
        good = self.headers.get("Host") in own and secrets.compare_digest(token.encode(), self.server.token.encode())
        if good:
            self.server.last_request = now()
        else:
            self._send(403, "text/plain", b"Open the address that the explorer printed when it began.\n")
        return good

    def _send(self, status: int, kind: str, body: bytes, policy: str = "default-src 'none'") -> None:
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store"),
            ("Content-Security-Policy", policy),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
        ):
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)


def serve(
    explorer: ScheduleExplorer, port: int = 0, idle: float = 3600.0, ready: Callable[[str], object] = print
) -> None:
    """Serve the explorer until nobody has asked for `idle` seconds, or an interrupt.

    Parameters
    ----------
    explorer : ScheduleExplorer
    port : int
        0 takes a free one.
    idle : float [s]
    ready : callable
        Called with the address once it can be opened.

    Raises
    ------
    ArgumentError
        If `idle` is not positive, or the port is taken or none.
    """
    idle = checks.positive("idle", idle)
    try:
        opened = Server(explorer, port)
    except (OSError, OverflowError) as error:
        raise ArgumentError(f"`port` {port} cannot be used here ({error}). Take another, or 0 for any.") from None
    with opened as server:
        ready(server.address)
        while now() - server.last_request < idle:
            server.handle_request()

"""The server answers its own name and its own token, and nobody else."""

import http.client
import json
import socket
import threading
import time
from contextlib import contextmanager

import pytest

from sampling_design.errors import ArgumentError
from sampling_design.explorer import scene, serve
from sampling_design.explorer.server import CLOSE, LARGEST, TEXT, TOO_LARGE, Server, accepted


@pytest.fixture(scope="module")
def server():
    with Server(scene("pathological")) as made:
        thread = threading.Thread(target=made.serve_forever, kwargs={"poll_interval": 0.02})
        thread.start()
        yield made
        made.shutdown()
        thread.join()


def ask(server, method="GET", path="/", body=None, **headers):
    link = http.client.HTTPConnection("127.0.0.1", server.server_port, timeout=10)
    named = {key.replace("_", "-"): value for key, value in headers.items()}
    link.request(method, path, body, named)
    answer = link.getresponse()
    found = answer.status, answer.read().decode(), dict(answer.getheaders())
    link.close()
    return found


def test_the_page_and_its_module_come_with_the_token_and_load_nothing_else(server):
    status, page, headers = ask(server, path=f"/?token={server.token}")
    assert status == 200
    assert "http" not in page
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    status, module, _ = ask(server, path=f"/explorer.js?token={server.token}")
    assert status == 200
    assert "export default" in module
    assert "import " not in module
    assert ask(server, path=f"/etc/passwd?token={server.token}")[0] == 404


def test_a_question_is_answered(server):
    status, text, _ = ask(server, "POST", "/ask", '{"ask": "sigma"}', X_Token=server.token)
    assert status == 200
    assert json.loads(text)["ask"] == "sigma"


@pytest.mark.parametrize(
    ("path", "headers"),
    [("/ask", {}), ("/ask", {"X_Token": "guess"}), ("/ask", {"X_Token": "", "Host": "127.0.0.1"})],
)
def test_without_the_token_nothing_is_answered(server, path, headers):
    assert ask(server, "POST", path, '{"ask": "open"}', **headers)[0] == 403
    assert ask(server, path="/")[0] == 403
    assert ask(server, path="/explorer.js?token=")[0] == 403


def test_another_sites_name_for_this_machine_is_refused(server):
    own = f"127.0.0.1:{server.server_port}"
    assert ask(server, path=f"/?token={server.token}", Host="evil.example")[0] == 403
    assert ask(server, path=f"/?token={server.token}", Host=own)[0] == 200


def test_a_question_too_large_is_refused(server):
    for length in (str(LARGEST + 1), "\u00b2"):
        assert ask(server, "POST", "/ask", X_Token=server.token, Content_Length=length)[0] == 413


def test_a_refusal_reaches_whoever_is_still_sending(server):
    for _ in range(20):
        assert ask(server, "POST", "/ask", bytes(4 * LARGEST), X_Token=server.token)[0] == 413

    def send_on(line):
        began = time.monotonic()
        while time.monotonic() - began < 10:
            line.sendall(bytes(65536))

    with socket.create_connection(("127.0.0.1", server.server_port), timeout=10) as line:
        line.sendall(b"POST /ask HTTP/1.1\r\nContent-Length: 9999999\r\n\r\n")
        heard = b"".join(iter(lambda: line.recv(65536), b""))
        assert heard.startswith(b"HTTP/1.1 413 ")
        with pytest.raises(ConnectionError):  # who sends without end is not listened to for ever
            send_on(line)


KEY = "dGhlIHNhbXBsZSBub25jZQ=="


@contextmanager
def talk(server, **wrong):
    """Yield the answer's head and a stream to a socket that a page would open."""
    own = f"127.0.0.1:{server.server_port}"
    token = wrong.pop("token", server.token)
    named = {"Host": own, "Origin": f"http://{own}", "Upgrade": "websocket", "Connection": "Upgrade"}
    named |= {"Sec-WebSocket-Key": KEY, "Sec-WebSocket-Version": "13"} | wrong
    with socket.create_connection(("127.0.0.1", server.server_port), timeout=10) as link, link.makefile("rwb") as line:
        head = "".join(f"{name}: {value}\r\n" for name, value in named.items() if value is not None)
        line.write(f"GET /ask?token={token} HTTP/1.1\r\n{head}\r\n".encode())
        line.flush()
        yield b"".join(iter(line.readline, b"\r\n")).decode(), line


def say(line, payload):
    """A question in one frame with the mask 0, and the kind and text of its answer."""
    line.write(bytes([128 | TEXT, 128 | 127]) + len(payload).to_bytes(8, "big") + bytes(4) + payload)
    line.flush()
    first, size = line.read(2)
    size = int.from_bytes(line.read(2), "big") if size == 126 else size
    return first & 15, line.read(size)


def test_an_open_socket_answers_as_a_request_does(server):
    with talk(server) as (head, line):
        assert head.startswith("HTTP/1.1 101 ")
        assert f"Sec-WebSocket-Accept: {accepted(KEY)}" in head
        for question in ('{"ask": "sigma"}', '{"ask": "open"}', "no json", "[1]", '{"ask": "sigma"}'):
            kind, text = say(line, question.encode())
            assert kind == TEXT
            assert json.loads(text) == json.loads(ask(server, "POST", "/ask", question, X_Token=server.token)[1])
        assert say(line, bytes(LARGEST + 1)) == (CLOSE, TOO_LARGE.to_bytes(2, "big"))
        assert line.read() == b""


@pytest.mark.parametrize(
    "wrong",
    [
        {"token": "guess"}, {"token": ""}, {"Host": "evil.example"}, {"Origin": "http://evil.example"},
        {"Origin": None}, {"Origin": "null"}, {"Sec-WebSocket-Key": None}, {"Sec-WebSocket-Version": "8"},
    ],
)  # fmt: skip
def test_a_socket_opens_for_our_own_page_only(server, wrong):
    with talk(server, **wrong) as (head, _):
        assert head.startswith("HTTP/1.1 403 ")


def test_it_listens_on_loopback_only(server):
    assert server.server_address[0] == "127.0.0.1"


def test_it_ends_when_nobody_asks():
    seen, began = [], time.monotonic()
    serve(scene("pathological"), idle=0.3, ready=seen.append)
    assert 0.3 <= time.monotonic() - began < 20
    assert seen[0].startswith("http://127.0.0.1:")
    with pytest.raises(ArgumentError, match="cannot be used here"):
        serve(scene("pathological"), port=70_000)
    with pytest.raises(ArgumentError, match="`idle`"):
        serve(scene("pathological"), idle=0.0)

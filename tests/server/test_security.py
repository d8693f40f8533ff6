"""Requests that must be refused, each by its rule."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cnc.model.diagnostics import UsageError
from cnc.server.library import checked
from cnc.server.security import MOST_BODY, MOST_UPLOAD, Rates
from cnc.server.serve import open_address
from tests.support.server import asgi

TOKEN = "0123456789abcdef"


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8080",
        "127.0.0.1",
        "127.0.0.1:8081",
        "127.0.0.1:8080.evil.example",
        "127.0.0.1.:8080",
        "[::1]:8080",
        "0.0.0.0:8080",
        "",
    ],
)
def test_another_host_is_refused(client, host):
    answer = client("GET", "/api/state", headers={"host": host})
    assert (answer.status_code, answer.json()["code"]) == (403, "host-refused")


@pytest.mark.parametrize("host", ["127.0.0.1:8080", "localhost:8080", "LOCALHOST:8080"])
def test_the_names_of_the_server_are_accepted(client, host):
    assert client("GET", "/api/state", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "https://127.0.0.1:8080",
        "http://127.0.0.1",
        "http://127.0.0.1:8080.evil.example",
        "http://127.0.0.1:8080/",
        "null",
        "",
    ],
)
@pytest.mark.parametrize(("method", "path"), [("POST", "/api/stop"), ("GET", "/api/state")])
def test_another_origin_is_refused(client, origin, method, path):
    answer = client(method, path, headers={"origin": origin})
    assert (answer.status_code, answer.json()["code"]) == (403, "origin-refused")


def test_the_own_origin_is_accepted(client):
    headers = {"origin": "http://127.0.0.1:8080"}
    assert client("POST", "/api/stop", headers=headers).status_code == 200


def test_there_is_no_cors(client):
    answer = client("GET", "/api/state", headers={"origin": "http://127.0.0.1:8080"})
    assert not [name for name in answer.headers if name.startswith("access-control")]
    preflight = {
        "origin": "http://evil.example",
        "access-control-request-method": "PUT",
    }
    assert client("OPTIONS", "/api/jobs/a.nc", headers=preflight).status_code == 403


def test_a_request_of_another_site_without_an_origin_is_refused(client):
    headers = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"}
    assert client("GET", "/api/state", headers=headers).status_code == 403


@pytest.mark.parametrize(
    "kind",
    [
        "text/plain",
        "application/x-www-form-urlencoded",
        "multipart/form-data; boundary=x",
        "",
        "text/plain; application/json",
        "application/jsonp",
    ],
)
@pytest.mark.parametrize(("method", "path"), [("POST", "/api/stop"), ("PUT", "/api/jobs/a.nc")])
def test_a_body_of_another_type_is_refused(client, kind, method, path):
    answer = client(method, path, headers={"content-type": kind}, content=b'{"text": "G0 X1"}')
    assert (answer.status_code, answer.json()["code"]) == (415, "content-type")


@pytest.mark.parametrize(
    "headers",
    [
        {},
        {"authorization": "Bearer"},
        {"authorization": "Bearer wrong"},
        {"authorization": f"Basic {TOKEN}"},
        {"authorization": f"Bearer {TOKEN}x"},
        {"cookie": "cncrun-token=wrong"},
        {"cookie": f"other={TOKEN}"},
    ],
)
@pytest.mark.parametrize("path", ["/", "/api/state", "/api/openapi.json", "/page/index.html"])
def test_a_request_without_the_token_is_refused(client_of, headers, path):
    answer = client_of(TOKEN)("GET", path, headers=headers)
    assert (answer.status_code, answer.json()["code"]) == (401, "token-wrong")


@pytest.mark.parametrize(
    "headers",
    [{"authorization": f"Bearer {TOKEN}"}, {"cookie": f"a=b; cncrun-token={TOKEN}"}],
)
def test_the_token_is_accepted(client_of, headers):
    assert client_of(TOKEN)("GET", "/api/state", headers=headers).status_code == 200


def test_the_link_sets_a_cookie_that_scripts_and_other_sites_cannot_use(client_of):
    client = client_of(TOKEN)
    answer = client("GET", f"/?token={TOKEN}")
    assert (answer.status_code, answer.headers["location"]) == (303, "/")
    cookie = answer.headers["set-cookie"]
    assert cookie.startswith(f"cncrun-token={TOKEN};")
    assert "HttpOnly" in cookie
    assert "SameSite=Strict" in cookie
    assert client("GET", "/?token=wrong").status_code == 401
    assert client("GET", f"/api/state?token={TOKEN}").status_code == 401


@pytest.mark.parametrize(
    ("path", "most"), [("/api/mdi", MOST_BODY), ("/api/jobs/a.nc", MOST_UPLOAD)]
)
def test_a_body_that_is_declared_too_long_is_refused_unread(client, path, most):
    method = "PUT" if "jobs" in path else "POST"
    headers = {"content-length": str(most + 1)}
    answer = client(method, path, headers=headers, content=b"")
    assert (answer.status_code, answer.json()["code"]) == (413, "body-too-large")


def test_a_body_without_a_length_is_cut_at_the_limit(client, library, monkeypatch):
    monkeypatch.setattr("cnc.server.security.MOST_UPLOAD", 100_000)
    pieces = [b'{"text": "', *[b"x" * 10_000] * 50]
    answer = asgi.chunked(client.app, client.host, "PUT", "/api/jobs/a.nc", pieces)
    assert answer == 413
    assert library.names() == []
    assert [each.name for each in (library.folder / ".cncrun").iterdir()] == []


@pytest.mark.parametrize(
    "name",
    [
        "../a.nc",
        "..%2fa.nc",
        "%2e%2e/a.nc",
        "/etc/passwd.nc",
        "a\\b.nc",
        "a.sh",
        ".nc",
        "a.nc\0",
        "con.nc",
        "x" * 300 + ".nc",
        "a.nc\n",
        "a%00.nc",
    ],
)
def test_no_name_leaves_the_library(client, library, name):
    from urllib.parse import quote

    for written in (name, quote(name, safe="%")):
        for method in ("PUT", "GET", "DELETE"):
            answer = client(
                method,
                f"/api/jobs/{written}"
                if "\0" not in written and "\n" not in written
                else "/api/jobs/%00",
                {"text": "G0"} if method == "PUT" else None,
            )
            assert answer.status_code in (400, 404, 405, 409)
    assert library.names() == []


@given(st.text(max_size=30))
def test_an_accepted_name_is_one_plain_file(name):
    try:
        accepted = checked(name)
    except UsageError:
        return
    assert accepted == name
    assert not set(name) & set("/\\:\0\n")
    assert not name.startswith(".")
    assert Path(name).name == name


def test_a_link_to_a_file_elsewhere_is_no_job(client, library, tmp_path):
    secret = tmp_path / "secret.nc"
    secret.write_text("secret")
    link = library.folder / "link.nc"
    link.symlink_to(secret)
    assert client("GET", "/api/jobs/link.nc/text").status_code == 404
    assert client("PUT", "/api/jobs/link.nc", {"text": "G0"}).status_code == 400
    assert secret.read_text() == "secret"
    assert client("GET", "/api/jobs").json() == []
    link.unlink()


def test_every_answer_has_the_headers_of_a_safe_page(client_of):
    client = client_of(TOKEN)
    good = {"authorization": f"Bearer {TOKEN}"}
    for headers in ({}, good):
        found = client("GET", "/api/state", headers=headers).headers
        assert "script-src 'self'" in found["content-security-policy"]
        assert "unsafe" not in found["content-security-policy"]
        assert found["x-content-type-options"] == "nosniff"
        assert found["x-frame-options"] == "DENY"


def test_a_flood_is_refused_and_a_stop_is_not(client_of):
    client = client_of(rates=Rates(rate=1e-6, burst=3))
    codes = [client("GET", "/api/state").status_code for _ in range(5)]
    assert codes == [200, 200, 200, 429, 429]
    assert client("POST", "/api/stop").status_code == 200
    key = client_of()("POST", "/api/control", {"client": "test"}).json()["key"]
    assert client("POST", "/api/hold", headers={"x-control": key}).status_code == 200
    assert client("POST", "/api/hold", headers={"x-control": "wrong"}).status_code == 429


def test_the_rate_of_each_address_is_its_own():
    rates = Rates(rate=10.0, burst=2.0)
    assert [rates.allow("a", 0.0) for _ in range(3)] == [True, True, False]
    assert rates.allow("b", 0.0)
    assert rates.allow("a", 0.1)
    assert not rates.allow("a", 0.1)


@pytest.mark.parametrize(
    ("headers", "accepted"),
    [
        ({"host": "127.0.0.1:8080"}, True),
        ({"host": "evil.example:8080"}, False),
        ({"host": "127.0.0.1:8080", "origin": "http://evil.example"}, False),
        ({"host": "127.0.0.1:8080", "origin": "null"}, False),
        ({"host": "127.0.0.1:8080", "origin": "http://127.0.0.1:8080"}, True),
    ],
)
def test_a_websocket_obeys_the_same_rules(client, headers, accepted):
    kinds = [message["type"] for message in asgi.websocket(client.app, headers)]
    assert ("websocket.accept" in kinds) is accepted


def test_a_websocket_needs_the_token(client_of):
    client = client_of(TOKEN)
    host = {"host": "127.0.0.1:8080"}
    assert asgi.websocket(client.app, host)[0]["type"] == "websocket.close"
    cookie = host | {"cookie": f"cncrun-token={TOKEN}"}
    assert asgi.websocket(client.app, cookie)[0]["type"] == "websocket.accept"
    assert asgi.websocket(client.app, host, f"token={TOKEN}")[0]["type"] == "websocket.accept"


@pytest.mark.parametrize("message", ["x" * 2000, "{", "[]", '{"jog": "1"}', '{"evil": 1}', "null"])
def test_a_wrong_message_ends_the_websocket(client, message):
    sent = asgi.websocket(client.app, {"host": "127.0.0.1:8080"}, messages=[message])
    assert sent[-1]["type"] == "websocket.close"


def test_a_wrong_body_is_an_error_without_its_values(controller):
    answer = controller("POST", "/api/jog/step", {"distances": {"x": "<script>"}})
    assert (answer.status_code, answer.json()["code"]) == (400, "wrong-body")
    assert "<script>" not in json.dumps(answer.json())


def test_a_local_address_needs_no_token_and_any_other_gets_one():
    local = open_address("127.0.0.1", 0, None)
    every = open_address("0.0.0.0", 0, None)
    try:
        port = local.socket.getsockname()[1]
        assert local.access.token is None
        assert local.link == f"http://127.0.0.1:{port}/"
        assert local.access.hosts == {f"127.0.0.1:{port}", f"localhost:{port}"}
        assert len(every.access.token) >= 16
        assert every.link.endswith(f"/?token={every.access.token}")
    finally:
        local.socket.close()
        every.socket.close()


@pytest.mark.parametrize("token", ["short", "has blank 123", "semicolon;123", ""])
def test_a_token_that_a_link_cannot_have_is_refused(token):
    with pytest.raises(UsageError, match="token-format"):
        open_address("127.0.0.1", 0, token)

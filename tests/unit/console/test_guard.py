"""Who comes through to the console: each route, by each kind of caller."""

from __future__ import annotations

import pytest
from console_requests import HOST, ORIGIN, SOCKET, Console

from console.guard import LARGEST_BODY_BYTES, MOST_CLIENTS
from console.sessions import Role


@pytest.fixture
def console() -> Console:
    return Console()


ROUTES = [
    ("GET", "/"),
    ("GET", "/state"),
    ("POST", "/orders"),
    ("GET", "/picture/head.stl"),
    ("GET", "/nothing"),
]


@pytest.mark.parametrize(("method", "path"), ROUTES)
@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1:1", "localhost", "", f"{HOST}.evil.example"])
def test_another_host_name_is_told_that_this_is_not_the_address(
    console: Console, method: str, path: str, host: str
) -> None:
    headers = {"cookie": console.operator(), "origin": ORIGIN}
    assert console.request(method, path, headers=headers, host=host).status == 421
    assert console.reached == []


@pytest.mark.parametrize(("method", "path"), ROUTES)
@pytest.mark.parametrize(
    "cookie", ["", "ronna_console_8765=guess", "ronna_console_8765=", 'a="', "ronna_console_1=x"]
)
def test_without_a_session_nothing_is_shown(console: Console, method: str, path: str, cookie: str) -> None:
    answer = console.request(method, path, headers={"cookie": cookie, "origin": ORIGIN})
    assert answer.status == 401
    assert console.reached == []


@pytest.mark.parametrize(
    "origin", [None, "null", "http://evil.example", f"https://{HOST}", f"{ORIGIN}.evil.example"]
)
def test_an_order_from_another_page_is_refused(console: Console, origin: str | None) -> None:
    headers = {"cookie": console.operator()} | ({} if origin is None else {"origin": origin})
    assert console.request("POST", "/orders", headers=headers, body=b"{}").status == 403
    assert not console.open_socket(headers)


@pytest.mark.parametrize("token", ["", "x", "%00", "a" * 5000])
def test_a_wrong_key_opens_nothing(console: Console, token: str) -> None:
    answer = console.request("GET", "/", query=f"token={token}")
    assert answer.status == 401
    assert "set-cookie" not in answer.headers


def test_a_key_becomes_a_cookie_that_no_script_reads_and_leaves_the_address(console: Console) -> None:
    answer = console.request("GET", "/", query=f"token={console.sessions.operator_token}")
    assert answer.status == 303
    assert answer.headers["location"] == "/"
    assert {"HttpOnly", "SameSite=Strict"} <= set(answer.headers["set-cookie"].split("; "))
    assert console.sessions.operator_token not in str(answer.headers)


def test_a_browser_with_the_cookie_gets_the_page_and_a_socket(console: Console) -> None:
    cookie = console.viewer()
    assert console.request("GET", "/", headers={"cookie": cookie}).status == 200
    assert console.open_socket({"cookie": cookie, "origin": ORIGIN})
    assert console.reached == ["/", SOCKET]


@pytest.mark.parametrize("status_of", ["/", "/state", "/nothing"])
def test_every_answer_keeps_out_of_frames_caches_and_foreign_content(
    console: Console, status_of: str
) -> None:
    for cookie in ("", console.viewer()):
        headers = console.request("GET", status_of, headers={"cookie": cookie}).headers
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["cache-control"] == "no-store"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["x-content-type-options"] == "nosniff"


def test_a_body_beyond_the_bound_is_not_read(console: Console) -> None:
    body = b'{"kind":"stop","nonce":"' + b"a" * LARGEST_BODY_BYTES + b'"}'
    headers = {"cookie": console.operator(), "origin": ORIGIN}
    assert console.request("POST", "/orders", headers=headers, body=body).status == 413
    assert console.request("POST", "/orders", headers=headers, body=body, length=False).status == 400


def test_the_page_librarys_second_transport_is_closed(console: Console) -> None:
    headers = {"cookie": console.operator(), "origin": ORIGIN}
    assert console.request("GET", SOCKET, headers=headers).status == 400
    assert console.request("POST", SOCKET, headers=headers, body=b"40").status == 400


def test_a_ninth_viewer_is_refused_and_the_operator_comes_in(console: Console) -> None:
    headers = {"cookie": console.viewer(), "origin": ORIGIN}
    console.app.clients[Role.VIEWER] = MOST_CLIENTS[Role.VIEWER] - 1
    assert console.open_socket(headers)
    console.app.clients[Role.VIEWER] = MOST_CLIENTS[Role.VIEWER]
    assert not console.open_socket(headers)
    assert console.open_socket({"cookie": console.operator(), "origin": ORIGIN})


def test_a_header_that_comes_twice_counts_as_none(console: Console) -> None:
    headers = {"cookie": console.operator(), "origin": ORIGIN, "Origin": "http://evil.example"}
    assert console.request("POST", "/orders", headers=headers, body=b"{}").status == 403


REMOTE = "192.168.1.20:40001"


@pytest.fixture
def elsewhere(console: Console) -> Console:
    """The console as viewers at other computers reach it."""
    console.app = console.app.for_viewers(REMOTE)
    return console


def test_the_key_of_operators_opens_nothing_from_another_computer(elsewhere: Console) -> None:
    key = elsewhere.sessions.operator_token
    answer = elsewhere.request("GET", "/", query=f"token={key}", host=REMOTE)
    assert (answer.status, "set-cookie" in answer.headers) == (401, False)


def test_an_operators_session_counts_nothing_from_another_computer(console: Console) -> None:
    cookie = console.operator()
    console.app = console.app.for_viewers(REMOTE)
    headers = {"cookie": cookie, "origin": f"https://{REMOTE}"}
    assert console.request("POST", "/orders", headers=headers, body=b"{}", host=REMOTE).status == 401
    assert not console.open_socket(headers, host=REMOTE)


def test_a_viewer_at_another_computer_looks_on_by_tls_and_gives_no_order(elsewhere: Console) -> None:
    opened = elsewhere.request("GET", "/", query=f"token={elsewhere.sessions.viewer_token}", host=REMOTE)
    assert "Secure" in opened.headers["set-cookie"].split("; ")
    headers = {"cookie": opened.headers["set-cookie"].split(";")[0], "origin": f"https://{REMOTE}"}
    assert elsewhere.request("GET", "/", headers=headers, host=REMOTE).status == 200
    assert elsewhere.open_socket(headers, host=REMOTE)
    order = elsewhere.request("POST", "/orders", headers=headers, body=b'{"kind": "stop"}', host=REMOTE)
    assert order.status == 403


@pytest.mark.parametrize("origin", [f"http://{REMOTE}", ORIGIN, "null"])
def test_only_its_own_page_speaks_from_another_computer(elsewhere: Console, origin: str) -> None:
    opened = elsewhere.request("GET", "/", query=f"token={elsewhere.sessions.viewer_token}", host=REMOTE)
    headers = {"cookie": opened.headers["set-cookie"].split(";")[0], "origin": origin}
    assert not elsewhere.open_socket(headers, host=REMOTE)
    assert elsewhere.request("GET", "/", headers=headers, host=HOST).status == 421

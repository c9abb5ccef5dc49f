"""Access to the console: each route, by each kind of caller."""

from __future__ import annotations

import time

import pytest
from console_requests import HOST, ORIGIN, SOCKET, Console

from console.guard import LARGEST_BODY_BYTES, LARGEST_HEAD_BYTES, MOST_CLIENTS, PAGES, PAGES_S, SessionRole


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
def test_a_wrong_host_header_is_answered_with_misdirected_request(
    console: Console, method: str, path: str, host: str
) -> None:
    headers = {"cookie": console.operator(), "origin": ORIGIN}
    assert console.request(method, path, headers=headers, host=host).status == 421
    assert console.reached == []


@pytest.mark.parametrize(("method", "path"), ROUTES)
@pytest.mark.parametrize(
    "cookie", ["", "ronna_console_8765=guess", "ronna_console_8765=", 'a="', "ronna_console_1=x"]
)
def test_no_route_is_reached_without_a_session(console: Console, method: str, path: str, cookie: str) -> None:
    answer = console.request(method, path, headers={"cookie": cookie, "origin": ORIGIN})
    assert answer.status == 401
    assert console.reached == []


@pytest.mark.parametrize("quoted", ["\\", '\\"', "\\0"])
def test_a_cookie_of_quoted_backslashes_costs_a_stranger_not_the_console(
    console: Console, quoted: str
) -> None:
    cookie = f'a="{quoted * (LARGEST_HEAD_BYTES // len(quoted) - 100)}"'
    begun_s = time.process_time()
    assert console.request("GET", "/", headers={"cookie": cookie}).status == 401
    assert not console.open_socket({"cookie": cookie, "origin": ORIGIN})
    assert time.process_time() - begun_s < 0.3  # the parser of Python's library takes seconds


def test_a_session_is_found_among_the_cookies_of_others(console: Console) -> None:
    ours = console.operator()
    cookie = f'ronna_console_1=x; a="b;c"; {ours.partition("=")[0]}=set by another program; {ours}; d'
    assert console.request("GET", "/", headers={"cookie": cookie}).status == 200


@pytest.mark.parametrize("role", SessionRole)
def test_a_role_that_opens_page_after_page_does_not_hold_up_the_others(
    console: Console, role: SessionRole
) -> None:
    now_s = [0.0]
    console.sessions.now_s = lambda: now_s[0]
    viewer, operator = {"cookie": console.viewer()}, {"cookie": console.operator()}
    ours, others = (viewer, operator) if role is SessionRole.VIEWER else (operator, viewer)
    answers = [console.request("GET", "/", headers=ours).status for _ in range(PAGES + 1)]
    assert answers == [200] * PAGES + [429]
    assert console.request("GET", "/", headers=others).status == 200
    assert console.request("GET", "/state", headers=ours).status == 200
    now_s[0] += PAGES_S
    assert console.request("GET", "/", headers=ours).status == 200


def test_a_request_head_beyond_its_limit_is_refused(console: Console) -> None:
    headers = {"cookie": console.operator(), "origin": ORIGIN, "x": "a" * LARGEST_HEAD_BYTES}
    assert console.request("GET", "/", headers=headers).status == 431
    assert not console.open_socket(headers)
    assert console.reached == []


@pytest.mark.parametrize(
    "origin", [None, "null", "http://evil.example", f"https://{HOST}", f"{ORIGIN}.evil.example"]
)
def test_an_order_from_another_origin_is_refused(console: Console, origin: str | None) -> None:
    headers = {"cookie": console.operator()} | ({} if origin is None else {"origin": origin})
    assert console.request("POST", "/orders", headers=headers, body=b"{}").status == 403
    assert not console.open_socket(headers)


@pytest.mark.parametrize("token", ["", "x", "%00", "a" * 5000])
def test_a_wrong_token_opens_no_session(console: Console, token: str) -> None:
    answer = console.request("GET", "/", query=f"token={token}")
    assert answer.status == 401
    assert "set-cookie" not in answer.headers


def test_a_token_is_exchanged_for_an_http_only_cookie_and_removed_from_the_address(console: Console) -> None:
    answer = console.request("GET", "/", query=f"token={console.sessions.operator_token}")
    assert answer.status == 303
    assert answer.headers["location"] == "/"
    assert {"HttpOnly", "SameSite=Strict"} <= set(answer.headers["set-cookie"].split("; "))
    assert console.sessions.operator_token not in str(answer.headers)


@pytest.mark.parametrize(("more", "location"), [("&low", "/?low"), ("&low=1&x=//y", "/?low"), ("&x", "/")])
def test_of_an_address_with_a_token_only_the_option_for_slow_computers_is_kept(
    console: Console, more: str, location: str
) -> None:
    answer = console.request("GET", "/", query=f"token={console.sessions.viewer_token}{more}")
    assert (answer.status, answer.headers["location"]) == (303, location)


def test_a_browser_with_the_cookie_gets_the_page_and_the_socket(console: Console) -> None:
    cookie = console.viewer()
    assert console.request("GET", "/", headers={"cookie": cookie}).status == 200
    assert console.open_socket({"cookie": cookie, "origin": ORIGIN})
    assert console.reached == ["/", SOCKET]


@pytest.mark.parametrize("status_of", ["/", "/state", "/nothing"])
def test_every_response_forbids_framing_caching_and_foreign_content(console: Console, status_of: str) -> None:
    for cookie in ("", console.viewer()):
        headers = console.request("GET", status_of, headers={"cookie": cookie}).headers
        assert "default-src 'none'" in headers["content-security-policy"]
        assert "frame-ancestors 'none'" in headers["content-security-policy"]
        assert headers["cache-control"] == "no-store"
        assert headers["referrer-policy"] == "no-referrer"
        assert headers["x-content-type-options"] == "nosniff"


def test_a_body_over_the_limit_or_without_a_length_is_refused(console: Console) -> None:
    body = b'{"kind":"stop","nonce":"' + b"a" * LARGEST_BODY_BYTES + b'"}'
    headers = {"cookie": console.operator(), "origin": ORIGIN}
    assert console.request("POST", "/orders", headers=headers, body=body).status == 413
    assert console.request("POST", "/orders", headers=headers, body=body, length=False).status == 400


def test_the_polling_transport_of_the_page_library_is_disabled(console: Console) -> None:
    headers = {"cookie": console.operator(), "origin": ORIGIN}
    assert console.request("GET", SOCKET, headers=headers).status == 400
    assert console.request("POST", SOCKET, headers=headers, body=b"40").status == 400


def test_a_viewer_over_the_limit_is_refused_while_the_operator_is_admitted(console: Console) -> None:
    headers = {"cookie": console.viewer(), "origin": ORIGIN}
    console.app.clients[SessionRole.VIEWER] = MOST_CLIENTS[SessionRole.VIEWER] - 1
    assert console.open_socket(headers)
    console.app.clients[SessionRole.VIEWER] = MOST_CLIENTS[SessionRole.VIEWER]
    assert not console.open_socket(headers)
    assert console.open_socket({"cookie": console.operator(), "origin": ORIGIN})


def test_a_duplicate_origin_header_is_refused(console: Console) -> None:
    headers = {"cookie": console.operator(), "origin": ORIGIN, "Origin": "http://evil.example"}
    assert console.request("POST", "/orders", headers=headers, body=b"{}").status == 403


REMOTE = "192.168.1.20:40001"


@pytest.fixture
def elsewhere(console: Console) -> Console:
    """The console as viewers at other computers reach it."""
    console.app = console.app.viewer_guard(REMOTE)
    return console


def test_the_operator_token_opens_no_session_from_another_computer(elsewhere: Console) -> None:
    key = elsewhere.sessions.operator_token
    answer = elsewhere.request("GET", "/", query=f"token={key}", host=REMOTE)
    assert (answer.status, "set-cookie" in answer.headers) == (401, False)


def test_an_operator_session_is_not_valid_from_another_computer(console: Console) -> None:
    cookie = console.operator()
    console.app = console.app.viewer_guard(REMOTE)
    headers = {"cookie": cookie, "origin": f"https://{REMOTE}"}
    assert console.request("POST", "/orders", headers=headers, body=b"{}", host=REMOTE).status == 401
    assert not console.open_socket(headers, host=REMOTE)


def test_a_viewer_at_another_computer_gets_the_page_over_tls_and_cannot_give_orders(
    elsewhere: Console,
) -> None:
    opened = elsewhere.request("GET", "/", query=f"token={elsewhere.sessions.viewer_token}", host=REMOTE)
    assert "Secure" in opened.headers["set-cookie"].split("; ")
    headers = {"cookie": opened.headers["set-cookie"].split(";")[0], "origin": f"https://{REMOTE}"}
    assert elsewhere.request("GET", "/", headers=headers, host=REMOTE).status == 200
    assert elsewhere.open_socket(headers, host=REMOTE)
    order = elsewhere.request("POST", "/orders", headers=headers, body=b'{"kind": "stop"}', host=REMOTE)
    assert order.status == 403


@pytest.mark.parametrize("origin", [f"http://{REMOTE}", ORIGIN, "null"])
def test_only_the_consoles_own_origin_and_host_are_accepted_from_another_computer(
    elsewhere: Console, origin: str
) -> None:
    opened = elsewhere.request("GET", "/", query=f"token={elsewhere.sessions.viewer_token}", host=REMOTE)
    headers = {"cookie": opened.headers["set-cookie"].split(";")[0], "origin": origin}
    assert not elsewhere.open_socket(headers, host=REMOTE)
    assert elsewhere.request("GET", "/", headers=headers, host=HOST).status == 421

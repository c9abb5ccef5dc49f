import pytest

from ronna_hw.endpoints import BadEndpoint, parse_endpoint


@pytest.mark.parametrize(
    "text",
    [
        "udp://127.0.0.1:59152",
        "tcp://[::1]:8765",
        "serial:///dev/ttyUSB0",
        "gev://192.168.3.10",
        "shm:///proc/1/fd/5",
        "host:",
    ],
)
def test_an_endpoint_survives_a_round_trip_through_text(text: str) -> None:
    assert str(parse_endpoint(text)) == text


@pytest.mark.parametrize(
    "text",
    ["", "8765", "tcp://127.0.0.1", "tcp://127.0.0.1:99999", "http://a:1", "serial://dev/x", "udp://:5"],
)
def test_invalid_endpoint_text_is_refused_and_quoted(text: str) -> None:
    with pytest.raises(BadEndpoint) as refused:
        parse_endpoint(text)
    assert repr(text) in str(refused.value)


def test_an_endpoint_of_the_wrong_kind_is_refused_with_the_supported_kinds() -> None:
    with pytest.raises(BadEndpoint, match="serial: or tcp:"):
        parse_endpoint("udp://127.0.0.1:1").require("serial", "tcp")

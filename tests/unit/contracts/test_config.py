from pathlib import Path

import pytest

from ronna_hw.clock import HostClock
from ronna_hw.config import BadTheatreFile, DeviceConfig, parse_theatre, read_theatre_file
from ronna_hw.devices.errors import UnknownDriver
from ronna_hw.registry import driver_names, make_device


def test_a_small_theatre_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "theatre.toml"
    path.write_text(
        'schema = 1\ntheatre = "lab"\n[tracker]\ndriver = "ndi_polaris"\nendpoint = "serial:///dev/ttyUSB0"\n'
        '[robot.master]\ndriver = "kuka_rsi"\n[robot.master.endpoints]\nrsi = "udp://192.168.1.5:59152"\n'
    )
    theatre = read_theatre_file(path)
    assert theatre.robot["master"].address("rsi").port == 59152
    assert theatre.clock.endpoint == "host:"


def test_all_mistakes_of_a_theatre_file_are_reported_at_once() -> None:
    content = {
        "schema": 1,
        "theatre": "lab",
        "colour": "green",
        "clock": {"endpoint": "tcp://127.0.0.1:1"},
        "tracker": {"driver": 5, "endpoint": "serial:///dev/x"},
    }
    with pytest.raises(BadTheatreFile, match="CFG-001") as refused:
        parse_theatre(content)
    message = str(refused.value)
    assert "3 mistake(s)" in message
    for part in ("colour", "clock.endpoint", "tracker.driver"):
        assert part in message


def test_a_device_needs_an_endpoint() -> None:
    with pytest.raises(BadTheatreFile, match="either endpoint or endpoints"):
        parse_theatre({"schema": 1, "theatre": "lab", "tracker": {"driver": "ndi_polaris"}})


@pytest.mark.parametrize("text", ["schema = ", "\udcff"])
def test_a_file_that_is_not_toml_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "broken.toml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(BadTheatreFile, match=r"broken\.toml is not TOML"):
        read_theatre_file(path)


def test_a_missing_theatre_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(BadTheatreFile, match="cannot read"):
        read_theatre_file(tmp_path / "none.toml")


def test_an_unknown_driver_names_those_that_are_installed() -> None:
    config = DeviceConfig(driver="abacus", endpoint="tcp://127.0.0.1:1")
    with pytest.raises(UnknownDriver) as refused:
        make_device("tracker", config, HostClock())
    for name in driver_names():
        assert name in str(refused.value)


def test_the_three_drivers_are_installed() -> None:
    assert {"ndi_polaris", "kuka_rsi", "basler_stereo"} <= set(driver_names())


def test_relative_paths_of_a_device_begin_at_its_theatre_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab = tmp_path / "lab"
    lab.mkdir()
    (lab / "theatre.toml").write_text(
        'schema = 1\ntheatre = "lab"\n[tracker]\ndriver = "ndi_polaris"\nendpoint = "tcp://127.0.0.1:8765"\n'
    )
    monkeypatch.chdir(tmp_path)
    tracker = read_theatre_file(Path("lab/theatre.toml")).tracker
    assert tracker is not None
    assert tracker.folder == lab
    assert tracker.model_copy(update={"endpoint": "tcp://127.0.0.1:1"}).folder == lab
    assert DeviceConfig(driver="ndi_polaris", endpoint="host:").folder is None

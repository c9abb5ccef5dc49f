"""User parameters, alerts and the feature list."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from conftest import Bench


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        ("GET Features.Hardware.Model", "Features.Hardware.Model=Polaris Spectra"),
        ("GET PS-0.Features.Firmware.Version", "Features.Firmware.Version=007.000.012"),
        ("GET Info.Timeout.PINIT", "Info.Timeout.PINIT=6"),
        ("GET Features.Nothing", "ERROR34"),
        ("GET Nothing*", "ERROR34"),
        ("GET ", "ERROR07"),
        ("SET Param.Tracking.Sensitivity=7", "OKAY"),
        ("SET Param.Tracking.Sensitivity=8", "ERROR36"),
        ("SET Param.Tracking.Sensitivity=99999999999999999999", "ERROR36"),
        ("SET Param.Tracking.Sensitivity=high", "ERROR35"),
        ("SET Param.Tracking.Sensitivity", "ERROR07"),
        ("SET Features.Hardware.Model=Vega", "ERROR39"),
        ("SET Param.Nothing=1", "ERROR34"),
        ("SET Param.User.String0=" + "x" * 256, "ERROR38"),
    ],
)
def test_parameters_are_read_and_set_by_name(bench: Bench, line: str, answer: str) -> None:
    assert bench.send(line) == answer


def test_a_wildcard_lists_every_parameter_with_that_prefix(bench: Bench) -> None:
    lines = bench.send("GET Info.Timeout.*").split("\n")
    assert len(lines) > 50
    assert all(line.startswith("Info.Timeout.") for line in lines)


def test_parameter_information_has_seven_fields(bench: Bench) -> None:
    answer = bench.send_with_crc("GETINFO:Features.Firmware.Version")
    assert answer.startswith("Features.Firmware.Version=007.000.012;")
    for line in bench.send("GETINFO *").split("\n"):
        assert len(line.split(";")) == 7


def test_the_rate_and_volume_commands_set_the_parameters(bench: Bench) -> None:
    assert bench.send("IRATE 1") == "OKAY"
    assert bench.send("GET Param.Tracking.Illuminator Rate") == "Param.Tracking.Illuminator Rate=1"
    assert bench.send("VSEL 2") == "OKAY"
    assert bench.send("GET Param.Tracking.Selected Volume") == "Param.Tracking.Selected Volume=1"


def test_tracking_settings_cannot_be_changed_while_tracking(bench: Bench) -> None:
    bench.send("TSTART 80")
    assert bench.send("SET Param.Tracking.Sensitivity=5") == "ERROR0C"
    assert bench.send("SET Param.User.String0=note") == "OKAY"
    assert bench.send("GET Param.User.String0") == "Param.User.String0=note"


def test_volume_k_of_the_feature_list_starts_at_1_plus_74_k_as_plus_expects(bench: Bench) -> None:
    reply = bench.send("SFLIST 03")
    assert [reply[0], reply[1:75], reply[75:]] == [
        "2",
        "5-240000-153200-095000+057200+039800+056946+024303+029773+999999+99999924\n",
        "5-300000-153200-095000+057200+039800+056946+024303+029773+999999+07350024\n",
    ]

"""User parameters, alerts, the feature list, what survives a reset, the watchdog, and the other models."""

from __future__ import annotations

import pytest
from polaris_bench import Bench, MakeBench

from sim.polaris.unit.model import VEGA, VICRA
from sim.world.scene.model import TrackerTool
from sim.world.scene.named_scenes import draw_scene


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


SENSITIVITY = "Param.Tracking.Sensitivity"
BUMP, MAIN_VOLTAGE = 1 << 21, 1 << 2


def test_only_saved_settings_survive_a_reset(bench: Bench) -> None:
    for line in (f"SET {SENSITIVITY}=7", "SET Param.User.String1=ours", "SAVE ", f"SET {SENSITIVITY}=2"):
        assert bench.send(line) == "OKAY"
    bench.send("INIT ")
    assert bench.value(SENSITIVITY) == "2"
    bench.send("RESET 0")
    assert bench.value(SENSITIVITY) == "7"
    assert bench.value("Param.User.String1") == "ours"


def test_alerts_are_not_saved(bench: Bench) -> None:
    bench.send(f"SET Param.Simulated Alerts={BUMP}")
    bench.send("SAVE ")
    bench.send("RESET 0")
    assert bench.value("Param.Simulated Alerts") == "0"
    assert bench.value("Info.Status.Alerts") == "0"


def test_factory_values_are_restored_one_by_one_or_all_together(bench: Bench) -> None:
    bench.send(f"SET {SENSITIVITY}=7")
    bench.send("SET Param.User.String0=x")
    assert bench.send(f"DFLT {SENSITIVITY}") == "OKAY"
    assert bench.value(SENSITIVITY) == "4"
    assert bench.send("DFLT Param.*") == "OKAY"
    assert bench.value("Param.User.String0") == ""
    assert bench.send("DFLT Features.Hardware.Model") == "ERROR39"
    assert bench.send("DFLT Param.Nothing") == "ERROR34"
    assert bench.send("DFLT ") == "ERROR07"


def test_a_unit_can_start_at_20_hz_and_lists_its_rates(make_bench: MakeBench) -> None:
    bench = make_bench(saved_illuminator_rate=0)
    assert bench.value("Param.Tracking.Illuminator Rate") == "0"
    assert bench.send("GETINFO Param.Tracking.Illuminator Rate").split(";")[1:6] == [
        "1", "3", "0", "2", "20Hz,30Hz,60Hz",
    ]  # fmt: skip


def test_bump_detection_can_be_switched_off(bench: Bench) -> None:
    from ronna_hw.wire.polaris import Alert

    bench.send("SET Param.Bump Detector.Bump Detection=0")
    bench.unit.alerts.raise_alert(Alert.BUMP)
    assert bench.value("Param.Bump Detector.Bumped") == "0"
    bench.send("SET Param.Bump Detector.Bump Detection=1")
    bench.unit.alerts.raise_alert(Alert.BUMP)
    assert bench.value("Info.Status.Bump Detected") == "1"
    assert bench.value("Param.Bump Detector.Clear") == "0"


def test_a_second_bump_is_a_new_alert(bench: Bench) -> None:
    from ronna_hw.wire.polaris import Alert

    bench.unit.alerts.raise_alert(Alert.BUMP)
    assert bench.value("Info.Status.New Alerts") == str(BUMP)
    bench.unit.alerts.raise_alert(Alert.BUMP)
    assert bench.value("Info.Status.New Alerts") == str(BUMP)


@pytest.mark.parametrize("line", ["SET Param.Watch Dog Timer=2", "HCWDOG 2"])
def test_the_watchdog_stops_tracking_when_the_host_is_silent(
    bench: Bench, pointer: TrackerTool, line: str
) -> None:
    bench.enable(pointer)
    assert bench.send(line) == "OKAY"
    assert bench.value("Param.Watch Dog Timer") == "2"
    bench.send("TSTART 80")
    for _ in range(5):
        bench.world.clock.sleep(1.5)
        assert not bench.send("TX 0001").startswith("ERROR")
    bench.world.clock.sleep(2.5)
    assert bench.send("TX 0001") == "ERROR0C"
    assert bench.send("PHSR 04") == "0101031"


def test_the_watchdog_can_reset_the_unit(make_bench: MakeBench) -> None:
    bench = make_bench(watch_dog="reset", reset_s=0.0).ready()
    bench.send("HCWDOG 2")
    bench.world.clock.sleep(1.0)
    assert bench.interpreter.unsolicited_bytes() == b""
    bench.world.clock.sleep(2.0)
    assert bench.interpreter.unsolicited_bytes() == b"RESETBE6F\r"
    assert bench.send("PHSR 00") == "ERROR10"
    bench.world.clock.sleep(10.0)
    assert bench.interpreter.unsolicited_bytes() == b""  # it was reset too


@pytest.mark.parametrize(
    ("line", "answer"), [("HCWDOG x", "ERROR23"), ("HCWDOG 3601", "ERROR23"), ("HCWDOG ", "ERROR07")]
)
def test_an_invalid_watchdog_timeout_is_refused(bench: Bench, line: str, answer: str) -> None:
    assert bench.send(line) == answer


def test_a_beep_is_refused_while_another_one_sounds(make_bench: MakeBench) -> None:
    bench = make_bench(beep_s=0.5)
    assert bench.send("BEEP 2") == "1"
    assert bench.send("BEEP 1") == "0"
    bench.world.clock.sleep(1.0)
    assert bench.send("BEEP 1") == "1"


def test_the_near_bench_lies_within_the_vicra_volume(make_bench: MakeBench, pointer: TrackerTool) -> None:
    bench = make_bench(draw_scene("bench-near"), model=VICRA).ready()
    for handle, _ in enumerate(bench.world.scene.tracker.places, start=1):
        bench.track(pointer)
        tool, strays = bench.send("TX 1001").split("\n")
        assert tool.startswith(f"01{handle:02X}+")
        assert strays.startswith("030")
        bench.send("TSTOP ")
        bench.send(f"PDIS {handle:02X}")  # its place stays taken


def test_a_vicra_reports_its_own_identity_limits_and_volume(
    make_bench: MakeBench, pointer: TrackerTool
) -> None:
    bench = make_bench(model=VICRA).ready()
    assert bench.send("VER 4").split("\n") == [
        "Polaris Vicra Control Firmware",
        "NDI S/N: P6-00042",
        "Characterization Date: 06/05/24",
        "Freeze Tag: Polaris Vicra Rev 007.000",
        "Freeze Date: 01/04/10",
        "(C) Northern Digital Inc.",
    ]
    assert bench.send("VER 5") == "014"
    assert bench.value("Features.Firmware.Version") == "007.000.011"
    assert bench.send("SFLIST 02") == "6"
    assert bench.value("Features.Tools.Enabled Tools") == "6"
    assert bench.send("SFLIST 03").startswith("17-133600")
    assert bench.send("SFLIST 00") == "00000012"
    assert bench.send("VSEL 2") == "ERROR24"
    assert bench.send("IRATE 1") == "ERROR23"
    assert bench.send("IRATE 0") == "OKAY"
    assert bench.send("PHRQ *********001**") == "ERROR2F"
    bench.track(pointer)
    assert bench.send("TX 0001").startswith("0101MISSING00000071")  # 1.5 m is behind its volume
    assert bench.send("TX 0801").startswith("0101+")


def test_a_vega_is_a_spectra_of_another_name_and_accuracy_on_the_network(make_bench: MakeBench) -> None:
    bench = make_bench(model=VEGA).ready()
    assert bench.value("Features.Hardware.Model") == "Polaris Vega ST"
    assert bench.send("SFLIST 03").startswith("25-240000-153200-095000")
    assert bench.send("IRATE 2") == "OKAY"
    assert [volume.stated_mm for volume in VEGA.volumes] == [0.12, 0.15]

"""A fault is switched on in a running simulator, without touching its protocol link."""

from __future__ import annotations

from pathlib import Path
from queue import SimpleQueue

from user_commands import in_this_process, one_error

from drivers.ndi_polaris import PolarisTracker
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.control_port import ask_control_port
from ronna_hw.devices.readings import Validity
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.theatre import TheatreProcess
from sim.cli import app


def test_a_standalone_simulator_takes_faults_at_its_control_port() -> None:
    with ChildProcess("ronna-sim polaris", command("sim.cli", "polaris")) as unit:
        control = unit.ready["control"]
        config = DeviceConfig(
            driver="ndi_polaris",
            endpoint=unit.ready["endpoint"],
            options=PolarisTracker.conformance_options(),
        )
        tracker = PolarisTracker("tracker", config, HostClock())
        tracker.connect()
        tracker.configure()
        tracker.activate()
        assert tracker.read_frame().tools[0].validity is Validity.OK
        hide = ("fault", "tracker occlude tool robot_frame", "--control", control)
        assert in_this_process(app, *hide).returncode == 0
        assert _settles(tracker, Validity.MISSING)
        assert in_this_process(app, "fault", "--clear", "--control", control).returncode == 0
        assert _settles(tracker, Validity.OK)
        refused = in_this_process(app, "fault", "tea", "--control", control)
        assert refused.returncode == 2
        assert one_error(refused.stderr)[0].startswith("CTL-002")
        tracker.close()


def test_the_theatre_forwards_messages_of_the_pendant(tmp_path: Path) -> None:
    heard = SimpleQueue[str]()
    theatre = TheatreProcess("--scene", "mini", "--out", str(tmp_path), on_controller_message=heard.put)
    try:
        theatre.await_ready()
        answer = ask_control_port(theatre.control, "fault", line="robot emergency stop")
        assert answer["effect"].startswith("robot emergency stop, from theatre time 0.000 s on, until ")
        assert heard.get(timeout=5.0) == "pendant at 0.000 s: KSS00001 emergency stop"
    finally:
        theatre.end()


def test_without_a_fault_the_command_lists_all_kinds() -> None:
    listed = in_this_process(app, "fault")
    assert listed.returncode == 0
    assert "tracker occlude marker N" in listed.stdout


def _settles(tracker: PolarisTracker, validity: Validity) -> bool:
    return any(tracker.read_frame().tools[0].validity is validity for _ in range(100_000))

"""RSIPI, a client of KUKA's sensor interface, with the context for axes that it ships."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from RSIPI import RSIAPI, context  # type: ignore[import-untyped]
from RSIPI.fault_injection import suspended  # type: ignore[import-untyped]
from simulated_peer import address, clear, eventually, inject

STEPS, STEP_DEG = 50, 0.02
NEAR_DEG = 1e-3


def connected(mode: str = "absolute", **more: Any) -> Any:
    host, port = address("STREAM")
    text = Path(context("joints")).read_text("utf-8-sig")
    file = Path(tempfile.mkdtemp()) / "ethernet.xml"
    file.write_text(text.replace("10.10.10.10", host).replace("64000", str(port)))
    api = RSIAPI(str(file), rsi_mode=mode, **more)
    api.start()
    assert api.wait_for_connection(10.0)
    return api


def correct(api: Any, **values: dict[str, float]) -> None:
    sequence = api.client.publish_corrections(values)
    assert api.client.wait_correction_applied(sequence, timeout=5.0), "a correction is not sent"


def angle_deg(api: Any) -> float:
    return float(api.client.send_variables["AIPos"]["A1"])


def turn(api: Any) -> None:
    for step in range(1, STEPS + 1):
        correct(api, AKorr={"A1": STEP_DEG * step})


def rests(api: Any) -> bool:
    before_deg = angle_deg(api)
    time.sleep(0.2)  # many cycles: the arm follows its set-points with a delay
    return angle_deg(api) == before_deg


def turns_by_a_degree(api: Any, begun_deg: float) -> bool:
    return eventually(lambda: rests(api)) and abs(angle_deg(api) - begun_deg - STEPS * STEP_DEG) < NEAR_DEG


def reads_pose_and_axes() -> None:
    api = connected()
    assert eventually(lambda: api.motion.get_current_pose().get("Z"))
    assert api.client.send_variables["AIPos"]["A2"] == -75.0


def corrects_axes_by_absolute_angles() -> None:
    api = connected()
    begun_deg = angle_deg(api)
    turn(api)
    assert turns_by_a_degree(api, begun_deg)


def corrects_axes_by_steps() -> None:
    api = connected("relative")
    begun_deg = angle_deg(api)
    turn_by_steps(api)
    assert eventually(lambda: rests(api))
    assert angle_deg(api) > begun_deg + STEPS * STEP_DEG - NEAR_DEG
    late = api.client.send_variables["Delay"]["D"]  # of a busy computer: each may repeat a step
    assert angle_deg(api) < begun_deg + (STEPS + late) * STEP_DEG + NEAR_DEG


def turn_by_steps(api: Any) -> None:
    api.motion.execute_trajectory([{"A1": STEP_DEG}] * STEPS, space="joint", points="delta")


def corrects_the_position() -> None:
    api = connected()
    begun_mm = api.motion.get_current_pose()["Z"]
    for step in range(1, STEPS + 1):
        correct(api, RKorr={"Z": 0.1 * step})
    assert eventually(lambda: abs(api.motion.get_current_pose()["Z"] - begun_mm - 5.0) < 0.01)


def keeps_pace_with_cycles_of_12_ms() -> None:
    api = connected(cycle_time=0.012)
    begun_deg = angle_deg(api)
    turn(api)
    assert turns_by_a_degree(api, begun_deg)


def arrives_although_replies_are_lost() -> None:
    api = connected()
    begun_deg = angle_deg(api)
    inject("robot drop 20 %")
    turn(api)
    assert turns_by_a_degree(api, begun_deg)


def arrives_by_steps_although_replies_are_lost() -> None:
    api = connected("relative")
    begun_deg = angle_deg(api)
    inject("robot drop 20 %")
    turn_by_steps(api)
    assert turns_by_a_degree(api, begun_deg), "HOLDON of its context repeats steps for lost replies"


def arrives_although_it_was_halted() -> None:
    api = connected()
    begun_deg = angle_deg(api)
    with suspended(api.client.network_process.pid):
        time.sleep(0.15)  # the controller goes on for 100 cycles without a reply
    turn(api)
    assert turns_by_a_degree(api, begun_deg)


def tells_late_replies() -> None:
    api = connected()
    inject("robot drop 100 % for 0.1 s")
    assert eventually(lambda: api.client.send_variables["Delay"]["D"] > 0)


def tells_that_the_stream_has_ended() -> None:
    api = connected()
    inject("robot network cut")
    assert eventually(api.diagnostics.check_watchdog), "its watchdog stays silent"
    assert not api.diagnostics.is_healthy()


def holds_the_arm_when_stopped() -> None:
    api = connected()
    turn(api)
    api.safety.stop()
    held_deg = angle_deg(api)
    try:
        correct(api, AKorr={"A1": 2.0})
    except Exception:
        time.sleep(0.2)
    assert abs(angle_deg(api) - held_deg) < 1.0, "the arm moves although it was stopped"


def refuses_a_correction_beyond_its_limit() -> None:
    api = connected()
    api.safety.set_limit("AKorr.A1", -1.0, 1.0)
    try:
        correct(api, AKorr={"A1": 5.0})
    except Exception:
        return
    raise AssertionError("a correction beyond the limit is sent")


def is_served_again_after_a_new_start() -> None:
    first = connected()
    first.stop()
    api = connected()
    clear()
    begun_deg = angle_deg(api)
    turn(api)
    assert turns_by_a_degree(api, begun_deg)

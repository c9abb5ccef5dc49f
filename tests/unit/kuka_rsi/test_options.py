"""Wrong options, and contexts that are unsafe or lack feedback, are refused before anything is opened."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import tomli_w
from coded_errors import raises

from drivers.kuka_rsi.errors import BAD_OPTIONS, CONTEXT_UNUSABLE
from drivers.kuka_rsi.options import KukaOptions, load_usable_context, read_options
from ronna_hw.wire.kuka_context import load_context

OURS: dict[str, Any] = load_context().model_dump(mode="json", by_alias=True, exclude_none=True)
EXPLICIT = {"limits": "explicit", "lower_deg": [-9.0] * 6, "upper_deg": [9.0] * 6}


def _with(**changes: Any) -> dict[str, Any]:
    context = {**OURS, **changes}
    return {name: value for name, value in context.items() if value is not None}


def _holdon(value: int, *tags: str) -> list[dict[str, Any]]:
    return [{**e, "holdon": value if e["tag"] in tags else e["holdon"]} for e in OURS["receive"]]


AXES = tuple(f"AK.A{k}" for k in range(1, 7))


@pytest.mark.hazard(20)
@pytest.mark.parametrize(
    ("context", "reason"),
    [
        pytest.param(
            _with(program={**OURS["program"], "corrections": "relative"}),
            "relative with HOLDON 1",
            marks=pytest.mark.hazard(18),
        ),
        pytest.param(
            _with(receive=_holdon(0, *AXES)),
            "HOLDON 0: a lost reply would jump",
            marks=pytest.mark.hazard(18),
        ),
        (_with(receive=_holdon(1, "Stop")), "STOP has HOLDON 1"),
        (_with(stop=None), "no STOP object"),
        (_with(stop={"mode": "PathFast"}), "no STOP object of mode ExitMoveCorr"),
        (_with(wiring=[w for w in OURS["wiring"] if w["input"] != "A4"]), "AXISCORR is not wired for A4"),
        (_with(axis_correction=None), "limits of AXISCORR are missing"),
        (_with(axis_monitor=None), "limits of AXISCORRMON are missing"),
        (_with(axis_correction=EXPLICIT), "would clamp silently"),
        (_with(axis_monitor={"limits": "explicit", "max_deg": [6.0] * 6}), "wider than those of AXISCORRMON"),
        (_with(send=[e for e in OURS["send"] if e["tag"] != "DEF_Delay"]), "DEF_Delay is not sent"),
        (_with(send=[e for e in OURS["send"] if e["tag"] != "DEF_AIPos"]), "DEF_AIPos is not sent"),
        (_with(ethernet={**OURS["ethernet"], "precision": 1}), "Precision is 1"),
        (_with(ethernet={**OURS["ethernet"], "only_send": True}), "ONLYSEND"),
        (_with(program={**OURS["program"], "variant": "kr6_r900_2"}), "option variant is kr6_r900_sixx"),
    ],
)
def test_an_unsafe_context_is_refused_with_the_reason(
    tmp_path: Path, context: dict[str, Any], reason: str
) -> None:
    path = tmp_path / "context.toml"
    path.write_text(tomli_w.dumps(context))
    with raises(CONTEXT_UNUSABLE, match=reason) as refused:
        load_usable_context("robot.master", KukaOptions(context=path))
    assert str(path) in str(refused.value)


def test_all_reasons_are_reported_at_once(tmp_path: Path) -> None:
    path = tmp_path / "context.toml"
    path.write_text(tomli_w.dumps(_with(axis_correction=None, stop=None)))
    with raises(CONTEXT_UNUSABLE, match=r"no STOP object.*AXISCORR are missing"):
        load_usable_context("robot.master", KukaOptions(context=path))


def test_the_shipped_context_is_usable_with_both_cycle_times() -> None:
    assert load_usable_context("robot.master", KukaOptions()).program.cycle_ms == 4
    options = read_options("robot.master", {"cycle_ms": 12})
    assert load_usable_context("robot.master", options).program.cycle_ms == 12


def test_options_have_defaults_and_all_mistakes_are_reported() -> None:
    assert read_options("arm", {}).silence_limit_s == 0.25
    assert read_options("arm", {"variant": "kr6_r900_2"}).variant == "kr6_r900_2"
    with raises(BAD_OPTIONS, match="options have 3 mistakes") as caught:
        read_options("arm", {"variant": "kr16", "speed_fraction": 0.5, "speed": 1})
    assert caught.value.code == "RSI-013"
    assert caught.value.exit_code == 2
    with raises(BAD_OPTIONS, match="silence_limit_s: expected a valid number without quotes"):
        read_options("arm", {"silence_limit_s": "5"})
    with raises(BAD_OPTIONS, match="accept_unverified: expected a valid boolean without quotes"):
        read_options("arm", {"accept_unverified": "true"})


def test_a_line_speed_in_metres_per_second_is_refused() -> None:
    with raises(BAD_OPTIONS, match="line_speed_mm_s"):
        read_options("arm", {"line_speed_mm_s": 0.25})

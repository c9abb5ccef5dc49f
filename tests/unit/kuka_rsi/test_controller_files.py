"""The controller's files: the committed ones match the generator, and third-party software can read them."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from coded_errors import raises

from drivers.kuka_rsi.controller.generate import render
from ronna_hw.wire.kuka_context import (
    CONTEXT_INVALID,
    Feedback,
    SendElement,
    Wire,
    context_hash,
    load_context,
)
from ronna_hw.wire.kuka_eki import StateAttribute

FILES = Path(__file__).parents[3] / "drivers" / "kuka_rsi" / "controller" / "files"
CONTEXT = load_context()
MADE = render(CONTEXT)


def test_the_committed_files_match_the_generated_ones() -> None:
    assert {path.name for path in FILES.iterdir()} == set(MADE)
    for name, text in MADE.items():
        assert (FILES / name).read_bytes() == text.replace("\n", "\r\n").encode("ascii"), name


@pytest.mark.parametrize("name", sorted(MADE))
def test_every_file_carries_its_context_hash_and_all_but_dat_files_are_marked_untested(name: str) -> None:
    assert context_hash(CONTEXT) in MADE[name]
    if not name.endswith(".dat"):
        assert "UNTESTED ON HARDWARE" in MADE[name]
    assert len(name.split(".")[0]) < 20


def test_the_ethernet_file_declares_the_agreed_elements_in_order() -> None:
    root = ElementTree.fromstring(MADE["ronna_rsi_eth.xml"])
    assert root.findtext("CONFIG/SENTYPE") == CONTEXT.ethernet.sentype
    sent = [(e.get("TAG"), e.get("INDX")) for e in root.findall("SEND/ELEMENTS/ELEMENT")]
    assert sent == [(e.tag, str(e.indx)) for e in CONTEXT.all_send]
    received = [
        (e.get("TAG"), e.get("INDX"), e.get("HOLDON")) for e in root.findall("RECEIVE/ELEMENTS/ELEMENT")
    ]
    assert received == [(e.tag, str(e.indx), str(e.holdon)) for e in CONTEXT.receive]


def test_a_third_party_client_reads_the_ethernet_file(tmp_path: Path) -> None:
    path = tmp_path / "eth.xml"
    path.write_text(MADE["ronna_rsi_eth.xml"], "ascii")
    code = (
        "import sys; from RSIPI.config_parser import ConfigParser\n"
        "config = ConfigParser(sys.argv[1])\n"
        "network = config.get_network_settings()\n"
        "print(network['port'], network['sentype'], sorted(config.receive_variables))"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-W", "ignore", "-c", code, str(path)],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    last = done.stdout.splitlines()[-1]
    assert last.startswith("59152 KROSHU")
    assert "'AK'" in last
    assert "'Stop'" in last


def test_the_context_wires_each_channel_to_its_object() -> None:
    root = ElementTree.fromstring(MADE["ronna_rsi.rsi.xml"])
    wires = {
        (item.get("ObjType"), wire.get("InIdx")): wire.get("OutIdx")
        for item in root
        for wire in item.findall("Inputs/Input")
    }
    expected = {("AXISCORR", str(k)): str(k + 1) for k in range(1, 7)} | {("STOP", "1"): "1"}
    assert wires == expected
    parameters = {p.get("Name"): p.get("ParamValue") for p in root.iter("Parameter")}
    assert parameters["Timeout"] == "100"
    assert parameters["Precision"] == "4"
    assert parameters["ConfigFile"] == "ronna_rsi_eth.xml"
    assert parameters["Mode"] == "4"


def test_the_context_wires_feedback_to_its_channel() -> None:
    said = CONTEXT.model_copy(
        update={
            "send": (*CONTEXT.send, SendElement(tag="Stat", type="LONG", indx=5)),
            "feedback": (Feedback(indx=5, object="AXISCORR"),),
        }
    )
    made = render(said)
    ethernet = ElementTree.fromstring(made["ronna_rsi.rsi.xml"])[0]
    assert ethernet.get("ObjType") == "ETHERNET"
    (wire,) = ethernet.findall("Inputs/Input")
    assert dict(wire.attrib) == {"InIdx": "5", "OutObjID": "AXISCORR1", "OutIdx": "1"}
    assert '<ELEMENT TAG="Stat" TYPE="LONG" INDX="5"/>' in made["ronna_rsi_eth.xml"]
    assert ElementTree.fromstring(MADE["ronna_rsi.rsi.xml"])[0].find("Inputs") is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"feedback": (Feedback(indx=5, object="POSCORR"),)}, "no POSCORR"),
        ({"wiring": (*CONTEXT.wiring, Wire(indx=9, object="MAP2DIGOUT", input="In1"))}, "no MAP2DIGOUT"),
        ({"wiring": tuple(w for w in CONTEXT.wiring if w.input != "A4")}, "not complete"),
    ],
)
def test_a_context_that_the_files_cannot_express_is_refused(changes: dict[str, Any], words: str) -> None:
    with raises(CONTEXT_INVALID, match=words):
        render(CONTEXT.model_copy(update=changes))


def test_the_program_requests_the_agreed_mode_and_sets_every_limit() -> None:
    program = MADE["ronna_rsi.src"]
    assert "RSI_ON(#ABSOLUTE, #IPO_FAST)" in program
    for axis in range(1, 7):
        for name in (f"LowerLimA{axis}", f"UpperLimA{axis}", f"MaxA{axis}"):
            assert f'"{name}"' in program
    assert program.count(" IF ") == program.count("ENDIF")


def test_the_eki_program_sends_every_state_attribute() -> None:
    program, layout = MADE["ronna_eki.sub"], MADE["ronna_eki.xml"]
    for attribute in StateAttribute:
        assert f'"State/@{attribute.value}"' in program
        assert f'Tag="State/@{attribute.value}"' in layout
    assert len(re.findall(r"^\s+IF ", program, re.MULTILINE)) == program.count("ENDIF")
    assert len(re.findall(r"^DEF(?:FCT)? ", program, re.MULTILINE)) == len(
        re.findall(r"^END(?:FCT)?\s*$", program, re.MULTILINE)
    )
    order = [name for name in re.findall(r'Tag="State/@(\w+)"', layout)]
    assert order == [a.value for a in StateAttribute]

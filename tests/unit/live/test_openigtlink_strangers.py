"""OpenIGTLink server read by clients that we did not write: pyigtl, and the reference library in C++."""

from __future__ import annotations

import base64
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from documented import python_of
from igtl_reference import HEADERS, compile_reference_client, read_by_reference_client
from linked_case import AWAITED_S, EPOCH_NS, STANDING, TOOL_IN_RAS, LinkedCase, linked_case, moving
from painted_ct import write_series

from procedures.live.openigtlink.names import POSES, transform_name
from procedures.live.openigtlink.server import ServerOptions
from procedures.live.records import CameraPicture
from ronna_hw.wire.openigtlink import PORT

PAGE = "docs/how-to/records/live-poses-in-slicer.md"
EXAMPLES = Path(__file__).parents[3] / "examples" / "openigtlink"
VOXELS = np.full((3, 6, 4), -900, dtype=np.int16)
VOXELS[1, 2, 3] = 700
SPACING_MM = (2.0, 0.5, 0.25)  # of slices, rows, columns
ORIGIN_MM = (-20.0, -30.0, 40.0)
CENTRE_RAS_MM = (20.0 - 1.5 * 0.25, 30.0 - 2.5 * 0.5, 40.0 + 2.0)


@pytest.fixture
def case(tmp_path: Path) -> Iterator[LinkedCase]:
    series = write_series(tmp_path / "ct", VOXELS, SPACING_MM, origin_mm=ORIGIN_MM)
    with linked_case(ServerOptions(rate_hz=1000.0, ct=series)) as linked:
        linked.tell(*STANDING)
        yield linked


def import_pyigtl() -> Any:
    return pytest.importorskip("pyigtl", reason="proof not made: install the extra `strangers`")


@contextmanager
def pyigtl_client(port: int) -> Iterator[Any]:
    """A new object each time: it does not connect again, and knows only the last message of a name."""
    client = import_pyigtl().OpenIGTLinkClient("127.0.0.1", port)
    try:
        yield client
    finally:
        client.stop()


def test_pyigtl_reads_transforms_with_their_time(case: LinkedCase) -> None:
    with moving(case), pyigtl_client(case.port) as client:
        message = client.wait_for_message("ToolToRas", AWAITED_S)
    assert message.matrix[:3] == pytest.approx(np.array(TOOL_IN_RAS), abs=1e-6)
    assert message.timestamp == pytest.approx(EPOCH_NS / 1e9 + 2.5, abs=1e-3)


def test_pyigtl_reads_state_spheres_and_targets(case: LinkedCase) -> None:
    with pyigtl_client(case.port) as client:
        assert client.wait_for_message("RunState", AWAITED_S).string == "idle"
        spheres = client.wait_for_message("Spheres", AWAITED_S)
        targets = client.wait_for_message("Targets", AWAITED_S)
    assert (spheres.names, spheres.groups) == (["M1"], ["used, residual 0.25 mm"])
    assert spheres.positions[0] == pytest.approx([-1, -2, 3])
    assert targets.positions[0] == pytest.approx([-4, -5, 6])


def test_the_python_of_the_page_reads_the_tool(case: LinkedCase, capsys: pytest.CaptureFixture[str]) -> None:
    import_pyigtl()
    with moving(case):
        exec(python_of(PAGE).replace("18944", str(case.port)), {})
    assert "1700000002.5" in capsys.readouterr().out


def test_pyigtl_reads_metadata_once_it_has_sent_a_header_of_version_two(case: LinkedCase) -> None:
    question = import_pyigtl().StringMessage("", device_name="hello")
    question.header_version = 2
    with pyigtl_client(case.port) as client:
        assert client.wait_for_message("Spheres", AWAITED_S).metadata == {}
        client.send_message(question, wait=True)
        metadata = client.wait_for_message("Spheres", AWAITED_S).metadata
    assert (metadata["M1.residual_mm"], metadata["M1.used"]) == ("0.2500", "1")


def test_pyigtl_reads_the_ct_and_a_camera_picture(case: LinkedCase) -> None:
    pyigtl = import_pyigtl()
    pixels = np.full((8, 16), 40, dtype=np.uint8)
    pixels[:, 8:] = 200
    jpeg = cv2.imencode(".jpg", pixels)[1].tobytes()

    picture = CameraPicture(
        theatre_time_s=3.0, side="left", width=16, height=8, jpeg=base64.b64encode(jpeg).decode()
    )
    case.tell(picture)
    with pyigtl_client(case.port) as client:
        images = {}
        for name in ("CT", "CameraLeft"):
            question = pyigtl.ImageMessage(np.zeros((1, 1, 1), np.uint8), device_name=name)
            question._message_type = "GET_IMAGE"  # it has no class for questions
            client.send_message(question, wait=True)
            images[name] = client.wait_for_message(name, AWAITED_S)
    ct = images["CT"]
    assert np.array_equal(np.squeeze(ct.image), VOXELS)
    scaled = np.diag([-SPACING_MM[2], -SPACING_MM[1], SPACING_MM[0]])
    assert ct.ijk_to_world_matrix[:3, :3] == pytest.approx(scaled)
    assert np.squeeze(images["CameraLeft"].image) == pytest.approx(pixels, abs=3)


def test_the_scene_and_the_device_set_name_our_port_and_transforms_that_are_sent() -> None:
    scene = ElementTree.parse(EXAMPLES / "slicer-scene.mrml").getroot()
    device = ElementTree.parse(EXAMPLES / "plus-device-set.xml").getroot().find(".//Device")
    assert device is not None
    assert [one.get("serverPort") for one in scene] == [device.get("ServerPort")] == [str(PORT)]
    sent = {transform_name(child, parent) for child, parent in POSES}
    tools = {f"{one.get('Id')}To{device.get('ToolReferenceFrame')}" for one in device.iter("DataSource")}
    assert len(tools) == 3
    assert tools <= sent


needs_library = pytest.mark.skipif(
    shutil.which("g++") is None or not HEADERS.is_dir(),
    reason="proof not made: g++ and libopenigtlink-dev are not installed",
)


@needs_library
@pytest.mark.slow
def test_the_reference_library_reads_every_type(case: LinkedCase, tmp_path: Path) -> None:
    program = compile_reference_client(tmp_path)
    kinds = (
        "TRANSFORM",
        "TDATA",
        "QTDATA",
        "STATUS",
        "STRING",
        "POINT",
        "TRAJ",
        "IMAGE",
        "CAPABILITY",
        "RTS_TDATA",
    )
    with moving(case):
        code, rows = read_by_reference_client(program, case.port, *kinds)
    assert (code, [row for row in rows if not row.is_read]) == (0, [])
    said = {(row.kind, row.name): row.words for row in rows}
    assert numbers(said["TRANSFORM", "ToolToRas"]) == pytest.approx(np.ravel(TOOL_IN_RAS), abs=1e-5)
    tools = said["TDATA", "ronna-hw"]
    assert numbers(tools[tools.index("Tool") + 1 :][:12]) == pytest.approx(np.ravel(TOOL_IN_RAS), abs=1e-5)
    turned = said["QTDATA", "ronna-hw"]
    assert numbers(turned[turned.index("Robot") + 1 :][:7]) == pytest.approx(
        [-10, -20, 30, 0, 0, -(0.5**0.5), 0.5**0.5], abs=1e-5
    )
    assert said["STATUS", "tracker"] == ["18", "NDI-004", "fault:", "away.", "Look."]
    assert said["STRING", "RunState"] == ["idle"]
    assert said["POINT", "Spheres"][:1] + said["POINT", "Spheres"][-4:] == [
        "M1", "-1.000000", "-2.000000", "3.000000", "10.000000",
    ]  # fmt: skip
    assert said["POINT", "Targets"][0] == "T1"
    assert numbers(said["TRAJ", "Plan"][1:]) == [-1, -2, 3, -4, -5, 6]
    image = numbers(said["IMAGE", "CT"])
    assert image[:3] == [4, 6, 3]
    assert image[3:6] == pytest.approx(SPACING_MM[::-1])
    assert image[6:9] == pytest.approx(CENTRE_RAS_MM)
    assert image[9:] == [4, 1, VOXELS.sum()]  # int16, RAS
    assert {"TRANSFORM", "GET_IMAGE", "STT_TDATA"} <= set(said["CAPABILITY", "ronna-hw"])


def numbers(words: list[str]) -> list[float]:
    return [float(word) for word in words]

"""Checklist lines 35, 36 and 44 to 46: the measuring volume, tools outside it, strays."""

from __future__ import annotations

from conformance.case import CaseList, NotShown, check
from conformance.device_under_test import DeviceUnderTest
from conformance.polaris.client import PolarisLink, Vector3, idle_unit, place_markers
from conformance.polaris.fixtures import (
    NEEDS,
    SPECTRA_SHAPE,
    SPECTRA_VOLUMES,
    VICRA_SHAPE,
    WITH_TOOL,
    StatedVolume,
    definition,
    measuring_volumes,
    read_frame,
    read_markers,
    shift_origin,
    unit_with_tool,
    volume_in_use,
)
from ronna_hw.wire import polaris_rom as layout
from ronna_hw.wire.polaris import MAXIMUM_STRAYS, HandleStatus, PortStatus

BEYOND_MM = 130.0  # beyond the volume's side but still in view; more than half a tool
STRAY_FRAMES = 20  # frames to check when one proves little
EDGE_MM = 3.0  # closer to a face, noise decides
READ_ONLY = "Features.Firmware.Version=0"

CASES = CaseList()
case = CASES.case
on_unit = CASES.within(idle_unit, *NEEDS)
on_tool = CASES.within(unit_with_tool, *WITH_TOOL)


@on_tool("P35", "without option 0800 a tool out of the volume is MISSING, with status bit 0040")
def out_of_volume_is_missing(unit: PolarisLink) -> None:
    volume = volume_in_use(unit)
    z_mm = volume.middle_mm
    x_mm, _ = volume.half_extents_mm(z_mm)
    _load_at(unit, unit.definition, (x_mm + BEYOND_MM, 0.0, z_mm))
    shown = read_frame(unit, 0x0801).handles[0]
    withheld = read_frame(unit, 0x0001).handles[0]
    if not shown.outside:
        raise NotShown("this unit cannot be shown a tool outside its volume")
    check(shown.pose is not None, "a pose with option 0800", shown)
    check(withheld.status is HandleStatus.MISSING, "MISSING without option 0800", withheld)
    check(withheld.outside, "status bit 0040", f"{withheld.port_status:04X}")


@case(
    "P36",
    "strays are reported only while a passive tool is enabled; their flags are correct",
    needs=WITH_TOOL,
)
def strays_need_illuminators(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    with idle_unit(dut) as unit:
        unit.expect_okay("TSTART:80")
        check(unit.ask_binary("BX:1801")[:2] == b"\0\0", "no handles and no strays")
        unit.expect_okay("TSTOP:")
        volume = volume_in_use(unit)
        unit.load_tool(block)
        unit.expect_okay("TSTART:80")
        flags = _check_strays(dut, unit, volume)
    if not flags:
        raise NotShown("no stray marker is in view")


@on_unit("P44", "GET of an unknown parameter returns ERROR34, SET of a read-only one ERROR39")
def unknown_parameter(unit: PolarisLink) -> None:
    unit.refused("GET:No.Such Parameter", 0x34)
    before = unit.ask("GET:Features.Firmware.Version")
    unit.refused(f"SET:{READ_ONLY}", 0x39)
    check(unit.ask("GET:Features.Firmware.Version") == before, "an unchanged value")


@case(
    "P45", "SFLIST 03 returns each volume in 74 characters, those of a Spectra with its numbers", needs=NEEDS
)
def volumes_are_reported(dut: DeviceUnderTest) -> None:
    with idle_unit(dut) as unit:
        model = unit.ask("VER:4").upper()
        volumes = measuring_volumes(unit)
    if "SPECTRA" in model:
        check({volume.shape for volume in volumes} == {SPECTRA_SHAPE}, "shape 5", volumes)
        found = tuple(volume.numbers for volume in volumes)
        check(found == SPECTRA_VOLUMES, "pyramid and extended pyramid", found)
    elif "VICRA" in model:
        check([volume.shape for volume in volumes] == [VICRA_SHAPE], "one volume of shape 7", volumes)


@case("P46", "the status bits of a tool follow from its markers and the volume's formulas", needs=WITH_TOOL)
def volume_formulas(dut: DeviceUnderTest) -> None:
    block = definition(dut)
    minimum = block[layout.MINIMUM_MARKER_COUNT_OFFSET]
    with idle_unit(dut) as unit, unit.fast_baud():
        volume = volume_in_use(unit)
        checked_bits = set()
        for target_mm in _test_points(volume):
            markers_mm = _load_at(unit, block, target_mm)
            reading = read_frame(unit, 0x0801).handles[0]
            unit.expect_okay("TSTOP:")
            unit.expect_okay(f"PHF:{reading.handle}")
            if reading.pose is None:
                continue
            clearances = [volume.clearance_mm(marker) for marker in place_markers(markers_mm, reading.pose)]
            if min(abs(clearance) for clearance in clearances) < EDGE_MM:
                continue
            inside = sum(clearance > 0 for clearance in clearances)
            wanted = 0 if inside >= minimum else PortStatus.PARTIALLY_OUT_OF_VOLUME
            wanted = wanted if inside else PortStatus.OUT_OF_VOLUME
            bits = reading.port_status & (PortStatus.OUT_OF_VOLUME | PortStatus.PARTIALLY_OUT_OF_VOLUME)
            check(bits == wanted, f"status bits {wanted:04X} with {inside} markers inside", f"{bits:04X}")
            checked_bits.add(wanted)
        if not checked_bits:
            raise NotShown("the tool is not in view, or too close to a face of the volume")


def _check_strays(dut: DeviceUnderTest, unit: PolarisLink, volume: StatedVolume) -> set[bool]:
    """Check the stray flags against the volume, except near its faces; returns the expected flags."""
    orders = {"low bit first", "high bit first"}
    found: set[bool] = set()
    for _ in range(STRAY_FRAMES):
        frame = read_frame(unit, 0x1801)
        check(len(frame.strays_outside) <= MAXIMUM_STRAYS, "at most 50 strays", len(frame.strays_outside))
        clearances = [volume.clearance_mm(position) for position in frame.strays_mm]
        clear = [index for index, clearance_mm in enumerate(clearances) if abs(clearance_mm) > EDGE_MM]
        found |= {clearances[index] < 0 for index in clear}
        flags = {"low bit first": frame.strays_outside, "high bit first": frame.strays_outside_mirrored}
        orders &= {name for name, bits in flags.items() if all(bits[k] == (clearances[k] < 0) for k in clear)}
        check(bool(orders), "right flags in one bit order", frame)
        dut.clock.sleep(1 / 60)
    return found


def _test_points(volume: StatedVolume) -> list[Vector3]:
    """Return test points at the centre and just inside and outside the faces."""
    far_mm, near_mm = volume.depths_mm
    middle_mm = volume.middle_mm
    places: list[Vector3] = [(0.0, 0.0, middle_mm)]
    for z_mm in ((near_mm + middle_mm) / 2, (middle_mm + far_mm) / 2):
        x_mm, y_mm = volume.half_extents_mm(z_mm)
        for beyond_mm in (-BEYOND_MM, BEYOND_MM):
            places += [(x_mm + beyond_mm, 0.0, z_mm), (0.0, -y_mm - beyond_mm, z_mm)]
    return [*places, (0.0, 0.0, far_mm + BEYOND_MM), (0.0, 0.0, far_mm - BEYOND_MM)]


def _load_at(unit: PolarisLink, block: bytes, target_mm: Vector3) -> tuple[Vector3, ...]:
    """Load a tool with its origin chosen so that its markers surround a point in the tracker frame.

    A simulated unit places the origin at the tool's fixed place; a real one finds the spheres where they are,
    so the cases check that position. Leaves the unit tracking; returns the markers of the definition.
    """
    handle = unit.load_tool(shift_origin(block))
    unit.expect_okay("TSTART:80")
    pose = read_frame(unit, 0x0801).handles[0].pose
    unit.expect_okay("TSTOP:")
    if pose is None:
        raise NotShown("the tool is not in view")
    unit.expect_okay(f"PHF:{handle}")
    markers = place_markers(read_markers(block), pose)
    translation_mm = [
        target - sum(axis) / len(axis)
        for target, axis in zip(target_mm, zip(*markers, strict=True), strict=True)
    ]
    # the same direction in the tool's own frame: the conjugate rotation
    back = (pose[0], -pose[1], -pose[2], -pose[3], 0.0, 0.0, 0.0, 0.0)
    moved = shift_origin(
        block, place_markers(((translation_mm[0], translation_mm[1], translation_mm[2]),), back)[0]
    )
    unit.load_tool(moved)
    unit.expect_okay("TSTART:80")
    return read_markers(moved)

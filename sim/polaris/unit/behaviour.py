"""Named parameters for unit behaviour that public sources leave open.

Defaults are best estimates. A driver must work with every alternative; `ronna-sim polaris --set NAME=VALUE`
selects one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from sim.named_parameters import NamedParameters
from sim.polaris.errors import BAD_UNIT_PARAMETER
from sim.polaris.unit.refusal import NdiErrorCode


@dataclass(frozen=True, kw_only=True)
class UnitBehaviour(NamedParameters):
    """Unit behaviour on which public sources are silent or disagree."""

    refusal = BAD_UNIT_PARAMETER

    # line
    enforces_line: Annotated[
        bool, "A serial host with another baud rate or with odd parity is not understood."
    ] = True
    wrong_line: Annotated[
        Literal["silence", "garbage"], "Bytes received by a host with wrong line settings."
    ] = "silence"
    line_after_close: Annotated[
        Literal["default", "kept"], "Line settings after the last host closed a pseudo-terminal."
    ] = "default"
    power_up_reset: Annotated[bool, "The unit sends RESET on a serial line at power-up."] = True
    break_from_flush: Annotated[
        bool, "A pseudo-terminal has no break condition: a flush of both directions acts as one."
    ] = True
    break_silence_s: Annotated[
        float, "Silence after which such a flush is a break; a host that only flushes keeps sending."
    ] = 0.1
    break_deaf_s: Annotated[float, "Time after an open during which such a flush is not a break."] = 0.05
    silent_host_s: Annotated[
        float,
        "A network host without an accepted command for this long yields to a waiting one; a host that "
        "reads no reply for this long, or for 5 s, is disconnected. How many hosts a unit serves, and for "
        "how long, is not public.",
    ] = 10.0
    reset_s: Annotated[
        float,
        "Time from a break, a power cycle or a watchdog reset to RESET; seconds on a real unit.",
    ] = 0.1
    malformed_line_settings: Annotated[NdiErrorCode, "Error of COMM with an unknown code: 23 or 07."] = (
        NdiErrorCode.OUT_OF_RANGE
    )
    accepts_lower_case: Annotated[bool, "Command names in lower case are accepted."] = False
    strips_eighth_bit: Annotated[bool, "With 7 data bits, a BX reply loses its eighth bits."] = True

    # state machine
    answers_before_init: Annotated[
        bool, "VER, COMM, GET and the like are answered before INIT, not refused with 10."
    ] = True
    identity_while_tracking: Annotated[
        bool, "VER and COMM are answered while tracking, not refused with 0C."
    ] = True
    settings_while_tracking: Annotated[
        bool, "SAVE, SFLIST, VSEL and the like are allowed while tracking, not refused with 0C."
    ] = False
    settings_in_diagnostic: Annotated[
        bool, "SET, SAVE, SFLIST and the like are allowed in diagnostic mode."
    ] = True
    handles_in_diagnostic: Annotated[bool, "PHSR, PINIT and the like are allowed in diagnostic mode."] = False
    init_forgets_handles: Annotated[bool, "INIT frees all port handles."] = True
    starts_without_tools: Annotated[bool, "TSTART without an enabled tool is OKAY, not refused with 12."] = (
        True
    )
    most_tracked: Annotated[int, "TSTART with more enabled tools returns 28."] = 15
    hardware_fault_at_init: Annotated[
        Literal["WARNING01", "ERROR15", "ERROR1A", "OKAY"], "Reply to INIT with a hardware alert."
    ] = "WARNING01"
    starts_with_hardware_fault: Annotated[
        bool, "TSTART with a hardware alert is OKAY, not refused with 12."
    ] = False
    watch_dog: Annotated[
        Literal["stop", "reset"], "Effect of the watchdog: stop tracking, or reset the unit."
    ] = "stop"
    beep_s: Annotated[float, "Length of a beep; BEEP returns 0 while the previous one lasts."] = 0.0
    absent_command: Annotated[
        NdiErrorCode, "GETIO, SETIO, GX and others without a public format: 33 or 01."
    ] = NdiErrorCode.NOT_AVAILABLE
    unknown_feature_list: Annotated[NdiErrorCode, "Error of SFLIST with an unknown list: 23 or 25."] = (
        NdiErrorCode.OUT_OF_RANGE
    )

    # tools
    bad_definition: Annotated[
        NdiErrorCode, "Error of PINIT for a wrong checksum or content: 13, on newer firmware 40."
    ] = NdiErrorCode.BAD_DEFINITION
    definition_beyond_limits: Annotated[
        NdiErrorCode,
        "Error of PINIT for too many or too few markers, faces or groups: 13, on newer firmware 41.",
    ] = NdiErrorCode.BAD_DEFINITION
    warns_with_code: Annotated[bool, "WARNING carries two digits; older firmware sends WARNING alone."] = True
    segment_tolerance_mm: Annotated[
        float,
        "Segments of one tool within this length difference violate unique geometry; NDI uses 5 mm steps.",
    ] = 3.0
    conflict: Annotated[
        Literal["segment", "triangle"],
        "Two tools conflict if they share one segment, or the three of a triangle.",
    ] = "triangle"
    conflict_tolerance_mm: Annotated[
        float, "Segments of two tools within this length difference count as shared."
    ] = 2.0
    judges_only_flagged: Annotated[
        bool, "These rules apply only to definitions with the unique-geometry flag."
    ] = False
    supported_wavelengths: Annotated[
        str, "Wavelength codes of markers that the volumes support; others make TSTART return 22."
    ] = "01"
    memory_of_passive: Annotated[
        Literal["32", "1E/1F"], "PPRD and PPWR of a handle without memory: 32, or 1E and 1F."
    ] = "32"
    serial_low_byte_first: Annotated[
        bool, "PHINF sends the serial number of a definition as a number, not byte by byte."
    ] = True
    accessories_of_passive: Annotated[
        bool, "PHINF 0008 reports the tool-in-port entry of a passive definition."
    ] = False
    replaces_definition_by_test: Annotated[
        bool, "TTCFG replaces the memory of a wired tool, not refused with 32."
    ] = False
    port_change_until: Annotated[
        Literal["search", "reply"], "System status 0040/0080 stays until PHSR, or for one reply."
    ] = "search"

    # TX and BX
    poses_partially_out: Annotated[
        bool, "A pose is reported when some markers, but fewer than the minimum, are inside the volume."
    ] = True
    lists_disabled_handles: Annotated[bool, "Initialised but not enabled handles are listed as DISABLED."] = (
        False
    )
    status_of_unseen_handles: Annotated[
        bool, "TX sends status and frame of DISABLED and UNOCCUPIED handles too."
    ] = False
    first_stray_is_high_bit: Annotated[
        bool, "TX: the out-of-volume digits are one number, stray 0 its highest bit."
    ] = True
    first_stray_is_low_bit: Annotated[
        bool, "BX: stray 0 is the lowest bit of the first out-of-volume byte, not the highest."
    ] = True
    first_marker_is_first_digit: Annotated[bool, "TX option 0002 begins with marker 0."] = True
    first_marker_is_first_nibble: Annotated[bool, "BX option 0002 begins with marker 0."] = False
    text_tool_markers: Annotated[bool, "TX has option 0008 (markers of tools), not refused with 23."] = False
    text_active_stray: Annotated[
        Literal["status", "words"], "TX option 0004: two digits of status before a position, or words."
    ] = "status"
    binary_active_stray_always: Annotated[bool, "BX option 0004 always sends 12 bytes of position."] = True

    # identity and the rest
    freeze_tag_with_minor: Annotated[
        bool, "The freeze tag ends in 007.000; without the minor some clients use TX."
    ] = True
    saved_illuminator_rate: Annotated[
        int, "Saved illuminator rate at power-up: 0 = 20 Hz, 1 = 30 Hz, 2 = 60 Hz."
    ] = 0
    user_memory_bytes: Annotated[int, "Size of the user area of a wired tool's memory."] = 1024
    line_separation_mm: Annotated[float, "Line separation reported by 3D for every marker."] = 0.05

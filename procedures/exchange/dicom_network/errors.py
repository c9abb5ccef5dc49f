"""Errors of the DICOM network, DCM-001 to DCM-014."""

from __future__ import annotations

from ronna_hw.errors import (
    EXIT_USAGE,
    ConfigurationError,
    ConnectError,
    DataError,
    ErrorCode,
    ProtocolError,
    RefusedError,
    RonnaError,
)

NETWORK_MISSING = ErrorCode(
    "DCM-001",
    RonnaError,
    "The packages for the DICOM network are not installed.",
    "Run make setup in the clone, or in its environment: pip install 'ronna-hw[dicom]'.",
    own_exit_code=EXIT_USAGE,
)

BAD_ADDRESS = ErrorCode(
    "DCM-002",
    ConfigurationError,
    "An AE title or the address of a DICOM peer is invalid.",
    "Give AETITLE@HOST:PORT, such as ORTHANC@192.168.7.2:4242; an AE title has 1 to 16 characters.",
)

CALLERS_UNNAMED = ErrorCode(
    "DCM-003",
    RefusedError,
    "A receiver that other computers can reach has no list of callers.",
    "Name each sender's AE title with --allow. DICOM has no passwords: use TLS where the hospital has it.",
)

TLS_UNUSABLE = ErrorCode(
    "DCM-004",
    ConfigurationError,
    "The files for TLS are missing, unreadable or do not belong together.",
    "Give --tls-cert, --tls-key and --tls-ca together: PEM files of this computer and of the hospital's CA.",
)

NO_PEER = ErrorCode(
    "DCM-005",
    ConnectError,
    "The DICOM peer does not answer at this address.",
    "Check address and port, the firewall between, and whether the peer expects TLS.",
)

ASSOCIATION_REFUSED = ErrorCode(
    "DCM-006",
    ConnectError,
    "The DICOM peer refused the association or what it was asked for.",
    "Have both AE titles, and address and port of this computer, entered at the peer.",
)

REQUEST_FAILED = ErrorCode(
    "DCM-007",
    ProtocolError,
    "The DICOM peer answered a request with an error, or no more.",
    "Look into the log of the peer for this time.",
)

NOT_ALL_ARRIVED = ErrorCode(
    "DCM-008",
    DataError,
    "Fewer slices of a series have arrived than its source has.",
    "Have the series sent again; slices that are here already are replaced by the same ones.",
)

OBJECT_REFUSED = ErrorCode(
    "DCM-009",
    DataError,
    "A received object is truncated, forged, or does not fit its series.",
    "Nothing of it was kept. Have the series sent again from its source, and see whether it repeats.",
)

NO_ROOM = ErrorCode(
    "DCM-010",
    DataError,
    "The disk of the inbox is nearly full; received objects are refused.",
    "Make room there and have the series sent again; the slices that are there are complete.",
)

NOT_IN_INBOX = ErrorCode(
    "DCM-011",
    DataError,
    "The inbox has no such series, or several that begin alike.",
    "ronna-dicom inbox DIR lists them; give the name of one.",
)

NOT_READY_TO_TAKE = ErrorCode(
    "DCM-012",
    RefusedError,
    "A series cannot be taken in the state that it is in.",
    "Wait for its end, or have the missing slices sent again; ronna-dicom inbox DIR shows its state.",
)

READ_BACK_DIFFERS = ErrorCode(
    "DCM-013",
    RefusedError,
    "A value that was read back is not the one of the series; nothing was taken.",
    "Compare with the patient's papers: case, spaces and zeros count. Perhaps it is another patient's CT, "
    "or slices are missing: then have the series sent again.",
)

NOT_SENDABLE = ErrorCode(
    "DCM-014",
    RefusedError,
    "Objects without a patient or a study, or of several patients, are not sent.",
    "Export the run into the study of its CT: ronna-procedure export RUN --identity-from CT --out DIR. "
    "Send one patient's objects at a time.",
)

"""Errors of the simulated theatre."""

from __future__ import annotations

import errno

from ronna_hw.errors import ConfigurationError, ConnectError, DataError, ErrorCode, RefusedError

SEE_PHANTOM = "See ronna-sim phantom --help."  # advice for its options


BAD_SCENE = ErrorCode(
    "SIM-001",
    ConfigurationError,
    "A scene file is missing or invalid.",
    "Correct the scene file, or name one of default, mini, bench.",
)


WORLD_UNAVAILABLE = ErrorCode(
    "SIM-002",
    ConnectError,
    "The shared scene of a theatre cannot be opened.",
    "Start the theatre again; a device process cannot outlive it.",
)


class BadFaultScript(ConfigurationError):
    """A fault script contains an invalid line."""

    code = "SIM-003"
    action = "Write it like: at 12.5 s: tracker occlude marker 3 for 2 s."


class EndpointTaken(ConnectError):
    """The listening address of a simulated device is in use."""

    code = "SIM-004"
    action = "Choose another endpoint, or end the program that uses it."

    @classmethod
    def from_system(
        cls, error: OSError, endpoint: str, *, holder: object = None, action: str = ""
    ) -> EndpointTaken:
        """Explain why an endpoint cannot be listened on; `holder` names the program that uses it."""
        if error.errno == errno.EADDRNOTAVAIL:
            return cls(
                f"cannot listen on {endpoint}: it is no address of this computer",
                action="Give one of its addresses, such as one in 127.0.0.0/8: `ip address` lists them.",
            )
        reason = (error.strerror or str(error)).lower()
        if error.errno == errno.EADDRINUSE:
            reason = f"in use by {holder}" if holder else "in use"
        return cls(f"cannot listen on {endpoint}: {reason}", action=action or cls.action)


NOTHING_TO_VERIFY = ErrorCode(
    "SIM-006",
    DataError,
    "A run folder contains nothing to compare with the ground truth.",
    "Give the folder of a run made with --sim that reached a target, or add --theatre DIR.",
)


BAD_TRUTH = ErrorCode(
    "SIM-007",
    DataError,
    "The truth samples in a run folder cannot be read.",
    "The file was changed or truncated after the run; repeat the run.",
)


BAD_DEVICE_PARAMETER = ErrorCode(
    "SIM-010",
    ConfigurationError,
    "A device parameter of the theatre is invalid.",
    "Write --set robot.NAME=VALUE, or assistant or tracker in place of robot.",
)


FOLDER_NOT_EMPTY = ErrorCode(
    "SIM-011",
    ConfigurationError,
    "The folder for a phantom case is not empty.",
    "Give a new or empty folder, or delete this one.",
)


BAD_SAVED_WORLD = ErrorCode(
    "SIM-012",
    DataError,
    "The saved world of the last theatre cannot be read.",
    (
        "Put the file back from a copy; without one this world is lost: start a new run, or a theatre "
        "without --continue."
    ),
)


BAD_CALIBRATION_FILE = ErrorCode(
    "SIM-014",
    DataError,
    "A theatre's calibration record file cannot be read or contains no records.",
    "Give the folder that a calibration command wrote, or its calibration.toml.",
)


STAND_NOT_READY = ErrorCode(
    "SIM-015",
    RefusedError,
    "The dials of the calibration stand cannot be read in its present state.",
    "Put the divot on the stand, mount the guide and bring its tip to the divot.",
)


BAD_CART_MOVE = ErrorCode(
    "SIM-016",
    ConfigurationError,
    "The cart of an arm cannot be moved as asked: no such cart, or no such move.",
    "Give a cart of the theatre and a move within the room, such as: move cart 1 --by 60 -40 0 --turn 5.",
)


INSTRUMENT_IN_GUIDE = ErrorCode(
    "SIM-017",
    RefusedError,
    "The cart would be moved with an instrument in the guide, and in the head.",
    "Take it out first: ronna-sim work out. To rehearse exactly this accident, add --anyway.",
)


THEATRE_RUNNING = ErrorCode(
    "SIM-013",
    ConnectError,
    "Another theatre is already running in this folder.",
    "Stop the other theatre, or give another folder.",
)


class RegisterNotOwn(RefusedError):
    """The folder with the register of running simulators does not belong to this account alone."""

    code = "SIM-019"
    action = (
        "Set XDG_RUNTIME_DIR, or TMPDIR, to a folder of your own (mode 700) in each terminal, and repeat; "
        "simulators that run without a register are not listed."
    )


NOT_RUNNING = ErrorCode(
    "SIM-018",
    RefusedError,
    "No running simulator, or more than one, is meant; or it cannot be stopped from here.",
    "ronna-sim list shows what is running.",
)


NO_SUCH_SIMULATOR = ErrorCode(
    "SIM-020",
    ConfigurationError,
    "A test asks for a simulator that does not exist.",
    "Give polaris, kuka, ur, basler or theatre.",
)


NO_FREE_ADDRESS = ErrorCode(
    "SIM-021",
    ConnectError,
    "No address is left for one more simulator of this process.",
    "Stop one of the others: `simulator.stop()`, or let its fixture end.",
)

"""Features of the acquisition: start and stop, rate, triggers."""

from __future__ import annotations

from sim.basler.camera.features import Commands, Feature, Kind, always, setting, trigger_setting
from sim.basler.camera.settings import AcquisitionMode, Trigger, TriggerSource
from sim.basler.camera.timing import free_running_period_us

FRAME_RATE_RANGE_HZ = (0.1, 1000.0)
LONGEST_TRIGGER_DELAY_US = 1_000_000.0
MOST_FRAMES_PER_ACQUISITION = 255
OFF_ON = {"Off": 0, "On": 1}
FRAME_TRIGGER_WAIT, ACQUISITION_ACTIVE = 0, 1


def _status(commands: Commands) -> int:
    if commands.settings.status_selector == FRAME_TRIGGER_WAIT:
        return int(commands.acquisition.awaits_trigger)
    return int(commands.acquiring)


def _start(commands: Commands, _value: int) -> None:
    commands.acquisition.start()


def _stop(commands: Commands, _value: int) -> None:
    commands.acquisition.stop()


CONTROL = "AcquisitionTrigger"
ACQUISITION_FEATURES: tuple[Feature, ...] = (
    setting(
        "AcquisitionMode",
        CONTROL,
        "Acquisition mode.",
        "acquisition_mode",
        kind=Kind.ENUMERATION,
        entries={"SingleFrame": AcquisitionMode.SINGLE_FRAME, "Continuous": AcquisitionMode.CONTINUOUS},
        locked=True,
    ),
    Feature("AcquisitionStart", Kind.COMMAND, CONTROL, "Start the acquisition of frames.", write=_start),
    Feature("AcquisitionStop", Kind.COMMAND, CONTROL, "Stop the acquisition of frames.", write=_stop),
    Feature(
        "AcquisitionAbort", Kind.COMMAND, CONTROL, "Stop the acquisition of frames at once.", write=_stop
    ),
    setting(
        "AcquisitionFrameCount",
        CONTROL,
        "Frames that one AcquisitionStart trigger permits.",
        "acquisition_frame_count",
        minimum=always(1),
        maximum=always(MOST_FRAMES_PER_ACQUISITION),
    ),
    setting(
        "AcquisitionFrameRateEnable",
        CONTROL,
        "Limit the rate of the free-running camera.",
        "frame_rate_enabled",
        kind=Kind.BOOLEAN,
    ),
    setting(
        "AcquisitionFrameRateAbs",
        CONTROL,
        "Requested rate of the free-running camera.",
        "frame_rate_hz",
        kind=Kind.FLOAT,
        minimum=always(FRAME_RATE_RANGE_HZ[0]),
        maximum=always(FRAME_RATE_RANGE_HZ[1]),
        unit="Hz",
    ),
    Feature(
        "ResultingFrameRateAbs",
        Kind.FLOAT,
        CONTROL,
        "Rate allowed by exposure, read-out, link and requested rate.",
        read=lambda commands: 1e6 / free_running_period_us(commands.settings),
        unit="Hz",
    ),
    setting(
        "AcquisitionStatusSelector",
        CONTROL,
        "Status shown by AcquisitionStatus.",
        "status_selector",
        kind=Kind.ENUMERATION,
        entries={"FrameTriggerWait": FRAME_TRIGGER_WAIT, "AcquisitionActive": ACQUISITION_ACTIVE},
        selects=("AcquisitionStatus",),
    ),
    Feature("AcquisitionStatus", Kind.BOOLEAN, CONTROL, "The selected status.", read=_status),
    setting(
        "TriggerSelector",
        CONTROL,
        "Trigger to which the following features apply.",
        "trigger_selector",
        kind=Kind.ENUMERATION,
        entries={"AcquisitionStart": Trigger.ACQUISITION_START, "FrameStart": Trigger.FRAME_START},
        selects=("TriggerMode", "TriggerSource", "TriggerActivation", "TriggerDelayAbs", "TriggerSoftware"),
    ),
    trigger_setting(
        "TriggerMode", "Wait for the selected trigger.", "mode", Kind.ENUMERATION, entries=OFF_ON
    ),
    trigger_setting(
        "TriggerSource",
        "Source of the selected trigger.",
        "source",
        Kind.ENUMERATION,
        entries={
            "Software": TriggerSource.SOFTWARE,
            "Line1": TriggerSource.LINE_1,
            "Action1": TriggerSource.ACTION_1,
        },
    ),
    trigger_setting(
        "TriggerActivation",
        "Edge of a line's signal.",
        "activation",
        Kind.ENUMERATION,
        entries={"RisingEdge": 0, "FallingEdge": 1},
    ),
    trigger_setting(
        "TriggerDelayAbs",
        "Time from the trigger to the exposure.",
        "delay_us",
        Kind.FLOAT,
        minimum=always(0.0),
        maximum=always(LONGEST_TRIGGER_DELAY_US),
        unit="us",
    ),
    Feature(
        "TriggerSoftware",
        Kind.COMMAND,
        CONTROL,
        "Fire the selected trigger.",
        write=lambda it, _: it.acquisition.software_trigger(),
    ),
    Feature(
        "OvertriggerCount",
        Kind.INTEGER,
        CONTROL,
        "Frame triggers missed since AcquisitionStart because the camera was busy.",
        read=lambda commands: commands.acquisition.missed_triggers,
        visibility="Guru",
    ),
)

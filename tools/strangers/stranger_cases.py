"""Protocols and their cases: behaviour that both sides need, whoever has written it.

The name of a case is that of a function in the program of a stranger. A program without it is not asked.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Case:
    """Behaviour of a client; `options` are further ones of the simulator."""

    name: str
    options: tuple[str, ...] = ()

    @property
    def words(self) -> str:
        """The name as a sentence."""
        return self.name.replace("_", " ")


@dataclass(frozen=True)
class Protocol:
    """Protocol with its cases, and the command of `ronna-sim` for it; empty if a program needs none.

    `heading` heads the column of cases.
    """

    title: str
    simulator: tuple[str, ...]
    cases: tuple[Case, ...] = field(repr=False)
    heading: str = "a client ..."


POLARIS = Protocol(
    "NDI Polaris",
    ("polaris",),
    (
        Case("connects_by_network"),
        Case("connects_by_serial_line", ("--endpoint", "serial-pty")),
        Case("reads_a_tool_as_text", ("--set", "freeze_tag_with_minor=false")),
        Case("reads_a_tool_as_binary"),
        Case("reads_three_tools_as_text", ("--set", "freeze_tag_with_minor=false")),
        Case("reads_three_tools_as_binary"),
        Case("reads_frame_numbers"),
        Case("reads_strays"),
        Case("says_that_a_tool_is_hidden"),
        Case("says_that_a_tool_is_hidden_when_it_averages"),
        Case("reads_the_status_of_a_tool_at_the_edge"),
        Case("tells_that_the_unit_was_bumped"),
        Case("tells_errors_by_their_code"),
        Case("tells_warnings"),
        Case("refuses_garbled_replies"),
        Case("survives_noise_on_the_line"),
        Case("survives_noise_in_binary_replies"),
        Case("gives_up_when_no_reply_comes"),
        Case("gives_up_when_no_reply_comes_on_a_serial_line", ("--endpoint", "serial-pty")),
        Case("gives_up_when_the_unit_has_gone"),
    ),
)

KUKA_RSI = Protocol(
    "KUKA RSI",
    ("kuka", "--autostart"),
    (
        Case("reads_pose_and_axes"),
        Case("corrects_axes_by_absolute_angles", ("--corrections", "absolute")),
        Case("corrects_axes_by_steps", ("--corrections", "relative")),
        Case("corrects_the_position", ("--corrections", "absolute")),
        Case("keeps_pace_with_cycles_of_12_ms", ("--corrections", "absolute", "--cycle-ms", "12")),
        Case("arrives_although_replies_are_lost", ("--corrections", "absolute")),
        Case("arrives_by_steps_although_replies_are_lost", ("--corrections", "relative")),
        Case("arrives_although_it_was_halted", ("--corrections", "absolute")),
        Case("tells_late_replies"),
        Case("tells_that_the_stream_has_ended"),
        Case("holds_the_arm_when_stopped", ("--corrections", "absolute")),
        Case("refuses_a_correction_beyond_its_limit", ("--corrections", "absolute")),
        Case("is_served_again_after_a_new_start", ("--corrections", "absolute")),
    ),
)

UR = Protocol(
    "Universal Robots: RTDE, dashboard, client interfaces",
    ("ur", "--set", "protective_stop_lock_s=0.5"),
    (
        Case("reads_joints_and_pose"),
        Case("moves_to_joints"),
        Case("moves_along_a_line"),
        Case("streams_joints"),
        Case("streams_speeds"),
        Case("stops_a_motion"),
        Case("computes_the_inverse_kinematics"),
        Case("computes_the_forward_kinematics_of_now"),
        Case("computes_the_forward_kinematics_of_joints"),
        Case("sets_the_tool_centre_point"),
        Case("switches_an_output"),
        Case("slows_by_the_speed_slider"),
        Case("sends_a_script"),
        Case("reads_mode_and_remote_control"),
        Case("powers_off_and_on"),
        Case("tells_a_protective_stop"),
        Case("moves_again_after_a_protective_stop"),
        Case("tells_an_emergency_stop"),
        Case("tells_that_the_controller_has_gone"),
        Case("reconnects_after_a_cut"),
        Case("reads_a_controller_of_the_generation_before", ("--model", "ur5")),
    ),
)

GIGE_VISION = Protocol(
    "GigE Vision",
    ("basler",),
    (
        Case("finds_cameras_by_broadcast"),
        Case("reads_the_description"),
        Case("writes_features"),
        Case("grabs_triggered_frames"),
        Case("grabs_free_running_frames"),
        Case("grabs_from_two_cameras"),
        Case("numbers_and_stamps_frames"),
        Case("gets_every_frame_although_packets_are_lost"),
        Case("gets_every_frame_although_packets_are_shuffled"),
        Case("tells_a_frame_with_missing_packets"),
        Case("tells_a_frame_of_half_its_data"),
        Case("finds_the_largest_packet"),
        Case("keeps_control_between_frames"),
        Case("tells_that_another_application_has_control"),
        Case("takes_control_after_one_was_killed"),
        Case("tells_that_the_camera_has_gone"),
        Case("takes_commands_apart"),
        Case("takes_an_image_apart"),
        Case("takes_a_resend_apart"),
        Case("takes_events_apart"),
    ),
)

OPENIGTLINK = Protocol(
    "OpenIGTLink: our server",
    (),
    (
        Case("reads_a_transform"),
        Case("reads_a_text"),
        Case("reads_points"),
        Case("reads_a_status"),
        Case("reads_a_trajectory"),
        Case("reads_tracking_data"),
        Case("reads_an_image"),
        Case("reads_metadata"),
        Case("skips_a_message_that_it_does_not_know"),
        Case("refuses_a_wrong_check_sum"),
        Case("reads_a_message_that_comes_in_two_packets"),
        Case("notices_that_the_server_has_gone"),
    ),
)

DICOM_NETWORK = Protocol(
    "DICOM network: our receiver and requests",
    (),
    (
        Case("answers_our_echo"),
        Case("is_answered_by_our_receiver"),
        Case("sends_a_series_to_our_receiver"),
        Case("sends_a_series_to_our_receiver_by_tls"),
        Case("lists_the_series_of_a_patient"),
        Case("sends_a_series_that_we_fetch"),
        Case("stores_a_series_that_we_send"),
        Case("files_the_results_of_a_run_in_the_study_of_its_ct"),
    ),
    "a peer ...",
)

DICOM_OBJECTS = Protocol(
    "DICOM objects of a run",
    (),
    (
        Case("finds_no_error_in_the_spheres"),
        Case("finds_no_error_in_the_registration"),
        Case("finds_no_error_in_the_structure_set"),
        Case("finds_no_error_in_the_report_page"),
        Case("finds_no_error_in_the_postoperative_report"),
    ),
    "a validator ...",
)

ITK_TRANSFORM = Protocol(
    "ITK transform of a fusion", (), (Case("maps_points_of_the_ct_to_the_other_series"),), "a reader ..."
)

FLIGHT_LOG = Protocol(
    "MCAP: log of a run",
    (),
    (
        Case("reads_every_message"),
        Case("reads_joints_with_their_times"),
        Case("reads_poses_in_metres"),
        Case("finds_index_and_check_sums_right"),
        Case("reads_a_log_whose_program_was_killed"),
    ),
    "a reader ...",
)

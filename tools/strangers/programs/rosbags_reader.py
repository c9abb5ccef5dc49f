"""rosbags, which reads the log of a run as a bag, by its own definitions of ROS 2 Jazzy."""

from __future__ import annotations

from collections import defaultdict
from typing import Any

import numpy as np
from our_log import COUNTS, EPOCH_NS, JOINTS_RAD, POSE_MM, TIMES_S, sealed_log
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_JAZZY)
MM_PER_M = 1000.0


def messages() -> dict[str, list[tuple[int, Any]]]:
    """Read times and messages of each topic."""
    found = defaultdict(list)
    with AnyReader([sealed_log()], default_typestore=STORE) as reader:
        for connection, stamp_ns, data in reader.messages():
            found[connection.topic].append((stamp_ns, STORE.deserialize_cdr(data, connection.msgtype)))
    return found


def reads_every_message() -> None:
    assert {topic: len(found) for topic, found in messages().items()} == COUNTS


def reads_joints_with_their_times() -> None:
    stamps_ns, joints = zip(*messages()["/measured_js"], strict=True)
    assert np.array_equal([one.position for one in joints], JOINTS_RAD)
    assert np.allclose((np.array(stamps_ns) - EPOCH_NS) / 1e9, TIMES_S)


def reads_poses_in_metres() -> None:
    ((_, placed),) = messages()["/tf"]
    (transform,) = placed.transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("robot", "flange")
    place = transform.transform.translation
    assert np.allclose(np.array([place.x, place.y, place.z]) * MM_PER_M, POSE_MM)

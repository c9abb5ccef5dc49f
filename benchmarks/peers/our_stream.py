"""Our driver's client for two free-running cameras, in a separate process like the Aravis client.

    python our_stream.py '{"addresses": [...], "pairs": N, "packet_bytes": 8000}'

Prints one JSON line: seconds, CPU seconds (and the receiver's part), frames lost and broken, requests.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[2])]

from tests.support.devices.camera_stream import stream_pairs  # noqa: E402


def main(job: dict[str, object]) -> None:
    outcome = stream_pairs(job["addresses"], job["pairs"], job["packet_bytes"])  # type: ignore[arg-type]
    summary = {
        "seconds": outcome.seconds,
        "cpu_s": outcome.receiver_cpu_s + outcome.driver_cpu_s,
        "receiver_cpu_s": outcome.receiver_cpu_s,
        "lost": outcome.lost,
        "broken": outcome.broken,
        "repeated": outcome.repeated,
    }
    print(json.dumps(summary))


if __name__ == "__main__":
    main(json.loads(sys.argv[1]))

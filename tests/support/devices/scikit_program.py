"""A program around scikit-surgerynditracker, used as its documentation says.

`scikit_program.py CONFIGURATION FRAMES` prints one JSON list with what `get_frame` gave each time.
"""

from __future__ import annotations

import json
import sys
from contextlib import redirect_stdout

from sksurgerynditracker.nditracker import NDITracker  # type: ignore[import-untyped]


def main() -> None:
    frames = []
    with redirect_stdout(sys.stderr):  # it prints what it does
        tracker = NDITracker(json.loads(sys.argv[1]))
        tracker.start_tracking()
        for _ in range(int(sys.argv[2])):
            _, _, numbers, poses, qualities = tracker.get_frame()
            frames.append(
                {"numbers": numbers, "poses": [pose.tolist() for pose in poses], "errors": list(qualities)}
            )
        tracker.stop_tracking()
        tracker.close()
    sys.stdout.write(json.dumps(frames))


if __name__ == "__main__":
    main()

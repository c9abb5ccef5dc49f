"""A program around pyigtl's server, used as its examples do: it must be the main thread of a process.

`pyigtl_tracker_program.py` prints its port, and sends two tools sixty times a second; a line on its standard
input names the tools to send from then on.
"""

from __future__ import annotations

import select
import sys
import time

import numpy as np
import pyigtl  # type: ignore[import-untyped]

PERIOD_S = 1 / 60


def main() -> None:
    server = pyigtl.OpenIGTLinkServer(port=0, local_server=True)
    sys.stdout.write(f"{server.server_address[1]}\n")
    sys.stdout.flush()
    names, draws = ["RobotFrameToTracker", "XFrameToTracker"], np.random.default_rng(1)
    while True:
        for place, name in enumerate(names):
            pose = np.eye(4)
            pose[:3, :3] = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]]
            pose[:3, 3] = draws.normal((100.0 * place, 20.0, -1500.0), 0.05)
            server.send_message(pyigtl.TransformMessage(pose, device_name=name), wait=False)
        if select.select([sys.stdin], [], [], 0.0)[0]:
            line = sys.stdin.readline()
            if not line:
                return
            names = line.split()
        time.sleep(PERIOD_S)


if __name__ == "__main__":
    main()

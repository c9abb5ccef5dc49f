"""ur-rtde, the client of the field, in its servoJ loop. Arguments: the controller's address; paced or polled.

Paced is the loop of its examples, by its own clock; polled calls servoJ as soon as a new state has been read.
"""

from __future__ import annotations

import json
import os
import sys
import time

from sim.world.process import end_with_parent

RATE_HZ = 500.0
CYCLE_S, LOOKAHEAD_S, GAIN = 0.002, 0.03, 1000.0
WITHOUT_MEANING = 0.0  # speed and acceleration of servoJ


def main() -> None:
    """Serve until terminated; the arm is held where it is."""
    import rtde_control  # type: ignore[import-not-found]
    import rtde_receive  # type: ignore[import-not-found]

    end_with_parent(lambda: os._exit(0))
    address, is_polled = sys.argv[1], "polled" in sys.argv
    control = rtde_control.RTDEControlInterface(address, RATE_HZ)
    receive = rtde_receive.RTDEReceiveInterface(address, RATE_HZ, ["timestamp", "actual_q"])
    held = receive.getActualQ()
    print("READY " + json.dumps({"endpoint": f"tcp://{address}:30004"}), flush=True)
    seen_s = receive.getTimestamp()
    while True:
        began = control.initPeriod()
        control.servoJ(held, WITHOUT_MEANING, WITHOUT_MEANING, CYCLE_S, LOOKAHEAD_S, GAIN)
        if not is_polled:
            control.waitPeriod(began)
            continue
        while receive.getTimestamp() == seen_s:
            time.sleep(0.0)
        seen_s = receive.getTimestamp()


if __name__ == "__main__":
    main()

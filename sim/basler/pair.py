"""The stereo head's two cameras in one process, sharing one world."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from sim.basler.addresses import bind_broadcast, bind_pair
from sim.basler.camera.device import Camera
from sim.basler.camera.photographer import Photographer
from sim.basler.camera.timing import TriggerMoments
from sim.basler.control.bootstrap import Identity
from sim.basler.faults import CameraFaults
from sim.basler.server import ControlServer
from sim.world.world import World

SIDES = ("left", "right")


class CameraPair:
    """Two cameras that serve until ended."""

    def __init__(self, world: World, addresses: Sequence[str] = ()) -> None:
        sockets = bind_pair(addresses)
        moments = TriggerMoments(world.clock)
        self._cameras = []
        for side, truth, control in zip(SIDES, (world.scene.left, world.scene.right), sockets, strict=True):
            # one board for the server's thread, one for the thread that takes images
            faults, seen = (CameraFaults(world, truth, side) for _ in range(2))
            self._cameras.append(
                Camera(
                    Identity(control.getsockname()[0], truth.serial, side),
                    Photographer(world, truth, seen),
                    world.clock,
                    moments,
                    faults=faults,
                )
            )
        self._server = ControlServer(self._cameras, sockets, bind_broadcast(), _tell)

    @property
    def endpoints(self) -> dict[str, str]:
        """Addresses of the cameras for clients."""
        return {
            side: f"gev://{camera.identity.address}"
            for side, camera in zip(SIDES, self._cameras, strict=True)
        }

    def serve(self) -> None:
        """Serve clients until `end`."""
        for camera in self._cameras:
            camera.open()
        try:
            self._server.serve()
        finally:
            for camera in self._cameras:
                camera.close()

    def end(self) -> None:
        """Make `serve` return soon."""
        self._server.end()


def _tell(message: str) -> None:
    sys.stderr.write(message + "\n")

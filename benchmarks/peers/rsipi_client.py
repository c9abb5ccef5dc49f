"""RSIPI, the Python client from PyPI, configured with our own RSI Ethernet file."""

from __future__ import annotations

import json
import logging
import os
import re
import sys
import tempfile
import time
from pathlib import Path

from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.network import own_udp_endpoint
from sim.world.process import end_with_parent

LONGEST_LIFE_S = 600.0


def main() -> None:
    """Serve until terminated. The argument is the path of the Ethernet file."""
    from RSIPI import RSIAPI  # type: ignore[import-untyped]

    end_with_parent(lambda: os._exit(0))
    logging.disable(logging.CRITICAL)
    client_address = parse_endpoint(own_udp_endpoint())
    text = Path(sys.argv[1]).read_text(encoding="utf-8")
    text = re.sub("<IP_NUMBER>[^<]*", f"<IP_NUMBER>{client_address.host}", text)
    text = re.sub("<PORT>[^<]*", f"<PORT>{client_address.port}", text)
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "ethernet.xml"
        config.write_text(text, encoding="utf-8")
        client = RSIAPI(str(config), rsi_mode="absolute")  # reads the file once
    client.start()
    print("READY " + json.dumps({"endpoint": str(client_address)}), flush=True)
    time.sleep(LONGEST_LIFE_S)


if __name__ == "__main__":
    main()

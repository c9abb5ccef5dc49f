"""Small controller in threads of the test: real sockets, real bytes, misbehaving on request."""

from __future__ import annotations

import contextlib
import re
import socket
import threading
import time

from ronna_hw.wire.kuka_context import context_hash, load_context

START_DEG = (0.0, -90.0, 90.0, 0.0, 60.0, 0.0)
AXES = re.compile(rb'A1="([^"]*)" A2="([^"]*)" A3="([^"]*)" A4="([^"]*)" A5="([^"]*)" A6="([^"]*)"')
IPOC = re.compile(rb"<IPOC>(\d+)</IPOC>")
STOP = re.compile(rb"<Stop>(\d)</Stop>")
COMMAND = re.compile(rb'<Cmd Id="(\d+)" Name="(\w+)"[^>]*></Cmd>')
REPLY_WAIT_S = 0.1
DEAD_CYCLES = 2
STATE_PERIOD_S = 0.1  # between two states that nobody asked for
CONNECTED_S = 5.0  # within which a client that has connected is taken on


class FakeController:
    """Controller in lock-step: the next telegram goes when the reply has come, or after 0.1 s without one."""

    def __init__(self) -> None:
        self.facts: dict[str, str] = {
            "Mode": "EXT",
            "Drives": "1",
            "EStop": "0",
            "Guard": "0",
            "ProState": "P_FREE",
            "Moving": "0",
            "Ov": "100",
            "Err": "0",
            "RSI": "0",
            "Tool": "2",
            "Base": "0",
            "Stopmess": "0",
            "Ref": "ABS",
            "HoldOn": "1",
            "Cycle": "4",
            "CtxHash": context_hash(load_context()),
            "Variant": "kr6_r900_sixx",
            "Serial": "601234",
            "Brakes": "63",
        }
        self.axes_deg: tuple[float, ...] = START_DEG
        self.eki_axes_deg: tuple[float, ...] | None = None
        self.ack_codes: dict[str, int] = {}
        self.mute_commands: set[str] = set()
        self.commands: list[str] = []
        self.replies: list[tuple[int, tuple[float, ...], int]] = []
        self.late = 0
        self.ipoc = 4_208_163_634
        self.cycle_ms = 4
        self.root_type = "KUKA"
        self.currents_percent: tuple[float, ...] | None = (0.0,) * 6  # None: not sent
        self.order = (0, 1, 2, 3, 4, 5)  # which correction feeds which axis
        self.adds_up = False  # corrections are relative
        self.streams = True  # otherwise somebody else sends the telegrams
        self.tells = True  # its state, though nobody asked
        self.deaf = False  # an EKI session neither hears nor says anything more; the next one does
        self.turned_away = 0  # EKI clients to drop as soon as they come
        self.streaming = threading.Event()
        self.silent = threading.Event()  # set: telegrams are withheld
        self.standing = threading.Event()  # set while they are, every reply taken
        self.junk: list[bytes] = []  # sent before the next telegrams, one by one
        self.skip_cycles = 0  # telegrams to lose, one by one
        self.frozen = False  # axes no longer follow
        self.new_port = False
        self.pace_s = 0.0
        self.stop_honoured = True
        self.rsi_address: tuple[str, int] = ("127.0.0.1", 0)
        self._ending = threading.Event()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.05)
        self._client: socket.socket | None = None
        self._connected = threading.Event()
        self._threads = [threading.Thread(target=self._serve_eki), threading.Thread(target=self._serve_rsi)]
        for thread in self._threads:
            thread.start()

    @property
    def eki_port(self) -> int:
        port: int = self._server.getsockname()[1]
        return port

    def close(self) -> None:
        self._ending.set()
        self.drop_eki()
        for thread in self._threads:
            thread.join()
        self._server.close()

    def drop_eki(self) -> None:
        client = self._client
        if client is not None:
            with contextlib.suppress(OSError):
                client.shutdown(socket.SHUT_RDWR)

    def send_raw(self, data: bytes) -> None:
        assert self._connected.wait(CONNECTED_S), "nobody has connected to EKI"
        assert self._client is not None
        self._client.sendall(data)

    def tell(self, **facts: str) -> None:
        """Change facts and report them unasked."""
        self.facts.update(facts)
        self.send_raw(self.state())

    def state(self, number: int = 0) -> bytes:
        axes = self.eki_axes_deg or self.axes_deg
        facts = " ".join(f'{k}="{v}"' for k, v in self.facts.items())
        axis = " ".join(f'A{k + 1}="{v:.6f}"' for k, v in enumerate(axes))
        pos = 'X="445.0" Y="0.0" Z="810.0" A="180.0" B="0.0" C="180.0" S="2" T="2"'
        return f'<State Id="{number}" {facts}><Axis {axis}></Axis><Pos {pos}></Pos></State>'.encode()

    def _serve_eki(self) -> None:
        while not self._ending.is_set():
            try:
                client, _ = self._server.accept()
            except TimeoutError:
                continue
            if self.turned_away:
                self.turned_away -= 1
                client.close()
                continue
            self._client, self.deaf = client, False
            self._connected.set()
            with client:
                buffer = b""
                client.settimeout(STATE_PERIOD_S)
                while True:
                    try:
                        data = client.recv(4096)
                    except TimeoutError:
                        with contextlib.suppress(OSError):
                            client.sendall(self.state() if self.tells and not self.deaf else b"")
                        continue
                    except OSError:
                        break
                    if not data:
                        break
                    buffer += b"" if self.deaf else data
                    while found := COMMAND.search(buffer):
                        buffer = buffer[found.end() :]
                        with contextlib.suppress(BrokenPipeError):  # the client has left before the answer
                            self._answer(client, int(found[1]), found[2].decode())
            self._connected.clear()
            self._client = None

    def _answer(self, client: socket.socket, number: int, name: str) -> None:
        self.commands.append(name)
        if name in self.mute_commands:
            return
        if name == "STATUS":
            client.sendall(self.state(number))
            return
        code = self.ack_codes.get(name, 0)
        if not code:
            self._act(name)  # before it is acknowledged: whoever reads the answer looks at the facts
        client.sendall(f'<Ack Id="{number}" Cmd="{name}" Code="{code}" Text=""></Ack>'.encode())
        if not code:
            client.sendall(self.state())

    def _act(self, name: str) -> None:
        if name == "RSI_START":
            self.facts["RSI"] = "2"
            self.late = 0
            self.replies.clear()
            if self.streams:
                self.streaming.set()
        elif name == "RSI_STOP":
            self.streaming.clear()
            self.facts["RSI"] = "0"
        elif name == "DRIVES":
            self.facts["Drives"] = "0" if self.facts["Drives"] == "1" else "1"
        elif name == "ACK_ERRORS":
            self.facts["Err"] = "0"

    def telegram(self) -> bytes:
        axis = " ".join(f'A{k + 1}="{v:.4f}"' for k, v in enumerate(self.axes_deg))
        zeros = " ".join(f'E{k}="0.0000"' for k in range(1, 7))
        values = enumerate(self.currents_percent or (), 1)
        currents = " ".join(f'A{k}="{v:.4f}"' for k, v in values)
        sent = f"<MACur {currents}/>" if currents else ""
        return (
            f'<Rob Type="{self.root_type}"><RIst X="445.0000" Y="0.0000" Z="810.0000" A="180.0000" B="0.0000"'
            f' C="180.0000"/><AIPos {axis}/><EIPos {zeros}/><Delay D="{self.late}"/>'
            f"{sent}<IPOC>{self.ipoc}</IPOC></Rob>"
        ).encode()

    def _serve_rsi(self) -> None:
        while not self._ending.is_set():
            if self.streaming.wait(0.02):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
                    link.settimeout(REPLY_WAIT_S)
                    self._stream(link)

    def _stream(self, link: socket.socket) -> None:
        base = self.axes_deg
        pending = [base] * (DEAD_CYCLES + 1)
        while self.streaming.is_set() and not self._ending.is_set():
            if self.silent.is_set():
                self.standing.set()
                time.sleep(0.002)
                continue
            self.standing.clear()
            if self.new_port:
                self.new_port = False
                return
            self.ipoc += self.cycle_ms
            if self.skip_cycles > 0:
                self.skip_cycles -= 1
                self.late += 1
                pending.append(pending[-1])
            else:
                if self.junk:
                    link.sendto(self.junk.pop(0), self.rsi_address)
                    time.sleep(0.01)  # a newer telegram in the queue would take its place unread
                link.sendto(self.telegram(), self.rsi_address)
                reply = self._await_reply(link)
                if reply is None:
                    self.late += 1
                    pending.append(pending[-1])
                else:
                    corrections, stop = reply
                    from_ = pending[-1] if self.adds_up else base
                    fed = [corrections[k] for k in self.order]
                    pending.append(tuple(b + c for b, c in zip(from_, fed, strict=True)))
                    if stop and self.stop_honoured:
                        self.streaming.clear()
                        self.facts["RSI"] = "0"
            target = pending.pop(0)
            if not self.frozen:
                self.axes_deg = target
            still = all(p == target for p in pending)
            time.sleep(0.001 if still else self.pace_s)

    def _await_reply(self, link: socket.socket) -> tuple[tuple[float, ...], int] | None:
        while True:
            try:
                data = link.recv(4096)
            except OSError:
                return None
            found, axes, stop = IPOC.search(data), AXES.search(data), STOP.search(data)
            assert found is not None
            assert axes is not None
            assert stop is not None
            assert data.startswith(b'<Sen Type="KROSHU">')
            assert data.endswith(b"</IPOC></Sen>")
            if int(found[1]) == self.ipoc:
                values = tuple(float(v) for v in axes.groups())
                self.replies.append((self.ipoc, values, int(stop[1])))
                return values, int(stop[1])

"""Machines apart on one machine: network namespaces with addresses of their own, and a slow switch between them.

The switch is this file, run as a process: many kernels have no netem. It gives every frame a delay and every machine a
rate, cuts a machine off and lets it in again, as it is told on its standard input. Needs root, `ip`, and /dev/net/tun.
"""

from __future__ import annotations

import ctypes
import fcntl
import heapq
import os
import select
import shutil
import struct
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

DELAY_S = 0.02
BITS_PER_S = 100e6
_TUNSETIFF, _TAP, _NO_HEADER, _NEWNET = 0x400454CA, 0x0002, 0x1000, 0x40000000
_FRAME = 65536


def why_not() -> str:
    """Why there can be no slow network here, "" when there can."""
    if os.geteuid() != 0:
        return "needs root"
    if shutil.which("ip") is None or not Path("/dev/net/tun").exists():
        return "needs `ip` and /dev/net/tun"
    if subprocess.run(["ip", "netns", "add", "wcprobe"], capture_output=True, check=False).returncode:
        return "needs a kernel with network namespaces"
    subprocess.run(["ip", "netns", "del", "wcprobe"], check=True)
    return ""


class SlowNet:
    """So many namespaces, wcnet1 with 10.77.0.1 and so on; a context manager."""

    def __init__(self, machines: int) -> None:
        self.names = [f"wcnet{number + 1}" for number in range(machines)]

    def __enter__(self) -> SlowNet:
        for name in self.names:
            subprocess.run(["ip", "netns", "del", name], capture_output=True, check=False)
            _ip("netns", "add", name)
        self._switch = subprocess.Popen(
            [sys.executable, __file__, *self.names], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        if self._switch.stdout is None or self._switch.stdout.readline() != "ready\n":
            raise RuntimeError("the switch did not start")
        for number, name in enumerate(self.names):
            _ip("-n", name, "link", "set", "lo", "up")
            _ip("-n", name, "addr", "add", f"{address_of(number)}/24", "dev", "tap0")
            _ip("-n", name, "link", "set", "tap0", "up")
        return self

    def __exit__(self, *exception: object) -> None:
        self._switch.kill()
        self._switch.wait()
        for pipe in (self._switch.stdin, self._switch.stdout):
            if pipe is not None:
                pipe.close()
        for name in self.names:
            _ip("netns", "del", name)

    def cut(self, number: int, *, off: bool) -> None:
        """Cut a machine off, or let it in again."""
        if self._switch.stdin is not None:
            self._switch.stdin.write(f"{'cut' if off else 'join'} {number}\n")
            self._switch.stdin.flush()

    def inside(self, number: int, words: list[str]) -> list[str]:
        """A command line that runs another one on a machine."""
        return ["ip", "netns", "exec", self.names[number], *words]


def address_of(number: int) -> str:
    """Of a machine."""
    return f"10.77.0.{number + 1}"


def _ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, capture_output=True)


@dataclass(slots=True)
class _Port:
    """A machine's plug."""

    descriptor: int
    free_s: float = 0.0  # when what it has sent so far is through
    cut: bool = False
    sent: int = field(default=0)


def _open_tap(name: str) -> int:
    """A tap0 in a namespace; this process stays where it is."""
    libc = ctypes.CDLL(None, use_errno=True)
    home = os.open("/proc/self/ns/net", os.O_RDONLY)
    there = os.open(f"/run/netns/{name}", os.O_RDONLY)
    try:
        if libc.setns(there, _NEWNET):
            raise OSError(ctypes.get_errno(), "setns")
        tap = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
        fcntl.ioctl(tap, _TUNSETIFF, struct.pack("16sH", b"tap0", _TAP | _NO_HEADER))
        return tap
    finally:
        libc.setns(home, _NEWNET)
        os.close(there)
        os.close(home)


def _serve(names: list[str]) -> None:
    ports = [_Port(_open_tap(name)) for name in names]
    print("ready", flush=True)  # noqa: T201
    known: dict[bytes, int] = {}
    late: list[tuple[float, int, int, bytes]] = []  # when, in which order, to whom, what
    order = 0
    by_descriptor = {port.descriptor: number for number, port in enumerate(ports)}
    while True:
        wait_s = max(0.0, late[0][0] - time.monotonic()) if late else 1.0
        ready, _, _ = select.select([*by_descriptor, sys.stdin], [], [], wait_s)
        now_s = time.monotonic()
        for source in ready:
            if source is sys.stdin:
                word, _, number = sys.stdin.readline().partition(" ")
                if not word:
                    return
                ports[int(number)].cut = word == "cut"
                continue
            number = by_descriptor[source]
            try:
                frame = os.read(source, _FRAME)
            except OSError:
                continue
            port = ports[number]
            known[frame[6:12]] = number
            port.free_s = max(now_s, port.free_s) + len(frame) * 8 / BITS_PER_S
            goal = known.get(frame[:6])
            for other in [goal] if goal is not None else [n for n in range(len(ports)) if n != number]:
                if not port.cut and not ports[other].cut:
                    order += 1
                    heapq.heappush(late, (port.free_s + DELAY_S, order, other, frame))
        while late and late[0][0] <= time.monotonic():
            _, _, number, frame = heapq.heappop(late)
            if not ports[number].cut:
                try:
                    os.write(ports[number].descriptor, frame)
                except OSError:
                    continue  # a full queue drops, as a wire does


if __name__ == "__main__":
    _serve(sys.argv[1:])

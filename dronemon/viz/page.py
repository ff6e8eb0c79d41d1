"""Rerun's own viewer in a child process bound to loopback: a page, or a window on a display.

The child gets the recording's bytes on its standard input. It is no part of our process, because a
server inside it would listen on every interface with its page, and wait forever for a browser that
has stopped reading.
"""

from __future__ import annotations

import contextlib
import os
import signal
import socket
import subprocess
import threading
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote

from dronemon.errors import ViewError
from dronemon.waiting import BoundedQueue

LOOPBACK = "127.0.0.1"
PAGE_PORT = 9090
MAX_WAITING_BYTES = 64_000_000
SERVER_MEMORY = "128MB"
"""What the child keeps for browsers that come late; a flight of 300 pictures takes a quarter."""
UNTIL_STDIN_CLOSES = '{ cat; sleep 0.5; kill 0; } | "$@"'
"""Shell script: feed a command until our end of its standard input closes, however we end."""


@dataclass(frozen=True, slots=True)
class Viewer:
    """How what is to be seen is seen: in a window here, or on a page.

    command: takes recordings by name, or one on its standard input for `-`
    url:     of the page; None where a window opens
    ports:   on which page and data are served
    """

    command: tuple[str, ...]
    url: str | None = None
    ports: tuple[int, ...] = ()

    @property
    def where(self) -> str:
        """Where to look, in words; by ssh also how to get there."""
        if self.url is None:
            return "a window of the Rerun viewer opens"
        if "SSH_CONNECTION" not in os.environ:
            return self.url
        tunnels = " ".join(f"-L {port}:{LOOPBACK}:{port}" for port in self.ports)
        return f"{self.url}\n(from where you sit, first: ssh -N {tunnels} {socket.gethostname()})"


def find_viewer(data_port: int) -> Viewer:
    """A window where there is a display, else a page whose data are on a port of loopback.

    Raises ViewError.
    """
    if not _is_free(data_port):
        raise ViewError(
            f"port {data_port} on {LOOPBACK} is taken, so nothing can be shown there;"
            " end the other viewer or flight, or choose another port (view.port in a mission)"
        )
    ports = ("--bind", LOOPBACK, "--port", str(data_port))
    if _has_display():
        return Viewer((rerun_program(), *ports))
    page_port = free_port(PAGE_PORT)
    source = quote(f"rerun+http://{LOOPBACK}:{data_port}/proxy", safe="")
    serving = ("--serve-web", "--web-viewer-port", str(page_port))
    return Viewer(
        (rerun_program(), *ports, *serving, "--server-memory-limit", SERVER_MEMORY),
        f"http://{LOOPBACK}:{page_port}/?theme=dark&url={source}",
        (data_port, page_port),
    )


def _has_display() -> bool:
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))


class LivePage:
    """Shows a recording while it grows, until it is closed.

    `error` says why nothing more is shown, if so.
    """

    def __init__(self, viewer: Viewer) -> None:
        self.error: str | None = None
        self._waiting = BoundedQueue[bytes](max_bytes=MAX_WAITING_BYTES)
        self._process = _start(viewer)
        self._thread = threading.Thread(target=self._write, name="viz-page", daemon=True)
        self._thread.start()

    def feed(self, data: bytes) -> None:
        """Pass on more of the recording; never waits. A page that falls far behind is given up."""
        if self.error is None and not self._waiting.put(data, len(data)):
            self.error = "the live page stopped: its browser does not keep up"
            self._waiting.close(0.0)

    def close(self, timeout_s: float = 3.0) -> None:
        """Give the page what is still waiting, then end its process."""
        self._waiting.close(timeout_s)
        self._thread.join(timeout_s)
        if self._thread.is_alive():
            self._kill()
            self._thread.join(timeout_s)
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            self._kill()
            self._process.wait(timeout_s)

    def _kill(self) -> None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)

    def _write(self) -> None:
        assert self._process.stdin is not None
        with contextlib.suppress(OSError), self._process.stdin as stdin:
            for data in self._waiting:
                rest = memoryview(data)
                while rest:  # a process that is killed takes a part
                    rest = rest[stdin.write(rest) :]
            return
        self.error = self.error or "the live page stopped: its process ended"


def _start(viewer: Viewer) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        ["/bin/sh", "-c", UNTIL_STDIN_CLOSES, "sh", *viewer.command, "-"],
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        bufsize=0,
        start_new_session=True,  # Ctrl-C is for the flight, which goes on until it has landed
    )


def _is_free(port: int) -> bool:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return False
    return True


def free_port(preferred: int) -> int:
    """A free port of loopback: the preferred one if it is."""
    if _is_free(preferred):
        return preferred
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
    return port


def rerun_program() -> str:
    """Path of the viewer that comes with rerun-sdk. Raises ViewError."""
    package = find_spec("rerun_cli")
    folders = package.submodule_search_locations if package else None
    for folder in folders or ():
        program = Path(folder) / "rerun"
        if program.exists():
            return str(program)
    raise ViewError(
        "the rerun program is not installed, so the live view cannot be served; reinstall rerun-sdk"
    )

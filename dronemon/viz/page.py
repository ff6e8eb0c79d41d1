"""The live page: Rerun's own web viewer, in a child process bound to loopback.

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


class LivePage:
    """Serves the viewer until it is closed; `url` opens it in a browser, data are on `data_port`.

    `error` says why the page shows no more, if so.
    """

    def __init__(self, data_port: int) -> None:
        if not _is_free(data_port):
            raise ViewError(
                f"port {data_port} on {LOOPBACK} is taken, so the live view cannot be served there;"
                " end the other viewer or flight, or set another view.port in the mission"
            )
        page_port = _free_port(PAGE_PORT)
        source = quote(f"rerun+http://{LOOPBACK}:{data_port}/proxy", safe="")
        self.url = f"http://{LOOPBACK}:{page_port}/?theme=dark&url={source}"
        self.error: str | None = None
        self._waiting = BoundedQueue[bytes](max_bytes=MAX_WAITING_BYTES)
        self._process = _serve(data_port, page_port)
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


def _serve(data_port: int, page_port: int) -> subprocess.Popen[bytes]:
    command = [
        *(_rerun_program(), "-", "--serve-web", "--bind", LOOPBACK),
        *("--port", str(data_port), "--web-viewer-port", str(page_port)),
        *("--server-memory-limit", SERVER_MEMORY),
    ]
    return subprocess.Popen(
        ["/bin/sh", "-c", UNTIL_STDIN_CLOSES, "sh", *command],
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


def _free_port(preferred: int) -> int:
    if _is_free(preferred):
        return preferred
    with socket.socket() as probe:
        probe.bind((LOOPBACK, 0))
        port: int = probe.getsockname()[1]
    return port


def _rerun_program() -> str:
    package = find_spec("rerun_cli")
    folders = package.submodule_search_locations if package else None
    for folder in folders or ():
        program = Path(folder) / "rerun"
        if program.exists():
            return str(program)
    raise ViewError(
        "the rerun program is not installed, so the live view cannot be served; reinstall rerun-sdk"
    )

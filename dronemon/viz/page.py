"""The live page: Rerun's own web viewer, served on loopback by a child process.

The viewer's server inside our process would listen on every interface; the program in Rerun's wheel
can be bound to one.
"""

from __future__ import annotations

import contextlib
import socket
import subprocess
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote

from dronemon.errors import ViewError

LOOPBACK = "127.0.0.1"
PAGE_PORT = 9090
UNTIL_STDIN_CLOSES = '"$@" & child=$!; read _; kill $child; wait $child'
"""Shell script that ends its command when its standard input closes: with us, however we end."""


class WebPage:
    """Serves the viewer for the data on `data_port` until closed; `url` opens it in a browser."""

    def __init__(self, data_port: int) -> None:
        page_port = _free_port(PAGE_PORT)
        source = f"rerun+http://{LOOPBACK}:{data_port}/proxy"
        self.url = f"http://{LOOPBACK}:{page_port}/?theme=dark&url={quote(source, safe='')}"
        options = ["--serve-web", "--bind", LOOPBACK, "--web-viewer-port", str(page_port)]
        self._process = subprocess.Popen(
            ["/bin/sh", "-c", UNTIL_STDIN_CLOSES, "sh", _rerun_program(), *options, source],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # Ctrl-C is for the flight, which goes on until it has landed
        )

    def close(self, timeout_s: float = 3.0) -> None:
        """End the child process."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(timeout_s)
            return
        self._process.kill()
        self._process.wait()


def check_port_is_free(port: int) -> None:
    """Raise ViewError if another program listens on this port of the loopback interface."""
    if not _is_free(port):
        raise ViewError(
            f"port {port} on {LOOPBACK} is taken, so the live view cannot be served there;"
            " end the other viewer or flight, or set another view.port in the mission"
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

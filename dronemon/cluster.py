"""Work shared out over a Ray cluster; nothing else knows of Ray.

Ray is an extra, `dronemon[ray]`. `--ray local` starts one in this process, which listens on the
loopback alone and ends with it; `--ray HOST:PORT` joins one that runs, from one of its nodes.
"""

from __future__ import annotations

import contextlib
import os
import secrets
import signal
import socket
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future, InvalidStateError
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import cache, partial
from ipaddress import ip_address
from pathlib import Path
from threading import Event, Thread, current_thread, main_thread
from types import ModuleType
from typing import Any, ParamSpec, TypeVar

from dronemon.errors import DronemonError, OptionError, WorkerError, writing
from dronemon.version import code_digest
from dronemon.workers import num_cores

P = ParamSpec("P")
R = TypeVar("R")

MAX_RETRIES = 3
"""How often a task is begun anew whose process or node died."""
ANSWER_S, LOOK_INTERVAL_S, SILENCE_S = 5.0, 5.0, 30.0
"""How long the head has to take a call, how often it is called, and how long it may be silent.

Ray ends a process whose head is silent for 60 s, whatever it does.
"""
_LONGEST_FOLDER = 28
"""For sockets below it to have paths of at most 107 bytes, as Linux wants."""
STORE_BYTES = 2**27
"""Of a Ray of our own, which passes no large values."""


_SETTINGS = b"\x04"
_HELLO = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes(3) + _SETTINGS + bytes(5)
"""How HTTP/2 begins on both sides: with a frame of settings, here an empty one."""
_ADVICE = {
    True: "a machine that is too busy to start it in half a minute may do so later",
    False: "all nodes need the same Ray and Python, and ~/.ray/auth_token if the first has one, and"
    " this command runs on one of them",
}
"""Where Ray cannot be had, by whether it is our own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Terms:
    """What a process on a node needs in common with the one that asks.

    code:   digest of the package
    folder: where relative paths begin, if the node has it
    mark:   a file in a folder that all nodes must share, if any
    """

    code: str
    folder: Path
    mark: Path | None


@contextmanager
def join_cluster(
    address: str, num_workers: int | None, shared: Path | None = None
) -> Iterator[Executor]:
    """Processes of a Ray cluster, for `dronemon.workers.share_out`.

    address:     `local` for a Ray of our own, or host:port of one that runs
    num_workers: processes of our own Ray, one per core for None; a cluster has its own number
    shared:      folder that work on any node reads or writes

    Raises OptionError if there is no such cluster or this process does not fit it.
    """
    if num_workers is not None and address != "local":
        raise OptionError(
            f"--workers {num_workers}: the cluster at {address} has as many as its nodes have "
            "CPUs; leave it out"
        )
    if address != "local" and not _answers(address):  # Ray would try for minutes
        raise OptionError(
            f"--ray {address}: no Ray answers there within {ANSWER_S:g} s; give local, or the "
            "HOST:PORT that `ray start --head` named (usually port 6379, not the client's 10001), "
            "on a node of the cluster"
        )
    ray = _ray(address)
    with _own_folder() if address == "local" else nullcontext("") as folder:
        try:
            _connect(ray, address, num_workers, folder)
            with _marked(shared) as mark:
                terms = Terms(code=code_digest(), folder=Path.cwd(), mark=mark)
                with _RayExecutor(ray, terms) as executor:
                    yield executor
        finally:
            ray.shutdown()


def _own_folder() -> AbstractContextManager[str]:
    """A folder that is ours alone, for what a Ray of our own writes, with a path short enough."""
    wanted = [os.environ.get("RAY_TMPDIR", ""), tempfile.gettempdir(), "/tmp"]
    place = next(folder for folder in wanted if 0 < len(folder) <= _LONGEST_FOLDER)
    try:
        return tempfile.TemporaryDirectory(prefix="dm-", dir=place, ignore_cleanup_errors=True)
    except OSError as exc:
        raise OptionError(f"--ray local: {place}: {exc.strerror}; set RAY_TMPDIR") from exc


def _ray(address: str) -> ModuleType:
    """Ray, told before it is imported what it reads only then."""
    os.environ.setdefault("RAY_task_oom_retries", str(MAX_RETRIES))  # without end, usually
    if address == "local":  # has it listen on the loopback alone, on Linux too
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"
        os.environ["RAY_AUTH_MODE"] = "token"  # of this run alone: Ray's own stays, for all to read
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)
    else:
        os.environ.setdefault("RAY_NUM_REDIS_GET_RETRIES", "2")  # calls to the head, of 40 s each
        with contextlib.suppress(RuntimeError):  # a user without a home
            if Path("~/.ray/auth_token").expanduser().exists():  # `ray start` asks for it then
                os.environ.setdefault("RAY_AUTH_MODE", "token")
    try:
        import ray
    except ImportError as exc:
        raise OptionError(
            f"--ray {address}: Ray is not installed; pip install 'dronemon[ray]' brings it"
        ) from exc
    return ray


@contextmanager
def _own_end() -> Iterator[None]:
    """What SIGTERM does stays as it is: Ray would have it end this process by another."""
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        if before is not None and current_thread() is main_thread():
            signal.signal(signal.SIGTERM, before)


def _connect(ray: ModuleType, address: str, num_workers: int | None, folder: str) -> None:
    """Start Ray or join it. folder: of a Ray of our own, for its logs. Raises OptionError."""
    own: dict[str, Any] = {
        "num_cpus": num_workers or num_cores(),
        "object_store_memory": STORE_BYTES,
        "include_dashboard": False,
        "_temp_dir": f"{folder}/r",  # which Ray opens to all
    }
    try:
        with _own_end():
            ray.init(
                address=address,
                log_to_driver=False,
                logging_level="ERROR",
                **(own if address == "local" else {}),
            )
    except Exception as exc:  # of any kind, and also if this Python or Ray is not the cluster's
        raise OptionError(f"--ray {address}: {exc}; {_ADVICE[address == 'local']}") from exc
    host = ray.util.get_node_ip_address()
    if address == "local" and not ip_address(host).is_loopback:
        raise OptionError(
            f"--ray local: this version of Ray, {ray.__version__}, listens at {host}, beyond the "
            "loopback; install another, or start one where that does no harm and name its HOST:PORT"
        )


def _answers(address: str) -> bool:
    """Whether something at host:port answers as Ray's head does, by HTTP/2 (RFC 9113, 3.4).

    Raises OptionError if it is none.
    """
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 2**16:
        raise OptionError(f"--ray {address}: neither local nor HOST:PORT")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), ANSWER_S) as connection:
            if os.environ.get("RAY_USE_TLS", "0") != "0":
                return True
            connection.sendall(_HELLO)
            frame = b""
            while len(frame) < 4 and (part := connection.recv(9)):
                frame += part
            return frame[3:4] == _SETTINGS
    except (OSError, UnicodeError):  # the latter of a name that can be none
        return False


@contextmanager
def _marked(folder: Path | None) -> Iterator[Path | None]:
    """A file for all nodes to find in a folder, while there is work."""
    if folder is None:
        yield None
        return
    mark = folder.absolute() / f".shared-{secrets.token_hex(8)}"
    with writing("--out", mark):
        mark.touch()
    try:
        yield mark
    finally:
        mark.unlink(missing_ok=True)


class _RayExecutor(Executor):
    """Ray's tasks as futures, which fail with errors of ours; a cluster that is gone fails all."""

    def __init__(self, ray: ModuleType, terms: Terms) -> None:
        self._ray = ray
        self._terms = terms
        self._do = ray.remote(max_retries=MAX_RETRIES)(_do)
        self._head: str = ray.get_runtime_context().gcs_address
        self._pending: set[Future[Any]] = set()
        self._is_over = Event()
        self._watch = Thread(target=self._look, name="ray's head", daemon=True)
        self._watch.start()

    def submit(self, fn: Callable[P, R], /, *args: P.args, **kwargs: P.kwargs) -> Future[R]:
        """Have it done on any node, once or, if its process dies, a few times more."""
        future: Future[R] = Future()
        self._pending.add(future)
        future.add_done_callback(self._pending.discard)
        called = self._do.remote(self._terms, partial(fn, *args, **kwargs)).future()
        called.add_done_callback(partial(self._settle, future, ", ".join(map(str, args))))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """No more is wanted; what is under way ends with the connection."""
        self._is_over.set()
        self._watch.join()

    def _settle(self, future: Future[R], task: str, called: Future[R]) -> None:
        """Pass on what Ray says of a task."""
        with suppress(InvalidStateError):  # the cluster was given up
            if (exc := called.exception()) is None:
                future.set_result(called.result())
            else:
                future.set_exception(self._translated(exc, task))

    def _translated(self, exc: BaseException, task: str) -> BaseException:
        """What the work itself raised, or an error of ours about who should have done it."""
        errors = self._ray.exceptions
        if isinstance(exc, errors.LocalRayletDiedError):
            return _gone(self._head)
        if isinstance(exc, errors.RayTaskError) and not isinstance(exc.cause, errors.RayError):
            cause: BaseException = exc.cause
            cause.__cause__ = exc
            return cause
        died = (errors.WorkerCrashedError, errors.NodeDiedError, errors.OutOfMemoryError)
        if isinstance(exc, died):
            return WorkerError(
                f"the process that did {task} died, {1 + MAX_RETRIES} times in a row, perhaps for "
                f"want of memory; the same command goes on where this run was ({_last(exc)})"
            )
        return WorkerError(
            f"{task} could not be done on the cluster: {_last(exc)}; what it needs must be "
            "installed on every node, or lie in the folder that the command runs in"
        )

    def _look(self) -> None:
        """Fail all that is under way when the head has been silent for too long."""
        answered_s = time.monotonic()
        while not self._is_over.wait(LOOK_INTERVAL_S):
            if _answers(self._head):
                answered_s = time.monotonic()
            elif time.monotonic() - answered_s > SILENCE_S:
                for future in list(self._pending):
                    with suppress(InvalidStateError):
                        future.set_exception(_gone(self._head))


def _last(exc: BaseException) -> str:
    """What a long story of Ray's comes to."""
    return next((line.strip() for line in reversed(str(exc).splitlines()) if line.strip()), "")


def _gone(head: str) -> WorkerError:
    return WorkerError(
        f"the Ray cluster at {head} is gone; what was finished is kept: start the cluster again, "
        "and the same command goes on where this run was"
    )


def _do(terms: Terms, task: Callable[[], R]) -> R:
    """Do a task in a process of a node. Raises what it raises, ours with the node's name."""
    try:
        _agree(terms)
        return task()
    except DronemonError as exc:
        raise type(exc)(f"on {socket.gethostname()}: {exc}") from exc


@cache
def _agree(terms: Terms) -> None:
    """Make this process as whoever asks has it. Raises WorkerError where that cannot be."""
    if (code := code_digest()) != terms.code:
        raise WorkerError(
            f"dronemon is other code there ({code}) than where the command runs ({terms.code}); "
            "install the same, or have all nodes run it from one shared folder"
        )
    with suppress(OSError):
        os.chdir(terms.folder)
    if terms.mark is not None and not terms.mark.is_file():
        raise WorkerError(
            f"{terms.mark.parent} is not the folder that the command writes to; give an --out "
            "that all nodes share"
        )
    import torch  # not before: who only asks for a cluster does without

    torch.set_num_threads(1)  # as `share_out` promises

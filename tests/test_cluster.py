"""A Ray cluster gives what processes of our own give, whoever dies meanwhile."""

from __future__ import annotations

import os
import re
import shlex
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from pathlib import Path
from threading import Thread
from typing import Any

import pytest
import torch
import typer
from typer.testing import CliRunner

from dronemon import cluster
from dronemon.cluster import Terms, join_cluster
from dronemon.errors import OptionError, PlannerError, WorkerError
from dronemon.evaluation.command import evaluate_command
from dronemon.evaluation.evaluate import evaluate
from dronemon.evaluation.options import Options, PlannerSpec, Sweep
from dronemon.evaluation.results import Result, load_results
from dronemon.policy import read_tensors
from dronemon.terminal import LenientConsole
from dronemon.training.command import train_command
from dronemon.version import code_digest
from dronemon.workers import share_out

os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # read once; or no loopback for a cluster
os.environ["RAY_USAGE_STATS_ENABLED"] = "0"  # nor a word to anybody else
PAGE = (Path(__file__).parents[1] / "docs" / "cluster.md").read_text()
COMMANDS = [shlex.split(line) for line in re.findall(r"(?m)^    dronemon (.*)$", PAGE)]
QUIET = LenientConsole(quiet=True)
STORE_BYTES = 80 * 2**20
WORK = """
import os, time
from pathlib import Path
from dronemon.errors import PlannerError
from dronemon.planner.registry import create_planner

def wait_once(folder):
    begun = Path(folder, "pid")
    if not begun.exists():
        begun.with_suffix(".part").write_text(str(os.getpid()))
        begun.with_suffix(".part").rename(begun)
        time.sleep(600.0)

def slowly(item):
    time.sleep(0.2)
    return item

def die(item):
    os._exit(9)

def fail(item):
    raise PlannerError(f"no way for {item}")

class Loop:
    # `tsp`, which the first time waits to be killed.
    name = "loop"
    def __init__(self):
        self._planner = create_planner("tsp")
    def reset(self, briefing, roadmap):
        wait_once(Path(__file__).parent)
        self._planner.reset(briefing, roadmap)
    def next_waypoint(self, snapshot):
        return self._planner.next_waypoint(snapshot)
"""
LISTENING = """
import os, psutil
from pathlib import Path
from dronemon.cluster import join_cluster
if __name__ == "__main__":
    with join_cluster("local", 1) as nodes:
        assert nodes.submit(abs, -3).result() == 3
        us = [psutil.Process(), *psutil.Process().children(recursive=True)]
        places = {c.laddr.ip for p in us for c in p.net_connections() if c.status == "LISTEN"}
        print(len(us) > 3, *sorted(places))
        print([f"{p.stat().st_mode & 0o777:o}" for p in Path(os.environ["TMPDIR"]).iterdir()])
    print([p.name() for p in psutil.Process().children() if p.status() != "zombie"])
"""


def options(out: Path, **changes: Any) -> Options:
    given: dict[str, Any] = {
        "planners": (PlannerSpec(kind="lawnmower"), PlannerSpec(kind="tsp")),
        "out": out,
        "sweep": Sweep(targets=(2,), nodes=(20,)),
        "instances": 2,
        "first_seed": 10_000,
        "horizon_au": 2.0,
    }
    return Options(**{**given, **changes})


def lines(results: list[Result]) -> list[str]:
    """All that a line of results.jsonl holds but the time that decisions took."""
    return [
        str([getattr(r, name) for name in Result.__dataclass_fields__ if name != "decision_s"])
        for r in results
    ]


@pytest.fixture
def without_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.modules["dronemon.evaluation.evaluate"], "_draw", lambda *_: None)


def same(value: int) -> int:
    return value


def refuse(_: int) -> int:
    raise PlannerError("no way")


def test_any_executor_can_do_shared_work() -> None:
    with ThreadPoolExecutor(2) as threads:
        assert sorted(share_out(same, [3, 1, 2], 1, threads)) == [1, 2, 3]
        assert list(share_out(same, [], 1, threads)) == []
        with pytest.raises(PlannerError, match="no way"):
            list(share_out(refuse, [1], 1, threads))


@pytest.mark.usefixtures("without_figures")
def test_an_evaluation_is_the_same_by_any_executor(tmp_path: Path) -> None:
    alone = evaluate(options(tmp_path / "alone"), QUIET)
    with ThreadPoolExecutor(1) as threads:
        assert lines(evaluate(options(tmp_path / "shared"), QUIET, threads)) == lines(alone)


@pytest.mark.usefixtures("without_figures")
def test_weights_that_are_others_where_they_are_flown_are_told(tmp_path: Path) -> None:
    tracks = tmp_path / "tracks.csv"
    tracks.write_text("time,target,x,y\n0,a,0,0\n9,a,1,1\n")
    asked = options(
        tmp_path / "out", sweep=Sweep(targets=(1,), nodes=(20,), motions=(str(tracks),))
    )
    spec = next(asked.episodes())
    tracks.write_text("time,target,x,y\n0,a,0,0\n9,a,1,0.9\n")
    with pytest.raises(OptionError, match=r"or of .*tracks\.csv, are not those"):
        list(share_out(sys.modules["dronemon.evaluation.evaluate"].fly_spec, [spec], 1))


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--ray", "nowhere"], "--ray nowhere: neither local nor HOST:PORT"),
        (["--ray", "127.0.0.1:x"], "neither local nor HOST:PORT"),
        (
            ["--ray", "127.0.0.1:1"],
            "no Ray answers there within 5 s; give local, or",
        ),
        (["--ray", "127.0.0.1:1", "--workers", "2"], "--workers 2: the cluster at 127.0.0.1:1"),
        (["--ray", "local"], "pip install 'dronemon[ray]' brings it"),
    ],
)
def test_a_cluster_that_cannot_be_had_is_told_with_what_to_do(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], complaint: str
) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)  # as if it were not installed
    monkeypatch.setattr(os, "environ", dict(os.environ))
    app = typer.Typer()
    app.command()(evaluate_command)
    asked = [*arguments, "--planner", "tsp", "--out", str(tmp_path / "out")]
    outcome = CliRunner().invoke(app, asked)
    assert isinstance(outcome.exception, OptionError), outcome.output
    assert complaint in str(outcome.exception)
    assert not (tmp_path / "out").exists()


def answered(server: socket.socket, answer: bytes) -> None:
    """Take one call, and answer it."""
    connection, _ = server.accept()
    with connection, suppress(ConnectionResetError):
        connection.send(answer)
        while connection.recv(1024):
            pass


@pytest.mark.parametrize("answer", [b"", b"HTTP/1.1 400 Bad Request\r\n"])
def test_what_takes_calls_but_is_no_ray_is_told_soon(
    monkeypatch: pytest.MonkeyPatch, answer: bytes
) -> None:
    monkeypatch.setattr(cluster, "ANSWER_S", 0.3)
    with socket.create_server(("127.0.0.1", 0)) as server, ThreadPoolExecutor(1) as threads:
        called = threads.submit(answered, server, answer)
        address = f"127.0.0.1:{server.getsockname()[1]}"
        with (
            pytest.raises(OptionError, match=r"no Ray answers there within 0\.3 s"),
            join_cluster(address, None),
        ):
            pass
        called.result()


def test_a_recipe_without_lessons_has_nothing_to_share(tmp_path: Path) -> None:
    app = typer.Typer()
    app.command()(train_command)
    asked = ["--recipe", "paper", "--ray", "local", "--out", str(tmp_path / "out")]
    outcome = CliRunner().invoke(app, asked)
    assert isinstance(outcome.exception, OptionError), outcome.output
    assert "paper is PPO, which has no lessons to share" in str(outcome.exception)


def test_a_node_that_does_not_fit_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    fitting = {"code": code_digest(), "folder": tmp_path, "mark": None}
    assert cluster._do(Terms(**fitting), lambda: 3) == 3
    with pytest.raises(WorkerError, match=r"on .+: dronemon is other code there .* install the"):
        cluster._do(Terms(**{**fitting, "code": "other"}), lambda: 3)
    with pytest.raises(WorkerError, match=r"on .+: .* give an --out that all nodes share"):
        cluster._do(Terms(**{**fitting, "mark": tmp_path / "no" / "mark"}), lambda: 3)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    """A cluster of two nodes, each with one CPU, on the loopback."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        nodes = started_cluster(num_nodes=2)
        yield nodes.address
        nodes.shutdown()


def started_cluster(num_nodes: int) -> Any:
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "node_ip_address": "127.0.0.1", "object_store_memory": STORE_BYTES}
    nodes = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    for _ in range(num_nodes - 1):
        nodes.add_node(**node)
    return nodes


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A module in the folder that we run in, where nodes find it, too."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "cluster_work.py").write_text(WORK)
    import cluster_work

    yield cluster_work
    del sys.modules["cluster_work"]


def kill_who_waits(folder: Path) -> Thread:
    """Kill the process that says in a file that it waits, as soon as it does."""

    def kill() -> None:
        while not (folder / "pid").exists():
            time.sleep(0.05)
        os.kill(int((folder / "pid").read_text()), signal.SIGKILL)

    thread = Thread(target=kill, daemon=True)
    thread.start()
    return thread


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.usefixtures("without_figures", "work")
def test_two_nodes_fly_what_one_process_flies_though_a_worker_is_killed(
    tmp_path: Path, address: str
) -> None:
    planners = PlannerSpec(kind="cluster_work:Loop"), PlannerSpec(kind="lawnmower")
    (tmp_path / "pid").touch()  # nobody waits
    alone = evaluate(options(tmp_path / "alone", planners=planners, instances=4), QUIET)
    (tmp_path / "pid").unlink()
    asked = options(tmp_path / "shared", planners=planners, instances=4, save_episodes=True)
    killer = kill_who_waits(tmp_path)
    with join_cluster(address, None, asked.out) as nodes:
        shared = evaluate(asked, QUIET, nodes)
    killer.join(1.0)
    assert not killer.is_alive()
    assert sorted(lines(shared)) == sorted(lines(alone))
    assert len(list((asked.out / "episodes").glob("*.npz"))) == 8
    assert not list(asked.out.glob(".shared-*"))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_what_a_node_had_under_way_is_done_by_others_when_it_dies(work: Any) -> None:
    nodes = started_cluster(num_nodes=2)
    try:
        with (
            join_cluster(nodes.address, None) as joined,
            closing(share_out(work.slowly, range(60), 1, joined)) as done,
        ):
            got = [next(done), next(done)]
            (second,) = nodes.worker_nodes
            nodes.remove_node(second, allow_graceful=False)
            assert sorted([*got, *done]) == list(range(60))
    finally:
        nodes.shutdown()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_what_fails_on_a_node_is_told_with_its_name_or_the_task(address: str, work: Any) -> None:
    with join_cluster(address, None) as nodes:
        with pytest.raises(PlannerError, match=r"^on .+: no way for 7$"):
            list(share_out(work.fail, [7], 1, nodes))
        with pytest.raises(WorkerError, match=r"^the process that did 7 died, 4 times in a row"):
            list(share_out(work.die, [7], 1, nodes))
        with pytest.raises(WorkerError, match=r"^7 could not be done on the cluster: .*No module"):
            list(share_out(same, [7], 1, nodes))  # nodes do not have this file


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_cluster_that_goes_away_ends_the_run_with_what_to_do(
    work: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cluster, "LOOK_INTERVAL_S", 0.2)
    monkeypatch.setattr(cluster, "SILENCE_S", 1.0)
    nodes = started_cluster(num_nodes=1)
    try:
        with (
            join_cluster(nodes.address, None) as joined,
            closing(share_out(work.slowly, range(3000), 1, joined)) as done,
        ):
            next(done)
            (head,) = nodes.head_node.all_processes["gcs_server"]
            head.process.kill()
            with pytest.raises(WorkerError, match=r"is gone; what was finished is kept: start"):
                list(done)
    finally:
        nodes.shutdown()


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_ray_of_our_own_listens_on_the_loopback_alone_and_ends_with_us(tmp_path: Path) -> None:
    (tmp_path / "listening.py").write_text(LISTENING)
    own = tempfile.mkdtemp()  # a short path, as sockets need
    done = subprocess.run(
        [sys.executable, "-W", "error", "listening.py"],
        cwd=tmp_path,
        env={**os.environ, "HOME": str(tmp_path), "TMPDIR": own},
        capture_output=True,
        text=True,
        timeout=300.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    listening, folders, left = done.stdout.splitlines()[-3:]
    is_started, *places = listening.split()
    assert is_started == "True"
    assert set(places) <= {"127.0.0.1", "::1", "::ffff:127.0.0.1"}
    assert left == "[]"
    assert not (tmp_path / ".ray").exists()  # its key is of this run alone
    assert folders == "['700']"
    Path(own).rmdir()  # nothing is left in it


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_run_on_a_ray_of_our_own_that_is_terminated_keeps_what_it_has(tmp_path: Path) -> None:
    own = tempfile.mkdtemp()
    run, told = tmp_path / "run", tmp_path / "told"
    words = f"evaluate --planner tsp --targets 4 --instances 500 --first-seed 10000 --out {run}"
    with told.open("wb") as pipe:
        process = subprocess.Popen(
            [sys.executable, "-m", "dronemon.cli", *words.split(), "--ray", "local"],
            cwd=tmp_path,
            env={**os.environ, "HOME": str(tmp_path), "TMPDIR": own},
            stdout=pipe,
            stderr=subprocess.STDOUT,
        )
        try:
            lines = run / "results.jsonl"
            while not (lines.exists() and lines.read_bytes().count(b"\n") >= 2):
                assert process.poll() is None, told.read_text()
                time.sleep(0.1)
            process.terminate()
            assert process.wait(60.0) == 130, told.read_text()
        finally:
            process.kill()
    assert "stopped; finished episodes are in" in told.read_text()
    Path(own).rmdir()  # nothing is left in it


def run_command(folder: Path, arguments: list[str]) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-m", "dronemon.cli", *arguments],
        cwd=folder,
        env={**os.environ, "HOME": str(folder)},
        capture_output=True,
        text=True,
        timeout=280.0,
        check=False,
    )
    assert done.returncode == 0, done.stderr


def without_ray(command: list[str]) -> list[str]:
    """The same command for one process of our own, into another folder."""
    place = command.index("--ray")
    assert command[place : place + 4] == ["--ray", "local", "--workers", "2"]
    alone = [*command[:place], "--workers", "1", *command[place + 4 :]]
    alone[alone.index("--out") + 1] = "runs/alone"
    return alone


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_sweep_of_the_page_is_that_of_one_process_line_by_line(tmp_path: Path) -> None:
    (command,) = (c for c in COMMANDS if c[0] == "evaluate")
    run_command(tmp_path, command)
    run_command(tmp_path, without_ray(command))
    shared, alone = (
        load_results(tmp_path / "runs" / name / "results.jsonl") for name in ("sweep", "alone")
    )
    assert len(alone) == 8
    assert lines([shared[key] for key in alone]) == lines(list(alone.values()))
    assert (tmp_path / "runs" / "sweep" / "table.md").is_file()


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_the_training_of_the_page_learns_what_one_process_learns(tmp_path: Path) -> None:
    (command,) = (c for c in COMMANDS if c[0] == "train")
    (recipe,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "small.yaml").write_text(recipe)
    run_command(tmp_path, command)
    run_command(tmp_path, without_ray(command))
    shared, alone = (tmp_path / "runs" / name for name in ("shared", "alone"))
    lessons = sorted(p.name for p in (alone / "lessons").glob("round-*.pt"))
    assert len(lessons) == 2
    assert sorted(p.name for p in (shared / "lessons").iterdir()) == lessons
    for name in lessons:
        first, second = (read_tensors(f / "lessons" / name)["gains"] for f in (shared, alone))
        assert torch.equal(first, second)
    weights, same_weights = (read_tensors(f / "state.pt")["weights"] for f in (shared, alone))
    for name, value in weights.items():
        assert torch.equal(value, same_weights[name]), name

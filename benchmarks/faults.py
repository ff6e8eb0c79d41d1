"""Every fault at take-off, patrol and return: `python benchmarks/faults.py [--seeds N]`.

Each flight is one `dronemon fly` of a small mission at ten times real time. Flights that are done
are in `--results` (JSON lines) and not flown again; those of other code are not added to. The table
goes beside it as Markdown. Judged of each flight:
- end:       landed, left with true last words, pilot's, not flown, killed by the case; or
             UNCONTROLLED: the motors run and the program does not say so (the simulator knows)
- folder:    whether the run folder reads and its files are whole
- lost:      pictures whose observation is missing, beyond those that the case spoils
- crossings: how often the autopilot said that the fence is crossed, where that is not the fault
- last line: whether it is true
What a flight that is against what is promised said last is kept with it.

A real PX4 is flown beside the mock where DRONEMON_PX4 is a command line that runs what follows it
beside a fresh PX4 which streams to 127.0.0.1:14540 and :14550, DRONEMON_PX4_SPEED times real time.
Faults of the simulated autopilot do not apply there.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import multiprocessing
import os
import resource
import shlex
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import psutil

from dronemon import cli
from dronemon.errors import DronemonError
from dronemon.recorder import RunFolder
from dronemon.runner.flight import DOWN, NOT_STARTED
from dronemon.runner.last_seen import FIRST_WORDS
from dronemon.version import code_version

MISSION = """
name: faults
area: {{side_m: 120}}
flight: {{altitude_m: 30, cruise_speed_m_s: 5, horizon_au: 0.8, start_au: [0.5, 0.5]}}
camera: {{timeout_s: 2}}
targets:
  - {{name: Bella, appearance: cow, prior_au: simulated}}
  - {{name: Zuri, appearance: zebra, prior_au: simulated}}
planner: {{kind: "{planner}"}}
vehicle: {{url: "{vehicle}", speed_up: {speed_up}, link_loss_timeout_s: 3}}
simulation: {{seed: {seed}, faults: [{faults}]}}
view: {{live: false}}
"""
MOMENTS = ("take-off", "patrol", "return")
FLIGHT_LIMIT_S = 300.0
SPEED_UP = 10.0
NEVER_ENDED = "\nnever ended"
PX4 = shlex.split(os.environ.get("DRONEMON_PX4", ""))
_FULL_DISK_BYTES = 2_500
_SAID_LINES = 40
"""Of a bad flight, what is kept of its output."""


class Child(Protocol):
    """A flying program."""

    @property
    def pid(self) -> int:
        """Of its process."""

    @property
    def is_flying(self) -> bool:
        """Whether it has not ended."""

    def end(self) -> tuple[int, str]:
        """Wait for its end, and kill it if it never comes. -> exit status, what it said"""


Act = Callable[[Child], None]
Result = dict[str, Any]


def _signals(*numbers: signal.Signals, pause_s: float = 1.0) -> Callable[[Child], None]:
    def send(child: Child) -> None:
        for number in numbers:
            os.kill(child.pid, number)
            time.sleep(pause_s)

    return send


def _kill_simulator(child: Child) -> None:
    subprocess.run(["pkill", "-KILL", "-P", str(child.pid), "-f", "--", "-m sim"], check=False)


@dataclass(frozen=True)
class Case:
    """One fault: of the simulator, of a process, of the planner, or of the disk.

    faults: of the simulator, `{t}` is the moment; act: what is done to the program at the moment
    ends:   acceptable ends beside `landed`
    """

    faults: tuple[str, ...] = ()
    act: Act | None = None
    planner: str = "tsp"
    is_disk_full: bool = False
    moments: tuple[str, ...] = MOMENTS
    ends: tuple[str, ...] = ()
    spoils_pictures: bool = False

    @property
    def is_for_px4(self) -> bool:
        """Whether it is a fault of the camera, the program or the planner."""
        return not self.is_disk_full and (not self.faults or self.spoils_pictures)


CASES = {
    "none": Case(moments=("patrol",)),
    "silence 8 s": Case(("silence@{t}+8",)),
    "silence": Case(("silence@{t}",), ends=("left",)),
    "deaf": Case(("deaf@{t}",), ends=("left",)),
    "loss 20 %, delay 200 ms": Case(("loss=0.2@{t}", "delay=0.2@{t}")),
    "everything again 1.5 s later": Case(("duplicate=1.5@{t}",)),
    "everything again 8 s later, loss 10 %": Case(("duplicate=8@{t}", "loss=0.1@{t}")),
    "reordered": Case(("reorder=0.3@{t}",)),
    "corrupted": Case(("corrupt=0.1@{t}",)),
    "setpoints ignored 3 s": Case(("ignore@{t}+3",)),
    "commands refused 10 s": Case(("reject@{t}+10",)),
    "pilot 10 s": Case(("pilot@{t}+10",), ends=("pilot",)),
    "battery": Case(("battery=0.16@{t}",)),
    "battery critical": Case(("battery=0.06@{t}",)),
    "GPS lost": Case(("gps@{t}",)),
    "GPS lost 12 s": Case(("gps@{t}+12",)),
    "position jumps 20 m": Case(("jump=20@{t}",)),
    "geofence": Case(("fence@{t}",)),
    "autopilot restarts": Case(("reboot@{t}",)),
    "never disarms": Case(("COM_DISARM_LAND=-1",), moments=("return",)),
    "arming refused": Case(("unarmable",), moments=("take-off",), ends=("not flown",)),
    "camera silent 10 s": Case(("camera@{t}+10",), spoils_pictures=True),
    "camera silent": Case(("camera@{t}",), spoils_pictures=True),
    "pictures late": Case(("late=2@{t}",), spoils_pictures=True),
    "pictures torn": Case(("torn@{t}+10",), spoils_pictures=True),
    "pictures blank": Case(("blank@{t}+10",), spoils_pictures=True),
    "pictures repeated": Case(("repeat@{t}+10",), spoils_pictures=True),
    "pictures frozen": Case(("freeze@{t}+10",), spoils_pictures=True),
    "pictures misdated": Case(("misdate=100@{t}+10",), spoils_pictures=True),
    "animals hidden": Case(("hide=0.5@{t}+10",)),
    "decoys": Case(("decoy=0.5@{t}+10",)),
    "planner raises": Case(planner="faulty_planners:Raising", moments=("patrol",)),
    "planner slow": Case(planner="faulty_planners:Slow", moments=("patrol",)),
    "planner hangs": Case(planner="faulty_planners:Hanging", moments=("patrol",)),
    "disk full": Case(is_disk_full=True, moments=("patrol",), spoils_pictures=True),
    "Ctrl-C": Case(act=_signals(signal.SIGINT)),
    "Ctrl-C twice": Case(act=_signals(signal.SIGINT, signal.SIGINT)),
    "SIGSTOP 5 s": Case(act=_signals(signal.SIGSTOP, signal.SIGCONT, pause_s=5.0)),
    "SIGKILL": Case(act=_signals(signal.SIGKILL), ends=("killed",), spoils_pictures=True),
    "simulator killed": Case(act=_kill_simulator, ends=("left",), spoils_pictures=True),
}


def main() -> None:
    """Fly what is not flown yet, and write the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES), metavar="CASE")
    parser.add_argument("--moments", nargs="+", choices=MOMENTS, default=list(MOMENTS))
    parser.add_argument("--results", type=Path, default=Path("docs/results/faults.jsonl"))
    options = parser.parse_args()
    done = _read(options.results)
    for vehicle in ("mock", "px4") if PX4 else ("mock",):
        for name, moment, seed in _flights(options, vehicle):
            if (vehicle, name, moment, seed) in done:
                continue
            if others := _codes(done.values(), vehicle) - {code_version()}:
                sys.exit(
                    f"{options.results}: flights on {vehicle} are of {', '.join(sorted(others))},"
                    f" this is {code_version()}; choose other --results"
                )
            times_s = _times_s(done, vehicle, seed)
            result = fly(CASES[name], vehicle, seed, times_s.get(moment, 0.0))
            result |= {"vehicle": vehicle, "case": name, "moment": moment, "seed": seed}
            result["code"] = code_version()
            if not is_bad(result):
                del result["said"]
            elif name == "none":
                sys.exit("\n".join(["the flight without a fault failed:", *result["said"]]))
            done[vehicle, name, moment, seed] = result
            with options.results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(result) + "\n")
            print(
                vehicle,
                name,
                moment,
                seed,
                *(result[k] for k in ("end", "outcome", "last_line")),
                flush=True,
            )
    options.results.with_suffix(".md").write_text(table(list(done.values())), encoding="utf-8")
    sys.exit(any(is_bad(result) for result in done.values()))


def _flights(options: argparse.Namespace, vehicle: str) -> Iterator[tuple[str, str, int]]:
    """The flight without a fault first: it tells when the moments are."""
    for seed in range(options.seeds):
        yield "none", "patrol", seed
        for name in options.cases:
            if name == "none" or (vehicle == "px4" and not CASES[name].is_for_px4):
                continue
            for moment in CASES[name].moments:
                if moment in options.moments:
                    yield name, moment, seed


def _times_s(done: dict[tuple[Any, ...], Result], vehicle: str, seed: int) -> dict[str, float]:
    """When each moment is, in seconds after arming, from the flight without a fault."""
    control = done.get((vehicle, "none", "patrol", seed))
    return control.get("moments_s", {}) if control else {}


def fly(case: Case, vehicle: str, seed: int, moment_s: float) -> Result:
    """Fly once. -> what came of it"""
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        out = folder / "run"
        faults = ", ".join(f'"{fault.format(t=round(moment_s, 1))}"' for fault in case.faults)
        is_px4 = vehicle == "px4"
        (folder / "mission.yaml").write_text(
            MISSION.format(
                planner=case.planner,
                seed=seed,
                faults=faults,
                vehicle="udpin://127.0.0.1:14540" if is_px4 else "mock",
                speed_up=SPEED_UP,
            )
        )
        arguments = ["fly", str(folder / "mission.yaml"), "--out", str(out)]
        child: Child
        if is_px4:
            child = Spawned([*arguments, "--follow", "udpin://127.0.0.1:14550"], PX4)
        elif case.is_disk_full:
            child = Spawned(arguments, prepare=_limit_files)
        else:
            child = _Forked(arguments, folder / "output")
        if case.act is not None:
            speed_up = float(os.environ.get("DRONEMON_PX4_SPEED", "1")) if is_px4 else SPEED_UP
            wait_until(out, "armed", moment_s / speed_up, child)
            case.act(child)
        status, said = child.end()
        lines = said.strip().splitlines()
        return _judge(case, out, lines, status) | {"said": lines[-_SAID_LINES:]}


class Spawned:
    """The program as a user starts it."""

    def __init__(
        self,
        arguments: list[str],
        before: Sequence[str] = (),
        prepare: Callable[[], None] | None = None,
    ) -> None:
        command = [*before, sys.executable, "-m", "dronemon.cli", *arguments]
        paths = [str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")]  # for the planners
        self._process = subprocess.Popen(
            command,
            env=os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            preexec_fn=prepare,
        )

    @property
    def pid(self) -> int:
        """Of the program itself, whatever it was started by."""
        begun = psutil.Process(self._process.pid)
        for process in (begun, *begun.children(recursive=True)):
            with contextlib.suppress(psutil.Error):
                if process.cmdline()[1:3] == ["-m", "dronemon.cli"]:
                    return process.pid
        return begun.pid

    @property
    def is_flying(self) -> bool:
        """Whether it has not ended."""
        return self._process.poll() is None

    def end(self) -> tuple[int, str]:
        """Wait for its end, and kill it if it never comes. -> exit status, what it said"""
        try:
            said, _ = self._process.communicate(timeout=FLIGHT_LIMIT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            said, _ = self._process.communicate()
            said += NEVER_ENDED
        return self._process.returncode, said


class _Forked:
    """The program in a fork of a server that has imported it, which saves a third of the work."""

    _context = multiprocessing.get_context("forkserver")
    _context.set_forkserver_preload(["dronemon.cli", "dronemon.assembly"])

    def __init__(self, arguments: list[str], output: Path) -> None:
        self._output = output
        self._process = self._context.Process(target=_main, args=(arguments, output))
        self._process.start()
        assert self._process.pid is not None
        self.pid = self._process.pid

    @property
    def is_flying(self) -> bool:
        """Whether it has not ended."""
        return self._process.is_alive()

    def end(self) -> tuple[int, str]:
        """Wait for its end, and kill it if it never comes. -> exit status, what it said"""
        self._process.join(FLIGHT_LIMIT_S)
        is_late = self._process.exitcode is None
        self._process.kill()
        self._process.join()
        said = self._output.read_text(errors="replace") + NEVER_ENDED * is_late
        assert self._process.exitcode is not None
        return self._process.exitcode, said


def _main(arguments: list[str], output: Path) -> None:
    """The program itself, its output in a file."""
    file = os.open(output, os.O_WRONLY | os.O_CREAT)
    os.dup2(file, 1)
    os.dup2(file, 2)
    sys.argv = ["dronemon", *arguments]
    cli.main()


def _limit_files() -> None:
    """As on a full disk: files cannot grow."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (_FULL_DISK_BYTES, _FULL_DISK_BYTES))


def wait_until(out: Path, kind: str, wall_s: float, child: Child) -> None:
    """Wait until some time after the first event of a kind by the clock."""
    events = out / "events.jsonl"
    while child.is_flying:
        if events.exists() and any(f'"{kind}"' in line for line in events.read_text().splitlines()):
            time.sleep(wall_s)
            return
        time.sleep(0.02)


def _judge(case: Case, out: Path, said: list[str], status: int) -> Result:
    last = next((line for line in reversed(said) if line.strip()), "")
    result: Result = {"status": status, "last_line": last, "outcome": "none", "lost": 0}
    truth = _truth(out)
    try:
        run = RunFolder.open(out)
        summary, events = run.summary(), list(run.events())
        num_seen, _ = len(list(run.observations())), list(run.decisions())
        result["outcome"], result["error"] = summary["outcome"], summary.get("error")
        result["folder"] = "whole" if not run.damaged_files() else "damaged"
    except (DronemonError, OSError, LookupError) as exc:
        return result | {"folder": f"unreadable: {exc!r}", "end": "UNCONTROLLED", "is_true": False}
    truth_file = out / "truth.jsonl"
    num_taken = len(truth_file.read_text().splitlines()) if truth_file.exists() else 0
    if not case.spoils_pictures:
        result["lost"] = max(num_taken - 1 - num_seen, 0)  # the first is taken on the ground
    said_by_it = [event["text"] for event in events if event["kind"] == "autopilot"]
    if "fence@{t}" not in case.faults:
        result["crossings"] = sum(text.startswith("Geofence:") for text in said_by_it)
    is_left, is_landed = FIRST_WORDS in last, summary.get("is_landed", False)
    was_armed = "armed" in {event["kind"] for event in events}
    if status in {-signal.SIGKILL, 128 + signal.SIGKILL} and "killed" in case.ends:
        if status > 0:
            result["last_line"] = ""  # of what it was started by, which survived it
        return result | {"end": "killed", "is_true": True}
    result["end"] = "UNCONTROLLED"
    if is_left:
        result["end"] = "pilot" if summary["outcome"] == "pilot" else "left"
    elif is_landed and truth != "armed":
        result["end"] = "landed" if was_armed else "not flown"
    expected = FIRST_WORDS if not is_landed else DOWN if was_armed else NOT_STARTED
    result["is_true"] = expected in last and not (DOWN in last and truth == "armed")
    times = {event["kind"]: event["time_s"] for event in events}
    if {"armed", "patrol", "homecoming"} <= times.keys():
        armed_s = times["armed"]
        result["moments_s"] = {
            "take-off": 3.0,
            "patrol": times["patrol"] - armed_s + 5.0,
            "return": times["homecoming"] - armed_s + 2.0,
        }
    return result


def _truth(out: Path) -> str:
    """What the simulator says of the motors at its end; nothing of a real PX4's, or if killed."""
    log = out / "simulator.log"
    lines = log.read_text(errors="replace").splitlines() if log.exists() else []
    ends = [line for line in lines if "the vehicle is" in line]
    return "unknown" if not ends else "disarmed" if "disarmed" in ends[-1] else "armed"


def is_bad(result: Result) -> bool:
    """Whether a flight is against what is promised."""
    allowed = ("landed", "not flown", *CASES[result["case"]].ends)
    is_whole = result["folder"] == "whole" and result["lost"] <= 1
    is_right = is_whole and result["is_true"] and not result.get("crossings")
    return result["end"] not in allowed or not is_right


def table(results: list[Result]) -> str:
    """The results as Markdown: a row per case and moment, a column per vehicle."""
    vehicles = sorted({result["vehicle"] for result in results})
    crossings = [result["crossings"] for result in results if "crossings" in result]
    lines = [
        "# Faults in flight\n",
        "Written by `python benchmarks/faults.py`; its docstring says what is judged.\n",
        f"Flights {len(results)}, against what is promised {sum(map(is_bad, results))}, "
        f"uncontrolled ends {sum(r['end'] == 'UNCONTROLLED' for r in results)}, "
        f"folders not whole {sum(r['folder'] != 'whole' for r in results)}, observations lost "
        f"beyond the picture in flight {sum(max(r['lost'] - 1, 0) for r in results)}, "
        f"fence crossings {sum(crossings)} in the {len(crossings)} where they are counted, "
        f"last lines not true {sum(not r['is_true'] for r in results)}.\n",
        *(
            f"- {vehicle}: {sum(r['vehicle'] == vehicle for r in results)} flights of "
            f"{', '.join(sorted(_codes(results, vehicle)))}"
            for vehicle in vehicles
        ),
        "",
        "| fault | moment | " + " | ".join(vehicles) + " |",
        "|---|---|" + "---|" * len(vehicles),
    ]
    for name, case in CASES.items():
        for moment in case.moments:
            cells = []
            for vehicle in vehicles:
                ends = [
                    f"{r['end']} ({r['outcome']})"
                    for r in results
                    if (r["vehicle"], r["case"], r["moment"]) == (vehicle, name, moment)
                ]
                counts = {end: ends.count(end) for end in dict.fromkeys(ends)}
                cells.append(", ".join(f"{n} x {end}" for end, n in counts.items()) or "—")
            if set(cells) != {"—"}:
                lines.append(f"| {name} | {moment} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _codes(results: Iterable[Result], vehicle: str) -> set[str]:
    """What was flown on a vehicle."""
    return {result["code"] for result in results if result["vehicle"] == vehicle}


def _read(path: Path) -> dict[tuple[Any, ...], Result]:
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    results = [json.loads(line) for line in lines]
    return {(r["vehicle"], r["case"], r["moment"], r["seed"]): r for r in results}


if __name__ == "__main__":
    main()

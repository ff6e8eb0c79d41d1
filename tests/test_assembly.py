"""A whole flight's parts: what fails once it is over takes nothing of what is known."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from dronemon import assembly, cli
from dronemon.assembly import Request, assemble_and_fly
from dronemon.errors import CameraError, LinkTimeout, VehicleError, ViewError
from dronemon.events import Audience
from dronemon.mission import load_mission
from dronemon.recorder import RunFolder
from dronemon.runner.flight import DOWN, FlightResult
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.summary import summarise

RESULT = FlightResult(
    outcome="completed",
    has_flown=True,
    is_landed=True,
    last_seen=None,
    landing_error_m=0.1,
    landing_battery=0.16,
    tally=None,
    error=None,
)
MISSION = """
name: small
area: {side_m: 100}
flight: {altitude_m: 22, cruise_speed_m_s: 5, horizon_au: 0.8}
targets:
  - {name: Bella, appearance: cow, prior_au: [0.4, 0.6]}
planner: {kind: lawnmower}
view: {live: false}
"""


def test_a_person_need_not_wait_until_a_vehicle_is_heard(monkeypatch):
    interrupts = Interrupts()

    @contextlib.asynccontextmanager
    async def never_heard(*_):
        asyncio.get_running_loop().call_soon(interrupts.request)
        await asyncio.Event().wait()
        yield

    monkeypatch.setattr(assembly, "make_link", never_heard)
    monkeypatch.setattr(assembly._Run, "_priors_au", lambda _: None)
    run = assembly._Run(
        file=SimpleNamespace(mission=None),
        sim=None,
        detector=None,
        planner=None,
        recorder=None,
        audience=Audience(),
        interrupts=interrupts,
        settings={},
        folder=None,
        truth=None,
    )
    with pytest.raises(LinkTimeout, match="nothing was commanded"):
        asyncio.run(asyncio.wait_for(run.fly(is_resumed=False), 5.0))


@contextlib.contextmanager
def fails_to_close(*_):
    yield SimpleNamespace(where=None, lost="", take=lambda event: None)
    raise OSError("it is gone")


async def done(*_):
    return RESULT


async def nobody(*_):
    return None


@pytest.mark.parametrize(
    ("name", "part"),
    [
        ("FlightView", fails_to_close),
        ("FlightDisplay", fails_to_close),
        ("Truth", lambda path: SimpleNamespace(read_on=lambda: np.zeros(3)[5], told=[])),
    ],
)
def test_what_fails_after_a_flight_is_told_beside_its_result(tmp_path, monkeypatch, name, part):
    path = tmp_path / "small.yaml"
    path.write_text(MISSION)
    nothing = contextlib.nullcontext()
    monkeypatch.setattr(assembly, "_start", nobody)
    monkeypatch.setattr(assembly, "rehearse", lambda *_: None)
    monkeypatch.setattr(assembly, "make_link", lambda *_: nothing)
    monkeypatch.setattr(assembly, "make_camera", lambda *_: None)
    monkeypatch.setattr(assembly, "fly_mission", done)
    monkeypatch.setattr(assembly, name, part)
    request = Request(out=tmp_path / "run")
    result, summary, _ = asyncio.run(assemble_and_fly(load_mission(path), request))
    assert (result.outcome, result.last_word) == ("completed", DOWN)
    assert "it is gone" in str(result.error) or "IndexError" in str(result.error)
    assert summary.error == str(result.error)


@pytest.mark.parametrize(
    ("result", "code"),
    [
        (RESULT, ViewError.exit_code),
        (replace(RESULT, outcome="interrupted"), 130),
        (replace(RESULT, error=CameraError("blind")), CameraError.exit_code),
        (replace(RESULT, is_landed=False), VehicleError.exit_code),
    ],
)
def test_a_viewer_that_fails_afterwards_hides_nothing_of_the_flight(
    tmp_path, monkeypatch, capsys, result, code
):
    async def flown(*_):
        summary = summarise(result, truth=(), mission=None, place_of=lambda _: None)
        return result, summary, RunFolder(path=tmp_path)

    def fails(*_):
        raise ViewError("port 9876 is taken")

    path = tmp_path / "small.yaml"
    path.write_text(MISSION)
    monkeypatch.setattr(assembly, "assemble_and_fly", flown)
    monkeypatch.setattr("dronemon.viewing.show", fails)
    monkeypatch.setattr("sys.argv", ["dronemon", "fly", str(path), "--stay"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == code
    assert "port 9876 is taken" in capsys.readouterr().err

"""Whatever fails in flight, the drone comes home: over MAVSDK and UDP, with the simulator.

The flights in memory beside this are the same, and more, in every `make test`.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pymavlink import mavutil
from simulated_vehicle import StartMockVehicle, free_udp_port

from dronemon.camera import SimulatedCamera
from dronemon.errors import CameraError, ControlTaken, LinkLost, RecordError
from dronemon.events import Audience, Event, Measured, Noted
from dronemon.mission import load_mission
from dronemon.planner.lawnmower import Lawnmower
from dronemon.recorder import RunRecorder
from dronemon.runner.flight import FlightResult, fly_mission
from dronemon.runner.interrupts import Interrupts
from dronemon.runner.preparation import FlightSetup, rehearse
from dronemon.vehicle.mavsdk_link import MavsdkLink
from dronemon.vision.registry import make_detector
from dronemon.viz import FlightView

pytestmark = pytest.mark.slow
MISSION = """
name: small
area: {side_m: 100}
flight: {altitude_m: 22, cruise_speed_m_s: 5, horizon_au: 8, start_au: [0.5, 0.4]}
camera: {timeout_s: 1.5}
vehicle: {link_loss_timeout_s: 2.0}
targets:
  - {name: Bella, appearance: cow, prior_au: [0.4, 0.6]}
"""


OFFBOARD = 393216  # PX4's custom mode


class Listener:
    """Keeps what it is told; `on_note` may act on it."""

    lost = ""

    def __init__(self) -> None:
        self.kinds: list[str] = []
        self.on_note: Callable[[str], None] = lambda kind: None

    def take(self, event: Event) -> None:
        if isinstance(event, Noted):
            self.kinds.append(event.kind)
            self.on_note(event.kind)


class Rehearsal:
    """One flight of the small mission, its parts open to what a test does to them."""

    def __init__(self, tmp_path: Path, start: StartMockVehicle) -> None:
        self.path = tmp_path / "small.yaml"
        self.path.write_text(MISSION)
        self.out = tmp_path / "run"
        self.listener = Listener()
        self.interrupts = Interrupts()
        self._start = start

    def fly(self, *options: str) -> FlightResult:
        return asyncio.run(self._fly(options))

    async def _fly(self, options: tuple[str, ...]) -> FlightResult:
        file = load_mission(self.path)
        detector = make_detector(file.mission)
        await rehearse(file.mission, detector, Lawnmower(), self.interrupts)
        vehicle = self._start(self.path, "--speed-up", "20", *options)
        recorder = RunRecorder.create(file.mission, out=self.out)
        view = FlightView(recorder.folder.rrd_path, file.mission)
        async with asyncio.timeout(90):
            with recorder, view:
                async with MavsdkLink(vehicle.url, link_loss_timeout_s=2.0) as link:
                    return await fly_mission(
                        FlightSetup(
                            file=file,
                            link=link,
                            camera=SimulatedCamera(vehicle.camera_url, timeout_s=1.5),
                            detector=detector,
                            planner=Lawnmower(),
                            priors_au=np.array([[0.4, 0.6]]),
                            record=recorder,
                            audience=Audience((view, self.listener)),
                            interrupts=self.interrupts,
                        )
                    )


@pytest.fixture
def rehearsal(tmp_path: Path, mock_vehicle: StartMockVehicle) -> Rehearsal:
    return Rehearsal(tmp_path, mock_vehicle)


def test_a_dead_camera_brings_the_drone_home(rehearsal: Rehearsal):
    result = rehearsal.fly("--fault", "camera@30")
    assert isinstance(result.error, CameraError)
    assert result.is_landed


def test_a_low_battery_brings_the_drone_home(rehearsal: Rehearsal):
    result = rehearsal.fly("--fault", "battery=0.18@40")
    assert result.outcome == "battery low"
    assert result.error is None
    assert result.is_landed


def test_a_lost_link_is_waited_for(rehearsal: Rehearsal):
    """The autopilot's own failsafe flies home meanwhile; the record is complete."""
    result = rehearsal.fly("--fault", "silence@40+60")
    assert isinstance(result.error, LinkLost)
    assert result.is_landed
    assert result.outcome == "failed"


def test_a_full_disk_brings_the_drone_home(rehearsal: Rehearsal, monkeypatch: pytest.MonkeyPatch):
    def no_space(recorder: RunRecorder, event: Event) -> None:
        if isinstance(event, Measured):
            raise RecordError("cannot write observations.jsonl: no space left on device")

    monkeypatch.setattr(RunRecorder, "take", no_space)
    result = rehearsal.fly()
    assert isinstance(result.error, RecordError)
    assert result.is_landed


def test_the_pilot_takes_over_and_gives_back(rehearsal: Rehearsal):
    """POSCTL ends our control; OFFBOARD, chosen at another station, gives it back."""
    port = free_udp_port()
    station = mavutil.mavlink_connection(f"udpin:127.0.0.1:{port}", source_system=250)

    def choose_offboard() -> None:
        """Ask until it is so: setpoints must flow before it is accepted."""
        for _ in range(100):
            heartbeat = station.wait_heartbeat(timeout=1)
            if heartbeat is not None and heartbeat.custom_mode == OFFBOARD:
                return
            station.mav.command_long_send(1, 1, 176, 0, 1, 6, 0, 0, 0, 0, 0)

    pilot = threading.Thread(target=choose_offboard)

    def when_taken(kind: str) -> None:
        if kind == "control taken":
            while station.recv_msg() is not None:
                pass  # heartbeats from before
            pilot.start()

    rehearsal.listener.on_note = when_taken
    try:
        result = rehearsal.fly("--fault", "pilot@40", "--mavlink-out", f"127.0.0.1:{port}")
    finally:
        pilot.join()
        station.close()
    kinds = rehearsal.listener.kinds
    assert kinds.index("control taken") < kinds.index("control given back")
    assert result.outcome == "completed"
    assert result.is_landed


def test_nothing_is_commanded_while_the_pilot_flies(rehearsal: Rehearsal):
    def give_up(kind: str) -> None:
        if kind == "control taken":
            rehearsal.interrupts.request()
            rehearsal.interrupts.request()

    rehearsal.listener.on_note = give_up
    result = rehearsal.fly("--fault", "pilot@40")
    assert result.outcome == "pilot"
    assert not result.is_landed
    assert "homecoming" not in rehearsal.listener.kinds


def test_the_pilot_wins_during_take_off_too(rehearsal: Rehearsal):
    def give_up(kind: str) -> None:
        if kind == "control taken":
            rehearsal.interrupts.request()
            rehearsal.interrupts.request()

    rehearsal.listener.on_note = give_up
    result = rehearsal.fly("--fault", "pilot@5")
    assert result.outcome == "pilot"
    assert "airborne" not in rehearsal.listener.kinds
    assert "homecoming" not in rehearsal.listener.kinds


def test_a_pilot_whose_link_is_silent_for_a_while_is_not_fought(rehearsal: Rehearsal):
    def ask_twice() -> None:
        rehearsal.interrupts.request()
        rehearsal.interrupts.request()

    def end_later(kind: str) -> None:
        if kind == "control taken":
            asyncio.get_running_loop().call_later(8.0, ask_twice)

    rehearsal.listener.on_note = end_later
    result = rehearsal.fly("--fault", "pilot@40", "--fault", "silence@45+80")
    assert result.outcome == "pilot"
    assert "homecoming" not in rehearsal.listener.kinds


def test_a_failsafe_is_left_to_land(rehearsal: Rehearsal):
    """Commands that are not heard: setpoints stop for the vehicle, which flies home by itself."""
    result = rehearsal.fly("--fault", "deaf@40")
    assert isinstance(result.error, ControlTaken)
    assert result.error.by_failsafe
    assert result.is_landed
    assert "homecoming" not in rehearsal.listener.kinds


def test_lost_gps_ends_the_patrol(rehearsal: Rehearsal):
    """The failsafe is seen before the estimator's flag; without a position it only descends."""
    result = rehearsal.fly("--fault", "gps@40+60")
    assert isinstance(result.error, ControlTaken)
    assert result.error.by_failsafe
    assert result.is_landed

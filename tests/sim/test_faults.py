"""Faults on request: on the line, of the autopilot and of the camera."""

from __future__ import annotations

import asyncio
import math
import random
import struct
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from datagrams import datagrams
from ground_station import GroundStation, make_mission, with_station
from hypothesis import given, settings
from hypothesis import strategies as st
from pymavlink.dialects.v20 import common as mavlink
from simulated_vehicle import StartMockVehicle

from dronemon.camera import SimulatedCamera
from dronemon.errors import CameraError
from dronemon.mission.faults import parse_fault
from dronemon.types import CameraModel
from sim.autopilot import STEP_S
from sim.camera import CameraServer
from sim.flight import MockFlight
from sim.line import FaultyLine
from sim.link import MavlinkLink
from sim.modes import Px4Mode
from sim.scene import Scene, with_faults
from sim.world import World

ARM = mavlink.MAV_CMD_COMPONENT_ARM_DISARM
DENIED = mavlink.MAV_RESULT_TEMPORARILY_REJECTED


def line(**faults: float) -> FaultyLine:
    return FaultyLine(faults, random.Random(10_003))


def sent_over(line: FaultyLine, count: int, interval_s: float = 0.01) -> list[tuple[int, int]]:
    """-> (number, step of arrival) of what arrives of numbered datagrams, in that order."""
    arrived = []
    for step in range(count + 1000):
        if step < count:
            line.put(struct.pack("!I", step) + b"datagram", step * interval_s)
        now = line.take(step * interval_s)
        arrived += [(struct.unpack("!I", data[:4])[0], step) for data in now]
    return arrived


def test_a_line_without_faults_is_at_once() -> None:
    assert sent_over(line(), 100) == [(i, i) for i in range(100)]


def test_a_share_is_lost() -> None:
    assert len(sent_over(line(loss=0.2), 2000)) == pytest.approx(1600, abs=60)
    assert sent_over(line(loss=1.0), 100) == []


def test_all_is_late_and_in_order() -> None:
    arrived = sent_over(line(delay=0.2), 100)
    assert [number for number, _ in arrived] == list(range(100))
    assert {step - number for number, step in arrived} <= {20, 21}


def test_all_comes_again_later() -> None:
    arrived = sent_over(line(duplicate=1.5), 400)
    assert len(arrived) == 800
    assert [step for number, step in arrived if number == 7] == [7, 157]


def test_a_share_is_overtaken() -> None:
    arrived = sent_over(line(reorder=0.1), 1000)
    late = [number for number, step in arrived if step > number]
    assert len(late) == pytest.approx(100, abs=30)
    assert len(arrived) == 1000
    assert [number for number, _ in arrived] != sorted(number for number, _ in arrived)


def test_a_share_has_one_wrong_byte() -> None:
    channel, data = line(corrupt=0.5), bytes(50)
    for _ in range(200):
        channel.put(data, 0.0)
    wrong = [sum(byte != 0 for byte in got) for got in channel.take(0.0)]
    assert set(wrong) == {0, 1}
    assert sum(wrong) == pytest.approx(100, abs=25)


@pytest.mark.lengthy
def test_a_lossy_slow_line_still_carries_commands() -> None:
    async def story(station: GroundStation) -> None:
        beats = len(station.of("HEARTBEAT"))
        await station.fly(40.0)
        assert 22 < len(station.of("HEARTBEAT")) - beats < 40
        for _ in range(20):
            message = mavlink.MAVLink_command_long_message(1, 1, 401, 0, *[math.nan] * 7)
            station.send(message)
            await station.settle()
            await station.fly(0.1)
        await station.fly(1.0)
        assert 5 < len(station.of("COMMAND_ACK")) < 20

    with_station(story, "loss=0.2", "delay=0.2")


def test_faults_on_the_ground_begin_at_once_and_end() -> None:
    async def story(station: GroundStation) -> None:
        assert await station.command(ARM, 1.0) == DENIED
        await station.fly(12.0)
        assert await station.command(ARM, 1.0) == mavlink.MAV_RESULT_ACCEPTED

    with_station(story, "unarmable+10", "gps+9")


def test_a_fault_at_run_time_begins_at_once() -> None:
    async def story(station: GroundStation) -> None:
        station.simulation.faults.add(parse_fault("silence+3"))
        station.heard.clear()
        await station.fly(2.9)
        assert station.heard == []
        await station.fly(1.0)
        assert station.of("ATTITUDE")

    with_station(story)


def test_parameters_can_be_set_before_boot() -> None:
    async def story(station: GroundStation) -> None:
        assert station.last("HEARTBEAT").get_srcSystem() == 42
        station.send(mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1.0, *[math.nan] * 6))
        await station.settle()
        assert not station.simulation.autopilot.commander.is_armed
        station.send(mavlink.MAVLink_command_long_message(42, 1, ARM, 0, 1.0, *[math.nan] * 6))
        await station.settle()
        assert station.simulation.autopilot.commander.is_armed

    with_station(story, "MAV_SYS_ID=42")


def test_setpoints_are_ignored() -> None:
    async def story(station: GroundStation) -> None:
        setpoint = mavlink.MAVLink_set_position_target_local_ned_message(
            *(0, 1, 1, 1, 2503), *[0.0] * 11
        )
        station.send(setpoint)
        await station.settle()
        autopilot = station.simulation.autopilot
        autopilot.request_mode(Px4Mode.OFFBOARD)
        await station.fly(0.1)
        assert autopilot.commander.can_arm
        station.simulation.faults.add(parse_fault("ignore"))
        for _ in range(15):
            await station.fly(0.1)
            station.send(setpoint)
        assert not autopilot.commander.can_arm

    with_station(story)


def test_a_pilot_takes_over_and_gives_back() -> None:
    mission = make_mission()
    simulation = MockFlight(mission, World(mission), (parse_fault("pilot@22+3"),))
    autopilot = simulation.autopilot
    autopilot.parameters.set("MIS_TAKEOFF_ALT", 10.0)
    modes = []
    for step in range(round(34.0 / STEP_S)):
        simulation.step()
        if step == 600:
            assert autopilot.arm()
            autopilot.request_mode(Px4Mode.TAKEOFF)
        if step > 2500 and step % 10 == 0:
            autopilot.take_offboard(autopilot.setpoint)
        if step == 2600:
            assert autopilot.request_mode(Px4Mode.OFFBOARD)
        if not modes or autopilot.commander.mode is not modes[-1]:
            modes.append(autopilot.commander.mode)
    flown = [Px4Mode.TAKEOFF, Px4Mode.LOITER, Px4Mode.OFFBOARD, Px4Mode.POSCTL, Px4Mode.OFFBOARD]
    assert modes == [Px4Mode.LOITER, *flown]


def test_strangers_do_not_disturb() -> None:
    async def story(station: GroundStation) -> None:
        stranger = mavlink.MAVLink(None, srcSystem=77, srcComponent=1)
        for target in (2, 77, 255):
            offboard = mavlink.MAVLink_set_mode_message(target, 1, Px4Mode.OFFBOARD)
            station.send_bytes(offboard.pack(stranger))
        for system in (77, 78, 255):
            sender = mavlink.MAVLink(None, srcSystem=system, srcComponent=190)
            beat = mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
            station.send_bytes(beat.pack(sender))
        for target in (0, 2, 77):
            arm = mavlink.MAVLink_command_long_message(target, 1, ARM, 0, 1.0, *[math.nan] * 6)
            station.send_bytes(arm.pack(stranger))
        await station.settle()
        await station.fly(1.1)
        assert station.last("HEARTBEAT").custom_mode == Px4Mode.LOITER
        assert not station.simulation.autopilot.commander.is_armed
        ours = mavlink.MAVLink_set_mode_message(1, 1, Px4Mode.OFFBOARD)
        station.send_bytes(ours.pack(stranger))
        await station.settle()
        await station.fly(1.1)
        assert station.last("HEARTBEAT").custom_mode == Px4Mode.OFFBOARD

    with_station(story)


def test_a_signed_link_hears_only_what_is_signed() -> None:
    key = bytes(range(32))

    async def tell() -> None:
        mission = make_mission()
        simulation = MockFlight(mission, World(mission))
        link = MavlinkLink(simulation.autopilot, ("127.0.0.1", 1), {}, random.Random(0), key)
        for _ in range(600):
            simulation.step()
        arm = mavlink.MAVLink_command_long_message(1, 1, ARM, 0, 1.0, *[math.nan] * 6)
        station = mavlink.MAVLink(None, srcSystem=245, srcComponent=190)
        link.datagram_received(arm.pack(station), ("127.0.0.1", 1))
        assert not simulation.autopilot.commander.is_armed
        station.signing.secret_key, station.signing.sign_outgoing = key, True
        station.signing.timestamp = round((time.time() - 1_420_070_400) * 1e5)
        link.datagram_received(arm.pack(station), ("127.0.0.1", 1))
        assert simulation.autopilot.commander.is_armed

    asyncio.run(tell())


# --- garbage


@pytest.mark.parametrize("num_batches", [50, pytest.param(500, marks=pytest.mark.slow)])
def test_any_datagrams_do_no_harm(num_batches: int) -> None:
    mission = make_mission()
    simulation = MockFlight(mission, World(mission))
    link = MavlinkLink(simulation.autopilot, ("127.0.0.1", 1), {}, random.Random(10_005))
    own = ("COMMAND_", "MISSION_", "PARAM_", "SET_", "FILE_", "PING", "TIMESYNC", "HEARTBEAT")

    @settings(max_examples=num_batches)
    @given(st.lists(datagrams(own, (245, 190)), min_size=20, max_size=20))
    def check(batch: list[bytes]) -> None:
        for number, datagram in enumerate(batch):
            link.datagram_received(datagram, ("127.0.0.1", 1))
            if number % 5 == 0:
                simulation.step()
                link.stream([])
        assert all(math.isfinite(value) for value in simulation.autopilot.body.position)

    for _ in range(600):  # it hears nothing before it has booted
        simulation.step()
    check()


# --- the camera


SIZE = CameraModel(width_px=64, height_px=48, horizontal_fov_rad=1.0)


async def capture_many(camera: SimulatedCamera) -> None:
    for _ in range(100):
        await camera.capture()


def pictures(faults: dict[str, float], story: Callable[..., Any]) -> None:
    """Tell a story with a camera and a clock that goes on by 0.1 s whenever it is looked at."""
    mission = make_mission()
    simulation = MockFlight(mission, World(mission))
    ticks = iter(range(10**6))

    def scene() -> Scene:
        now = simulation.scene()
        return replace(now, pose=replace(now.pose, time_s=next(ticks) * 0.1))

    async def tell() -> None:
        async with (
            CameraServer(SIZE, 1, scene, lambda _: None, faults) as server,
            SimulatedCamera(f"tcp://127.0.0.1:{server.port}", 2.0) as camera,
        ):
            await story(camera)

    asyncio.run(tell())


@pytest.mark.lengthy
def test_pictures_are_blank() -> None:
    async def story(camera: SimulatedCamera) -> None:
        assert (await camera.capture()).image.max() == 0

    pictures({"blank": 1.0}, story)


@pytest.mark.lengthy
def test_pictures_are_misdated() -> None:
    async def story(camera: SimulatedCamera) -> None:
        assert (await camera.capture()).time_s == pytest.approx(-2.0, abs=0.5)

    pictures({"misdate": -2.0}, story)


def test_pictures_are_late() -> None:
    async def story(camera: SimulatedCamera) -> None:
        first, second = await camera.capture(), await camera.capture()
        assert second.time_s - first.time_s > 3.0

    pictures({"late": 3.0}, story)


def test_some_animals_are_hidden_and_some_are_not_there() -> None:
    mission = make_mission()
    true = MockFlight(mission, World(mission)).scene()
    rng = random.Random(1)
    shown = [with_faults(true, {"hide": 0.3, "decoy": 0.6}, rng).animals for _ in range(1000)]
    decoys = [a for animals in shown for a in animals if a not in true.animals]
    num_true = sum(map(len, shown)) - len(decoys)
    assert num_true == pytest.approx(700 * len(true.animals), rel=0.1)
    assert len(decoys) == pytest.approx(600, rel=0.1)
    below, reach_m = true.pose.position_ned_m[:2], 0.1 * true.frame.side_m
    assert all(math.dist(decoy.position_ned_m, below) <= reach_m for decoy in decoys)
    assert {decoy.appearance for decoy in decoys} == {a.appearance for a in true.animals}
    assert with_faults(true, {}, rng) == true


def test_some_animals_look_like_others_and_some_are_astray() -> None:
    mission = make_mission()
    true = MockFlight(mission, World(mission)).scene()
    rng = random.Random(1)
    shown = [with_faults(true, {"mistake": 0.2, "misplace": 3.0}, rng) for _ in range(1000)]
    pairs = [pair for s in shown for pair in zip(s.animals, true.animals, strict=True)]
    wrong = [a.appearance for a, b in pairs if a.appearance != b.appearance]
    assert len(wrong) / len(pairs) == pytest.approx(0.2, abs=0.02)
    assert set(wrong) == {a.appearance for a in true.animals}
    off_m = [a.position_ned_m[k] - b.position_ned_m[k] for a, b in pairs for k in (0, 1)]
    assert np.std(off_m) == pytest.approx(3.0, rel=0.05)


def test_the_camera_hides_animals_from_its_pictures_alone() -> None:
    mission = make_mission()
    simulation = MockFlight(mission, World(mission))
    above = simulation.scene()
    north_m, east_m = above.animals[0].position_ned_m
    pose = replace(above.pose, position_ned_m=(north_m, east_m, above.frame.ground_down_m - 15.0))
    taken: list[Scene] = []
    images = []

    async def tell(faults: dict[str, float]) -> None:
        scene = replace(above, pose=pose)
        async with (
            CameraServer(SIZE, 1, lambda: scene, taken.append, faults) as server,
            SimulatedCamera(f"tcp://127.0.0.1:{server.port}", 2.0) as camera,
        ):
            images.append((await camera.capture()).image)

    for faults in ({}, {"hide": 1.0}, {}):
        asyncio.run(tell(faults))
    np.testing.assert_array_equal(images[0], images[2])
    assert (images[0] != images[1]).any()
    assert taken[0] == taken[1], "the truth is told"


def test_a_picture_is_repeated() -> None:
    async def story(camera: SimulatedCamera) -> None:
        first = await camera.capture()
        second = await camera.capture()
        assert second.time_s == first.time_s
        np.testing.assert_array_equal(first.image, second.image)

    pictures({"repeat": 1.0}, story)


def test_a_frozen_view_has_new_times() -> None:
    async def story(camera: SimulatedCamera) -> None:
        first = await camera.capture()
        second = await camera.capture()
        assert second.time_s > first.time_s
        np.testing.assert_array_equal(first.image, second.image)

    pictures({"freeze": 1.0}, story)


def test_a_torn_picture_lacks_its_end() -> None:
    mission = make_mission()
    simulation = MockFlight(mission, World(mission))

    async def tell() -> None:
        faults = {"torn": 1.0}
        async with CameraServer(SIZE, 1, simulation.scene, lambda _: None, faults) as server:
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            writer.write(b"SHOT")
            _, _, count = struct.unpack("!4sdI", await reader.readexactly(16))
            jpeg = await reader.readexactly(count)
            writer.close()
        assert jpeg[:2] == b"\xff\xd8"
        assert jpeg[-2:] != b"\xff\xd9"

    asyncio.run(tell())


@pytest.mark.slow
def test_the_process_takes_faults_on_its_input(mock_vehicle: StartMockVehicle) -> None:
    vehicle = mock_vehicle("animals")

    async def tell() -> None:
        async with SimulatedCamera(vehicle.camera_url, 20.0) as camera:
            assert (await camera.capture()).image.any()
        vehicle.begin_fault("nonsense")
        vehicle.begin_fault("camera")
        async with SimulatedCamera(vehicle.camera_url, 1.0) as camera:
            with pytest.raises(CameraError, match="did not send a picture"):
                await capture_many(camera)

    asyncio.run(tell())

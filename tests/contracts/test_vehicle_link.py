"""What every vehicle link owes a mission: over MAVSDK and UDP to the simulator, and in memory."""

from __future__ import annotations

import asyncio
import math
from collections.abc import Awaitable, Callable

import numpy as np
import pytest
import virtual_time
from fake_link import FakeLink
from simulated_vehicle import ROOT, free_udp_port

from dronemon.errors import (
    CameraError,
    CommandUnconfirmed,
    ControlTaken,
    LinkLost,
    LinkTimeout,
)
from dronemon.frames import camera_to_ned
from dronemon.vehicle import Landed, Mode, Setpoint, VehicleLink
from dronemon.vehicle.fence_items import polygon_items
from dronemon.vehicle.mavsdk_link import MavsdkLink

Story = Callable[[VehicleLink], Awaitable[None]]


@pytest.fixture(params=["mavsdk", "fake"])
def with_link(request):
    """Run a story with a ready link to a fresh vehicle; `faults` as for `python -m sim`.

    It has a gimbal and a rangefinder.
    """

    async def tell(link: MavsdkLink | FakeLink, story: Story) -> None:
        async with asyncio.timeout(60 if request.param == "mavsdk" else 3600), link:
            await link.wait_ready(30.0)
            await story(link)

    def run(story: Story, *faults: str) -> None:
        if request.param == "fake":
            virtual_time.run(tell(FakeLink(faults=faults), story))
            return
        options = [word for fault in faults for word in ("--fault", fault)]
        start = request.getfixturevalue("mock_vehicle")
        mission = request.getfixturevalue("tmp_path") / "gimbal.yaml"
        mission.write_text(
            (ROOT / "missions" / "animals.yaml")
            .read_text()
            .replace("area:\n", "area:\n  rangefinder: true\n")
            + "camera: {gimbal: true}\n"
        )
        url = start(mission, "--speed-up", "20", *options).url
        link = MavsdkLink(url, command_timeout_s=9.0, link_loss_timeout_s=2.0)
        asyncio.run(tell(link, story))

    return run


in_memory_first = pytest.mark.parametrize(
    "with_link", ["fake", pytest.param("mavsdk", marks=pytest.mark.slow)], indirect=True
)
"""For what need not fly in the simulator at every change: `make test-slow` does."""


def _here(link: VehicleLink, speed_m_s: float = 0.0) -> Setpoint:
    return Setpoint(
        position_ned_m=link.pose.position_ned_m,
        velocity_ned_m_s=(speed_m_s, 0.0, 0.0),
        yaw_rad=0.0,
    )


async def _hover(link: VehicleLink, duration_s: float) -> None:
    end_s = link.time_s + duration_s
    while link.time_s < end_s:
        await link.next_pose()
        await link.send_setpoint(_here(link))


@pytest.mark.lengthy
def test_a_flight_is_confirmed_step_by_step(with_link):
    async def story(link: VehicleLink) -> None:
        assert link.state.home is not None
        assert link.state.origin is not None
        assert not link.state.is_armed
        assert await link.read_fence() == ()
        fence = polygon_items([(47.39, 8.5), (47.41, 8.5), (47.40123456, 8.6)])
        await link.write_fence(fence)
        assert await link.read_fence() == fence
        await link.write_fence(())
        assert await link.read_fence() == ()
        await link.arm()
        assert link.state.is_armed
        down_m = link.pose.position_ned_m[2]
        await link.take_off(12.0)
        assert down_m - link.pose.position_ned_m[2] == pytest.approx(12.0, abs=1.5)
        await link.start_offboard(_here(link))
        assert link.state.mode is Mode.OFFBOARD
        await _hover(link, 3.0)
        await link.hold()
        assert link.state.mode is Mode.HOLD
        await link.return_home()
        assert link.state.mode is Mode.RETURN
        await link.land()
        assert link.state.mode is Mode.LAND
        await link.wait_until(lambda: not link.state.is_armed, "disarming", 120.0)
        assert link.state.landed is Landed.ON_GROUND

    with_link(story)


@in_memory_first
def test_poses_come_in_order_and_enclose_an_instant(with_link):
    async def story(link: VehicleLink) -> None:
        times = [(await link.next_pose()).time_s for _ in range(50)]
        assert times == sorted(set(times))
        asked_s = link.time_s + 0.5
        before, after = await link.poses_around(asked_s)
        assert before.time_s <= asked_s <= after.time_s
        assert after.time_s - before.time_s < 0.2
        assert all(math.isfinite(v) for v in before.position_ned_m + before.attitude_rad)

    with_link(story)


@in_memory_first
def test_a_gimbal_is_pointed_down_and_heard(with_link):
    async def story(link: VehicleLink) -> None:
        await link.point_down()
        asked_s = link.time_s + 0.5
        before, after = await link.gimbal_around(asked_s)
        assert before.time_s <= asked_s <= after.time_s
        for attitude in (before, after):
            np.testing.assert_allclose(camera_to_ned(attitude, 0.0), np.eye(3), atol=0.01)

    with_link(story)


@in_memory_first
@pytest.mark.parametrize("fault", [(), ("range@1",)], ids=["ground", "none"])
def test_how_far_the_ground_is_below_is_told_of_an_instant(with_link, fault):
    async def story(link: VehicleLink) -> None:
        assert link.state.range_limits_m == pytest.approx((0.1, 120.0))
        ground_down_m = link.pose.position_ned_m[2]
        await link.arm()
        await link.take_off(20.0)
        if fault:
            with pytest.raises(CameraError, match=r"finds no ground 0\.1 to 120 m below"):
                await link.range_at(link.time_s + 0.3)
        else:
            asked_s = link.time_s + 0.3
            range_m = await link.range_at(asked_s)
            _, after = await link.poses_around(asked_s)
            assert range_m == pytest.approx(ground_down_m - after.position_ned_m[2], abs=1.0)

    with_link(story, *fault)


@in_memory_first
@pytest.mark.parametrize(
    ("fault", "words"),
    [("gimbal", "no attitude of a gimbal is heard"), ("askew=30", "looks 30 degrees off")],
)
def test_a_gimbal_that_is_silent_or_looks_elsewhere_is_told(with_link, fault, words):
    async def story(link: VehicleLink) -> None:
        with pytest.raises(CommandUnconfirmed, match=words):
            await link.point_down()
        if fault == "gimbal":
            with pytest.raises(CameraError, match="attitude at the picture's instant was not h"):
                await link.gimbal_around(link.time_s)

    with_link(story, fault)


@in_memory_first
def test_waiting_has_a_limit_in_vehicle_time(with_link):
    async def story(link: VehicleLink) -> None:
        began_s = link.time_s
        with pytest.raises(CommandUnconfirmed, match=r"the moon: not seen .* after 5 s .*disarmed"):
            await link.wait_until(lambda: False, "the moon", 5.0)
        assert 5.0 <= link.time_s - began_s < 8.0

    with_link(story)


@in_memory_first
def test_the_pilot_wins(with_link):
    async def story(link: VehicleLink) -> None:
        await link.arm()
        await link.take_off(5.0)
        await link.start_offboard(_here(link))
        with pytest.raises(ControlTaken, match="the pilot chose mode 'position'"):
            await _hover(link, 120.0)
        assert link.state.mode is Mode.POSITION
        link.release()
        await link.next_pose()

    with_link(story, "pilot@20")


@in_memory_first
def test_silence_is_noticed(with_link):
    async def story(link: VehicleLink) -> None:
        await link.arm()
        await link.take_off(5.0)
        with pytest.raises(LinkLost, match=r"nothing heard .* for 2 s"):
            await link.wait_until(lambda: False, "never", 300.0)

    with_link(story, "silence@15")


@in_memory_first
def test_setpoints_that_stop_end_offboard(with_link):
    async def story(link: VehicleLink) -> None:
        await link.arm()
        await link.take_off(5.0)
        await link.start_offboard(_here(link))
        with pytest.raises(ControlTaken, match="failsafe"):
            await link.wait_until(lambda: False, "never", 30.0)
        assert link.state.is_failsafe

    with_link(story)


def test_nobody_there():
    async def listen() -> None:
        url = f"udpin://127.0.0.1:{free_udp_port()}"
        async with MavsdkLink(url, connect_timeout_s=0.5):
            pass

    with pytest.raises(LinkTimeout, match=r"no autopilot heard on .* after 0.5 s"):
        asyncio.run(listen())


def test_a_url_that_cannot_be_opened():
    async def connect() -> None:
        async with MavsdkLink("udpin://300.0.0.1:14540", connect_timeout_s=0.5):
            pass

    with pytest.raises(LinkTimeout, match="cannot open"):
        asyncio.run(connect())

"""A flight over a link that loses and delays messages either way."""

from __future__ import annotations

import asyncio
import contextlib

import numpy as np
import pytest
from simulated_vehicle import free_udp_port

from dronemon.vehicle import Mode, Setpoint
from dronemon.vehicle.mavsdk_link import MavsdkLink

LOSS, DELAY_S = 0.2, 0.2


class Side(asyncio.DatagramProtocol):
    """One end of a lossy wire; what it hears leaves at the other end, later or never."""

    def __init__(self, rng, remote=None):
        self.rng, self.remote = rng, remote
        self.other = None

    def connection_made(self, transport):
        self.transport = transport

    def datagram_received(self, data, addr):
        self.remote = addr
        if self.rng.random() >= LOSS:
            asyncio.get_running_loop().call_later(DELAY_S, self.other.send, data)

    def error_received(self, exc):
        pass

    def send(self, data):
        if self.remote is not None and not self.transport.is_closing():
            self.transport.sendto(data, self.remote)


@contextlib.asynccontextmanager
async def lossy_wire(vehicle_port, client_port):
    """Join where a vehicle sends to with where a client listens."""
    loop, rng = asyncio.get_running_loop(), np.random.default_rng(0)
    _, vehicle = await loop.create_datagram_endpoint(
        lambda: Side(rng), local_addr=("127.0.0.1", vehicle_port)
    )
    _, client = await loop.create_datagram_endpoint(
        lambda: Side(rng, ("127.0.0.1", client_port)), local_addr=("127.0.0.1", 0)
    )
    vehicle.other, client.other = client, vehicle
    try:
        yield
    finally:
        for side in (vehicle, client):
            side.transport.close()


@pytest.mark.slow
def test_a_flight_survives_loss_and_delay(mock_vehicle):
    port = free_udp_port()
    url = f"udpin://127.0.0.1:{port}"
    vehicle_url = mock_vehicle("animals", "--speed-up", "1").url
    wire = lossy_wire(int(vehicle_url.rpartition(":")[2]), port)

    async def fly():
        async with asyncio.timeout(200.0), wire, MavsdkLink(url) as link:
            await link.wait_ready(30.0)
            await link.arm()
            await link.take_off(5.0)
            here = Setpoint(
                position_ned_m=link.pose.position_ned_m,
                velocity_ned_m_s=(0.0, 0.0, 0.0),
                yaw_rad=0.0,
            )
            await link.start_offboard(here)
            end_s = link.time_s + 20.0
            while link.time_s < end_s:
                await link.next_pose()
                await link.send_setpoint(here)
            assert link.state.mode is Mode.OFFBOARD
            await link.hold()
            await link.land()
            await link.wait_until(lambda: not link.state.is_armed, "landing", 120.0)
            assert link.state.num_unreadable == 0

    asyncio.run(fly())

"""How a mission meets its vehicle and its camera, real or simulated."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator

from dronemon.camera import FrameSource, RectifiedCamera, SimulatedCamera, VideoCamera
from dronemon.mission import Mission
from dronemon.simulator import Simulator
from dronemon.vehicle.mavsdk_link import MavsdkLink
from dronemon.vision.lens import Rectifier


def make_link(mission: Mission, sim: Simulator | None) -> MavsdkLink:
    """The link to a mission's vehicle, or to the simulated one."""
    vehicle = mission.vehicle
    url = sim.vehicle_url if sim and sim.vehicle_url else vehicle.url
    return MavsdkLink(
        url,
        is_port_held=url != vehicle.url,
        system_id=vehicle.system_id,
        connect_timeout_s=vehicle.connect_timeout_s,
        command_timeout_s=vehicle.command_timeout_s,
        link_loss_timeout_s=vehicle.link_loss_timeout_s,
    )


def make_camera(mission: Mission, sim: Simulator | None, link: MavsdkLink) -> FrameSource:
    """A mission's camera, or the simulated one, as a perfect one would see. Raises CameraError."""
    source, rectifier = _raw_camera(mission, sim, link), Rectifier.of_mission(mission)
    model = mission.camera.model
    return source if rectifier is None else RectifiedCamera(source, rectifier, model)


def _raw_camera(mission: Mission, sim: Simulator | None, link: MavsdkLink) -> FrameSource:
    camera = mission.camera
    if camera.is_simulated:
        assert sim is not None  # load_checked
        return SimulatedCamera(sim.camera_url, timeout_s=camera.timeout_s)
    source = int(camera.url) if camera.url.isdigit() else camera.url
    return VideoCamera(source, timeout_s=camera.timeout_s, latency_s=camera.latency_s, clock=link)


@contextlib.asynccontextmanager
async def watching(mission: Mission) -> AsyncIterator[tuple[MavsdkLink, FrameSource]]:
    """Link to a real vehicle and its camera, as it sees; nothing is commanded.

    Raises VehicleError, CameraError.
    """
    async with make_link(mission, None) as link:
        await link.next_pose()
        async with _raw_camera(mission, None, link) as camera:
            yield link, camera

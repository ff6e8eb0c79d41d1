"""Takes a picture when one is due, looks at it, and tells the beliefs what it shows."""

from __future__ import annotations

import asyncio
import math
from collections import deque
from functools import partial

from dronemon.belief import Belief
from dronemon.camera import Freshness, check_picture
from dronemon.errors import CameraError
from dronemon.events import EventStream
from dronemon.frames import AreaFrame
from dronemon.runner.battery import Battery
from dronemon.runner.daemon import in_daemon_thread
from dronemon.runner.eyes import Eyes, Shot
from dronemon.runner.preparation import LOOK_LIMIT_S, FlightSetup
from dronemon.runner.relief import surface_of
from dronemon.runner.tally import Tally
from dronemon.sightings import Sightings
from dronemon.types import Picture
from dronemon.vision.ground_error import told_covariance
from dronemon.vision.project import ground_below_m, interpolate_pose, on_gimbal, turning
from dronemon.vision.surface import Plane

BLIND_LIMIT_S = 30.0
"""Vehicle time for which the patrol goes on while too few pictures say anything, ..."""
_BLIND_PICTURES = 3
"""... and number of pictures that must have failed by then."""
_ENOUGH, _NEWEST = 0.15, 0.2
"""Share of pictures before one that says something: a quarter of them is enough, a fifth is not;
the newest picture's weight in it."""
_MAX_PENDING = 8
"""Pictures that wait to be looked at; while there are so many, none is taken."""


class Observer:
    """Has the patrol's pictures taken and looked at.

    tally: is given when it begins, or goes on
    """

    def __init__(
        self,
        setup: FlightSetup,
        events: EventStream,
        frame: AreaFrame,
        battery: Battery,
        tally: Tally | None,
    ) -> None:
        self._setup = setup
        self._mission = setup.file.mission
        self._link = setup.link
        self._events = events
        self._battery = battery
        self._unseen: deque[Shot] = deque()  # taken and not yet looked at
        self._pictured_s = -math.inf  # vehicle time of the newest picture
        self._freshness = Freshness()
        self._blind_since_s: float | None = None
        self._num_blind = 0  # since then
        self._share = 1.0  # of pictures, of late, that said something
        self._told_s = -math.inf
        self._due = asyncio.Event()
        self._is_taking = False
        self.tally = tally
        sightings = (
            tally.sightings if tally else Sightings(setup.priors_au, self._mission.sensor.model)
        )
        home, origin = self._link.state.home, self._link.state.origin
        assert home is not None  # wait_ready waited for both
        assert origin is not None
        surface = surface_of(self._mission, frame, home, origin)
        self._eyes = Eyes(self._mission, setup.detector, events, frame, surface, sightings)

    @property
    def belief(self) -> Belief:
        """What the pictures have told so far."""
        return self._eyes.belief

    @property
    def is_taking(self) -> bool:
        """Whether a picture is due or under way."""
        return self._is_taking or self._due.is_set()

    @property
    def has_unseen(self) -> bool:
        """Whether a picture waits to be looked at."""
        return bool(self._unseen)

    def is_blind(self, now_s: float) -> bool:
        """Whether too few pictures have said anything for too long."""
        since_s = self._blind_since_s
        is_long = since_s is not None and now_s > since_s + BLIND_LIMIT_S
        return is_long and self._num_blind >= _BLIND_PICTURES

    def ask(self) -> None:
        """A picture is due now."""
        if self._due.is_set():
            self._miss(
                CameraError("the camera is slow: a picture came later than the next was due")
            )
        self._due.set()

    def resume(self) -> None:
        """Forget how long nothing was seen, but not what was taken."""
        self._blind_since_s, self._share, self._is_taking = None, 1.0, False
        self._freshness = Freshness()
        self._due.clear()

    async def photograph(self, work: asyncio.Event) -> None:
        """Take every picture that is asked for, and say that there is work."""
        while True:
            await self._due.wait()
            self._due.clear()
            self._is_taking = True
            try:
                if len(self._unseen) >= _MAX_PENDING:
                    raise CameraError(f"the detector is slow: {_MAX_PENDING} pictures wait for it")
                picture = await self._setup.camera.capture()
                now_s, last_s = self._link.time_s, self._pictured_s
                check_picture(picture, self._mission.camera.model, now_s, last_s)
                self._pictured_s = picture.time_s
                shot = await self._placed(picture)
                self._freshness.check(picture, shot.pose)
            except CameraError as exc:
                self._miss(exc)
            else:
                self._unseen.append(shot)
                work.set()
            finally:
                self._is_taking = False

    async def _placed(self, picture: Picture) -> Shot:
        """A picture, and where and how its camera was then. Raises CameraError."""
        before, after = await self._link.poses_around(picture.time_s)
        pose, turn_rad_s = interpolate_pose(before, after, picture.time_s), turning(before, after)
        errors, state = self._mission.errors, self._link.state
        accuracy_m, height_accuracy_m, surface = state.accuracy_m, state.height_accuracy_m, None
        if self._mission.area.rangefinder:  # which leaves what the ground rises to the target
            surface = Plane(ground_below_m(pose, await self._link.range_at(picture.time_s)))
            height_accuracy_m = 0.0
        if self._mission.camera.gimbal:
            pose = on_gimbal(pose, *await self._link.gimbal_around(picture.time_s))
            turn_rad_s = 0.0, 0.0, turn_rad_s[2]  # it is held level
        told = told_covariance(errors, pose, turn_rad_s, accuracy_m, height_accuracy_m)
        return Shot(picture=picture, pose=pose, told=told, surface=surface)

    def _miss(self, exc: CameraError) -> None:
        """A picture says nothing: for a while the beliefs do without."""
        now_s = self._link.time_s
        self._share *= 1.0 - _NEWEST
        if self._blind_since_s is None:
            self._blind_since_s, self._num_blind = now_s, 0
            if now_s > self._told_s + BLIND_LIMIT_S:
                self._told_s = now_s
                what = f"{exc}; the patrol goes on without for {BLIND_LIMIT_S:g} s at most"
                self._events.note("camera", what, level="WARN")
        self._num_blind += 1

    def _see(self) -> None:
        """A picture says something; where few do, one alone does not mean that all is well."""
        if self._share >= _ENOUGH:
            self._blind_since_s = None
        self._share += _NEWEST * (1.0 - self._share)

    async def look_at_the_rest(self) -> None:
        """Look at the pictures that were taken and not yet looked at when the patrol ended."""
        while self._unseen:
            await self.look()

    async def look(self) -> None:
        """Look at the oldest picture taken. One that says nothing is told, and counts."""
        try:
            await self._look(self._unseen[0])
        except CameraError as exc:
            self._unseen.popleft()
            self._miss(exc)

    async def _look(self, shot: Shot) -> None:
        tally = self.tally
        assert tally is not None  # pictures are asked for only once the patrol has begun
        look = partial(self._eyes.look, shot, tally.start_s)
        glance = await in_daemon_thread(look, "the detector", CameraError, LOOK_LIMIT_S)
        battery, needed = self._link.state.battery, self._battery.needed
        self._eyes.tell(glance, tally, battery=battery, battery_needed=needed)
        self._unseen.popleft()
        self._see()
        self._eyes.believe(glance)

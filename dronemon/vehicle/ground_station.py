"""MAVLink messages to a ground station such as QGroundControl, beside the vehicle's own.

They go to the station alone, never to the vehicle: an autopilot that is told of traffic may evade.
"""

from __future__ import annotations

from pymavlink.dialects.v20 import common as mavlink

from dronemon.frames import GeoPoint

_FIRST_ADDRESS = 0xF00000
"""Of the 24-bit aircraft addresses, the first of a block that no state hands out."""
_CALLSIGN_LENGTH, _TEXT_LENGTH = 8, 50


class StationMessages:
    """Packs messages that come from a companion computer of the vehicle with this system id."""

    def __init__(self, system_id: int) -> None:
        self._mavlink = mavlink.MAVLink(
            None, srcSystem=system_id, srcComponent=mavlink.MAV_COMP_ID_ONBOARD_COMPUTER
        )

    def text(self, text: str) -> bytes:
        """A STATUSTEXT, which the station shows and may read out; what is too long is cut."""
        told = text.encode("ascii", "replace")[:_TEXT_LENGTH]
        message = self._mavlink.statustext_encode(mavlink.MAV_SEVERITY_INFO, told)
        packed: bytes = message.pack(self._mavlink)
        return packed

    def marker(self, number: int, name: str, place: GeoPoint) -> bytes:
        """An ADSB_VEHICLE: the station marks a target, by its number, on its map."""
        flags = mavlink.ADSB_FLAGS_VALID_COORDS | mavlink.ADSB_FLAGS_VALID_CALLSIGN
        message = self._mavlink.adsb_vehicle_encode(
            ICAO_address=_FIRST_ADDRESS + number,
            lat=round(place.latitude_deg * 1e7),
            lon=round(place.longitude_deg * 1e7),
            altitude_type=mavlink.ADSB_ALTITUDE_TYPE_GEOMETRIC,
            altitude=round(place.altitude_m * 1e3),
            heading=0,
            hor_velocity=0,
            ver_velocity=0,
            callsign=name.encode("ascii", "replace")[:_CALLSIGN_LENGTH],
            emitter_type=mavlink.ADSB_EMITTER_TYPE_SERVICE_SURFACE,
            tslc=0,
            flags=flags,
            squawk=0,
        )
        packed: bytes = message.pack(self._mavlink)
        return packed

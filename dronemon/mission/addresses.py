"""What names a vehicle's link or a camera's pictures, judged by its form alone."""

from __future__ import annotations

import re

_NETWORK_SCHEMES = ("udpin", "udpout", "tcpin", "tcpout")


def mavlink_url_problem(url: str) -> str | None:
    """Say why a URL names no MAVLink connection, if so, with one of the right form."""
    scheme, separator, rest = url.partition("://")
    match = re.fullmatch(r"([^\s:/]+):(\d+)", rest)
    if not separator or scheme not in (*_NETWORK_SCHEMES, "serial"):
        guess = {"udp": "udpin", "tcp": "tcpout"}.get(scheme, "udpin")
        rest = rest if match else "127.0.0.1:14540"
        return (
            f"{url!r} is not of the form udpin://IP:PORT (also udpout, tcpin, tcpout) or "
            f"serial://DEVICE:BAUD; did you mean {guess}://{rest}?"
        )
    if scheme == "serial":
        if re.fullmatch(r"[^\s:]+(:\d+)?", rest):
            return None
        return f"{url!r} is not serial://DEVICE:BAUD, as in serial:///dev/ttyACM0:57600"
    if match is None:
        return f"{url!r} is not {scheme}://IP:PORT, such as {scheme}://127.0.0.1:14540"
    if not 0 < int(match[2]) < 65536:
        return f"the port of {url!r} is {match[2]}, not 1 to 65535"
    return None


def parse_udpin(url: str) -> tuple[str, int]:
    """IP and port of udpin://IP:PORT, where a simulator follows a vehicle. Raises ValueError."""
    match = re.fullmatch(r"udpin://(\d{1,3}(?:\.\d{1,3}){3}):(\d{1,5})", url)
    if match is None or not 0 < int(match[2]) < 65536:
        raise ValueError(f"{url!r} is not udpin://IP:PORT, such as udpin://127.0.0.1:14550")
    return match[1], int(match[2])


def is_video_file(camera_url: str) -> bool:
    """Whether pictures come from a file: neither the simulator, a camera's number nor a stream."""
    return camera_url != "simulated" and not camera_url.isdigit() and "://" not in camera_url

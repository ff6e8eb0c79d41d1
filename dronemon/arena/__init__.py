"""Where targets and drone may be."""

from dronemon.arena.arena import ARENA, Arena
from dronemon.arena.detours import detour, into
from dronemon.arena.region import ROUNDING_AU, Region
from dronemon.arena.ways import CLEAR_AU, Ways

__all__ = ["ARENA", "CLEAR_AU", "ROUNDING_AU", "Arena", "Region", "Ways", "detour", "into"]

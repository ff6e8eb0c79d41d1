"""A person's interrupts, however quickly they come one after the other."""

from __future__ import annotations

import asyncio

import pytest

from dronemon.runner.interrupts import Interrupted, Interrupts


def test_a_request_while_it_is_being_left_is_counted():
    interrupts = Interrupts()

    async def wait():
        async with interrupts.leaving():
            interrupts.request()
            try:
                await asyncio.sleep(60.0)
            finally:
                interrupts.request()

    with pytest.raises(Interrupted):
        asyncio.run(wait())
    assert interrupts.count == 2

"""What is changed on a vehicle is put back, also by another program after a crash."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

import pytest
import virtual_time
from fake_link import FakeLink

from dronemon.errors import CommandRejected, OptionError, RecordError
from dronemon.vehicle.changes import Changes, state_folder
from dronemon.vehicle.fence_items import FenceItem, polygon_items
from dronemon.vehicle.parameters import as_float32


@pytest.fixture
def after():
    """Runs a story with a fresh link to one vehicle, and its changes. -> what was told"""
    shared = FakeLink().vehicle

    def run(story) -> list[str]:
        told: list[str] = []

        async def tell() -> None:
            async with FakeLink() as link:
                link.vehicle = shared
                await link.wait_ready(10.0)
                with Changes(link, told.append) as changes:
                    await asyncio.wait_for(story(link, changes), 60.0)

        virtual_time.run(tell())
        return told

    run.vehicle = shared
    return run


def test_a_change_is_kept_before_it_is_made_and_put_back_once(after):
    async def change(link: FakeLink, changes: Changes) -> None:
        write = link.write_parameter

        async def look(name: str, value: float) -> None:
            assert "GF_ACTION" in (state_folder() / "fake.json").read_text()
            await write(name, value)

        link.write_parameter = look
        await changes.make({"GF_ACTION": 5.0})

    assert after(change) == ["GF_ACTION is 5 for now; it was 3"]
    assert after.vehicle.parameters["GF_ACTION"] == 5.0

    async def put_back(_: FakeLink, changes: Changes) -> None:
        await changes.put_back()
        await changes.put_back()

    assert after(put_back) == ["GF_ACTION is 3 again, as before it was changed for us"]
    assert after.vehicle.parameters["GF_ACTION"] == 3.0
    assert list(state_folder().iterdir()) == []


def test_the_oldest_value_is_put_back_after_two_crashes(after):
    for value in (5.0, 1.0):

        async def change(_: FakeLink, changes: Changes, value: float = value) -> None:
            await changes.make({"GF_ACTION": value})

        after(change)

    async def put_back(_: FakeLink, changes: Changes) -> None:
        await changes.put_back()

    after(put_back)
    assert after.vehicle.parameters["GF_ACTION"] == 3.0


@pytest.mark.parametrize(("asked", "reads"), [(2.0**24 + 1, 2.0**24 + 1), (0.1, as_float32(0.1))])
def test_a_whole_number_and_one_that_is_not_are_known_again_as_they_read(after, asked, reads):
    async def story(link: FakeLink, changes: Changes) -> None:
        await changes.make({"GF_ACTION": asked})
        link.vehicle.parameters["GF_ACTION"] = reads
        await changes.put_back()

    after(story)
    assert after.vehicle.parameters["GF_ACTION"] == 3.0


def test_what_no_parameter_can_hold_is_refused_before_anything_is_kept(after):
    async def story(_: FakeLink, changes: Changes) -> None:
        with pytest.raises(OptionError, match="more than a parameter can hold"):
            await changes.make({"GF_ACTION": 1e300})

    after(story)
    assert list(state_folder().iterdir()) == []


def test_what_somebody_changed_meanwhile_is_left(after):
    async def story(link: FakeLink, changes: Changes) -> None:
        await changes.make({"GF_ACTION": 5.0})
        link.vehicle.parameters["GF_ACTION"] = 1.0
        await changes.put_back()

    assert "is left as it is" in after(story)[-1]
    assert after.vehicle.parameters["GF_ACTION"] == 1.0


def test_nothing_is_changed_or_put_back_while_it_is_armed(after):
    async def story(link: FakeLink, changes: Changes) -> None:
        await changes.make({"GF_ACTION": 5.0})
        await link.arm()
        for step in (changes.put_back(), changes.make({"GF_ACTION": 1.0})):
            with pytest.raises(CommandRejected, match="armed"):
                await step

    after(story)
    assert after.vehicle.parameters["GF_ACTION"] == 5.0
    assert list(state_folder().iterdir()) != []


def test_nothing_is_changed_that_could_not_be_put_back(after):
    async def unreadable(link: FakeLink, changes: Changes) -> None:
        link.vehicle.parameters["GF_ACTION"] = float("nan")
        with pytest.raises(CommandRejected, match="this link cannot read"):
            await changes.make({"GF_ACTION": 5.0})

    async def no_disk(link: FakeLink, changes: Changes) -> None:
        link.vehicle.parameters["GF_ACTION"] = 2.0
        (state_folder() / ".fake.json.part").mkdir(parents=True)
        with pytest.raises(RecordError, match="nothing was changed"):
            await changes.make({"GF_ACTION": 5.0})

    after(unreadable)
    after(no_disk)
    assert after.vehicle.parameters["GF_ACTION"] == 2.0


OWN = (FenceItem(command=5004, param1=12.5, x=474_000_000, y=85_000_000),)
OURS = polygon_items([(47.39, 8.49), (47.41, 8.49), (47.4, 8.52)])


def test_a_fence_is_laid_before_the_vehicles_own_once_that_is_kept(after):
    after.vehicle.fence = OWN

    async def lay(link: FakeLink, changes: Changes) -> None:
        write = link.write_fence

        async def look(items: Sequence[FenceItem]) -> None:
            assert "12.5" in (state_folder() / "fake.fence.json").read_text()
            await write(items)

        link.write_fence = look
        await changes.lay_fence(OURS)

    async def put_back(_: FakeLink, changes: Changes) -> None:
        await changes.put_back()
        await changes.put_back()

    after(lay)
    assert after.vehicle.fence == (*OURS, *OWN)
    assert after(put_back) == ["its own fence is back: 1 corners and circles"]
    assert after.vehicle.fence == OWN
    assert list(state_folder().iterdir()) == []


def test_a_fence_that_somebody_changed_meanwhile_is_left(after):
    async def story(link: FakeLink, changes: Changes) -> None:
        await changes.lay_fence(OURS)
        link.vehicle.fence = OWN
        await changes.put_back()

    assert "is left as it is" in after(story)[-1]
    assert after.vehicle.fence == OWN


def test_no_fence_is_laid_or_put_back_while_it_is_armed(after):
    async def story(link: FakeLink, changes: Changes) -> None:
        await changes.lay_fence(OURS)
        await link.arm()
        for step in (changes.put_back(), changes.lay_fence(OURS)):
            with pytest.raises(CommandRejected, match="armed"):
                await step

    after(story)
    assert after.vehicle.fence == OURS


@pytest.mark.parametrize("text", ["", "[]", '{"old": []}', '{"old": [{}], "new": []}'])
def test_a_damaged_file_of_a_fence_is_named(after, text):
    state_folder().mkdir(parents=True)
    (state_folder() / "fake.fence.json").write_text(text)

    async def put_back(_: FakeLink, changes: Changes) -> None:
        with pytest.raises(RecordError, match=r"fake\.fence\.json cannot be read"):
            await changes.put_back()

    after(put_back)


def test_a_damaged_file_of_a_fence_keeps_no_parameter(after):
    after(lambda _, changes: changes.make({"GF_ACTION": 5.0}))
    (state_folder() / "fake.fence.json").write_text("")

    async def put_back(_: FakeLink, changes: Changes) -> None:
        with pytest.raises(RecordError, match=r"fake\.fence\.json cannot be read"):
            await changes.put_back()

    assert after(put_back) == ["GF_ACTION is 3 again, as before it was changed for us"]


@pytest.mark.parametrize("text", ["", "[]", '{"GF_ACTION": 3}', '{"GF_ACTION": {"old": "x"}}'])
def test_a_damaged_file_is_named(after, text):
    state_folder().mkdir(parents=True)
    (state_folder() / "fake.json").write_text(text)

    async def put_back(_: FakeLink, changes: Changes) -> None:
        with pytest.raises(RecordError, match=r"fake\.json cannot be read"):
            await changes.put_back()

    after(put_back)


def test_one_program_alone_changes_a_vehicle(after):
    async def story(link: FakeLink, changes: Changes) -> None:
        await changes.lay_fence(OURS)
        laid = link.vehicle.fence
        for change in (Changes.put_back, lambda c: c.make({"GF_ACTION": 5.0})):
            with (
                Changes(link, print) as second,
                pytest.raises(CommandRejected, match="another program flies or changes"),
            ):
                await change(second)
        assert link.vehicle.fence == laid
        await changes.put_back()

    after(story)
    after(story)  # who is at its end leaves the vehicle to others
    assert list(state_folder().iterdir()) == []

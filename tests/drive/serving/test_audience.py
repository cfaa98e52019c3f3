import asyncio
from typing import Any

from wcsim.drive.messages import spoken
from wcsim.drive.serving.server import _Audience, _PageLine

NOTICE = spoken("notice", {"kind": "note", "told": "read me"})


class SlowPage:
    """A connection that takes what it is sent, one thing after another, when it is let."""

    closed = False

    def __init__(self) -> None:
        self.got: list[Any] = []
        self.may = asyncio.Event()

    async def send_frame(self, data: Any, _: object) -> None:
        await self.may.wait()
        self.got.append(data)


def state(tick: int) -> bytes:
    return b'{"say":"state","tick":%d}' % tick


def pictures(number: int) -> bytes:
    return number.to_bytes(4, "little") + b"..."


async def sent_to(page: SlowPage, line: _PageLine) -> list[Any]:
    page.may.set()
    writing = asyncio.create_task(line.write())
    await asyncio.sleep(0.05)
    writing.cancel()
    return page.got


def test_a_slow_page_misses_states_and_never_a_line() -> None:
    async def drive() -> list[Any]:
        page = SlowPage()
        line = _PageLine(page)  # type: ignore[arg-type]
        line.put(NOTICE)
        for tick in range(1000):
            line.put(state(tick))
        return await sent_to(page, line)

    assert asyncio.run(drive()) == [NOTICE, state(999)]


def test_pictures_wait_for_those_before_and_the_newest_come() -> None:
    async def drive() -> list[Any]:
        page = SlowPage()
        line = _PageLine(page)  # type: ignore[arg-type]
        line.show(pictures(1))
        await sent_to(page, line)
        line.show(pictures(2))
        line.show(pictures(3))
        await sent_to(page, line)
        assert not line.free
        line.seen(7)  # none that was sent
        await sent_to(page, line)
        assert page.got == [pictures(1)]
        line.seen(1)
        return await sent_to(page, line)

    assert asyncio.run(drive()) == [pictures(1), pictures(3)]


def test_the_first_drives_and_after_it_who_comes_or_asks() -> None:
    async def drive() -> None:
        audience = _Audience()
        first, second, third = (_PageLine(SlowPage()) for _ in range(3))  # type: ignore[arg-type]
        audience.enter(first)
        audience.enter(second)
        assert audience.driver is first
        assert not audience.leave(second) and audience.driver is first
        audience.enter(second)
        assert audience.leave(first) and audience.driver is None
        audience.enter(third)
        assert audience.driver is third
        audience.take_over(second)
        assert audience.driver is second

    asyncio.run(drive())


def test_pictures_are_asked_for_once_and_only_where_a_page_takes_them() -> None:
    async def drive() -> None:
        audience = _Audience()
        assert not audience.wants()
        line = _PageLine(SlowPage())  # type: ignore[arg-type]
        audience.enter(line)
        assert [audience.wants(), audience.wants()] == [True, False]
        audience.show(pictures(1))
        assert not audience.wants(), "it has not shown these"

    asyncio.run(drive())

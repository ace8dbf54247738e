"""News of jobs: order, catching up, slow readers, the end."""

from __future__ import annotations

import asyncio
from typing import Any

from app.jobs.broadcast import REMEMBERED, Broadcast, News


def job(name: str, progress: float) -> dict[str, Any]:
    return {"id": name, "progress": progress}


async def read_all(broadcast: Broadcast, *published: dict[str, Any]) -> list[News]:
    with broadcast.reader() as reader:
        for each in published:
            await asyncio.to_thread(broadcast.publish, each)
        broadcast.close()
        return [news async for news in reader.news()]


def test_a_slow_reader_gets_the_latest_of_each_job_in_the_order_of_the_changes() -> None:
    news = asyncio.run(read_all(Broadcast(), job("a", 0.1), job("b", 0.2), job("a", 0.3)))
    assert [n.job for n in news] == [job("b", 0.2), job("a", 0.3)]


def test_a_reader_that_comes_back_hears_what_it_missed() -> None:
    broadcast = Broadcast()
    first = asyncio.run(read_all(broadcast, job("a", 0.1)))[0]
    for each in (job("b", 0.2), job("a", 0.9)):
        broadcast.publish(each)
    assert [n.job for n in broadcast.since(first.id) or ()] == [job("b", 0.2), job("a", 0.9)]


def test_what_cannot_be_known_is_not_guessed() -> None:
    broadcast = Broadcast()
    assert broadcast.since(None) is None
    assert broadcast.since("other.3") is None
    assert broadcast.since("no id at all") is None


def test_memory_is_bounded() -> None:
    broadcast = Broadcast()
    news = asyncio.run(read_all(broadcast, job("first", 0.0)))
    for i in range(REMEMBERED + 10):
        broadcast.publish(job(str(i), 0.0))
    assert len(broadcast.since(news[0].id) or ()) == REMEMBERED


def test_readers_that_left_do_not_disturb() -> None:
    broadcast = Broadcast()

    async def leave() -> None:
        with broadcast.reader():
            pass

    asyncio.run(leave())
    broadcast.publish(job("a", 1.0))
    assert asyncio.run(read_all(broadcast)) == []

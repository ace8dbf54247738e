"""Stamps: the typical step, the rate, and pauses, of clean, jittered, rounded and interrupted clocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.sensors import WheelLog
from core.timing import gaps, rate, typical_step


@pytest.mark.parametrize("n", [2, 3, 1000, 400_000])
@pytest.mark.parametrize("hz", [0.1, 20.0, 384.0])
def test_an_even_clock(n: int, hz: float) -> None:
    t = np.arange(n) / hz
    assert rate(t) == pytest.approx(hz, rel=1e-9)
    assert gaps(t).shape == (0, 2)


def test_too_few_stamps_have_no_rate() -> None:
    for n in (0, 1):
        assert typical_step(np.zeros(n)) == rate(np.zeros(n)) == 0.0
        assert gaps(np.zeros(n)).shape == (0, 2)


@pytest.mark.parametrize("n", [5_000, 400_000])
def test_stamps_in_whole_milliseconds_keep_their_rate(n: int) -> None:
    t = np.unique(np.round(np.arange(n) / 384.0, 3))
    assert rate(t) == pytest.approx(384.0, rel=3e-3)


def test_jitter_and_pauses_do_not_move_the_rate() -> None:
    rng = np.random.default_rng(3)
    n = 200_000
    t = np.sort(np.arange(n) / 100.0 + rng.uniform(-0.002, 0.002, n))
    kept = rng.random(n) > 0.05  # readings lost here and there
    t = t[kept]
    t[t.size // 2 :] += 600.0  # and a long pause
    assert rate(t) == pytest.approx(100.0, rel=5e-3)
    assert WheelLog(t, t, t).rate == rate(t)


def test_gaps_are_found_where_they_are() -> None:
    t = np.concatenate((np.arange(0, 10, 0.01), np.arange(20, 30, 0.01), np.arange(30.05, 40, 0.01)))
    np.testing.assert_allclose(gaps(t), [[9.99, 20.0]], rtol=0, atol=1e-9)
    assert gaps(t, factor=4).shape == (2, 2)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.integers(0, 3_000_000), max_size=8, unique=True), st.integers(1, 2_200_000))
def test_every_gap_is_found_across_chunks(breaks: list[int], n: int) -> None:
    steps = np.full(n, 1.0)
    inside = sorted(b for b in breaks if b < n) if n > 100 else []
    steps[inside] = 50.0
    t = np.concatenate(([0.0], np.cumsum(steps)))
    assert gaps(t).tolist() == [[t[i], t[i + 1]] for i in inside]

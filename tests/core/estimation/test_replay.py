"""Late and shuffled readings give what the same readings give in order."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from core.errors import ParameterError
from core.estimation.fusion.replay import Replay
from core.estimation.fusion.walk import walk

from .test_filter import GATED, events, ready

LOG = events(21, 1500)
IN_ORDER = walk(ready(GATED, begin=float(LOG.t[0])), LOG)


def feed(replay: Replay, order: np.ndarray, sizes: np.ndarray) -> None:
    for piece in np.split(order, np.cumsum(sizes)[np.cumsum(sizes) < len(order)]):
        replay.take(LOG.t[piece], LOG.kind[piece], LOG.data[piece], LOG.flags[piece])


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10_000), horizon=st.sampled_from([0.05, 0.5, 3.0]), most=st.sampled_from([1, 40, 600]))
def test_any_order_within_the_horizon_is_as_good_as_in_order(seed: int, horizon: float, most: int) -> None:
    rng = np.random.default_rng(seed)
    order = np.argsort(LOG.t + rng.uniform(0, horizon, len(LOG.t)))
    replay = Replay(ready(GATED, begin=float(LOG.t[0])), horizon)
    feed(replay, order, rng.integers(1, most + 1, len(order)))
    t, rows, covariance = replay.path()
    assert replay.dropped == 0
    np.testing.assert_array_equal(t, LOG.out)
    np.testing.assert_allclose(rows[:, :3], IN_ORDER.pose, atol=1e-9, rtol=0)
    np.testing.assert_allclose(covariance, IN_ORDER.covariance, atol=1e-9, rtol=0)
    np.testing.assert_allclose(replay.state.x, IN_ORDER.x, atol=1e-9, rtol=0)
    np.testing.assert_allclose(replay.state.P, IN_ORDER.P, atol=1e-9, rtol=0)


def test_what_comes_too_late_is_dropped_and_counted() -> None:
    late = 700
    rest = np.delete(np.arange(len(LOG.t)), late)
    replay = Replay(ready(GATED, begin=float(LOG.t[0])), 0.2)
    feed(replay, np.append(rest, late), np.full(len(LOG.t), 50))
    assert replay.dropped == 1
    without = walk(ready(GATED, begin=float(LOG.t[0])), dataclasses.replace(LOG.kept(np.arange(1500) != late)))
    np.testing.assert_allclose(replay.state.x, without.x, atol=1e-9, rtol=0)


def test_a_horizon_is_a_time() -> None:
    with pytest.raises(ParameterError, match="horizon"):
        Replay(ready(), -1.0)

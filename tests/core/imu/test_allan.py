"""Allan and Hadamard deviations against published tables, a peer library and theory; fitted noise against what was
put in."""

from __future__ import annotations

import allantools
import numpy as np
import pytest

from core.errors import NotEnoughDataError
from core.imu.allan import allan, allan_of, degrees_of_freedom
from core.imu.grid import Record, to_grid
from core.imu.noise import fit_noise

# NIST SP 1065, table 31: the nine first differences of the NBS data.
NBS14 = np.array([892, 809, 823, 798, 671, 644, 883, 903, 677.0])


def thousand_points() -> np.ndarray:
    """NIST SP 1065, section 12.4: the 1000-point test set from its generator."""
    out = np.empty(1000)
    seed = 1234567890
    for i in range(1000):
        out[i] = seed / 2147483647
        seed = (16807 * seed) % 2147483647
    return out


@pytest.mark.parametrize(
    ("kind", "printed"),
    [
        ("allan", {1: "2.922319e-01", 10: "9.159953e-02", 100: "3.241343e-02"}),
        ("hadamard", {1: "2.943883e-01", 10: "9.581083e-02", 100: "3.237638e-02"}),
    ],
)
def test_thousand_point_table(kind: str, printed: dict[int, str]) -> None:
    curve = allan(np.arange(1000.0), thousand_points(), taus=np.array(list(printed), float), kind=kind)
    assert [f"{d:.6e}" for d in curve.deviation] == list(printed.values())


def test_nine_point_table() -> None:
    curve = allan(np.arange(9.0), NBS14, taus=np.array([1.0, 2.0]))
    assert [f"{d:.5f}" for d in curve.deviation] == ["91.22945", "85.95287"]


@pytest.mark.parametrize(("kind", "peer"), [("allan", allantools.oadev), ("hadamard", allantools.ohdev)])
def test_agrees_with_allantools(kind: str, peer) -> None:  # type: ignore[no-untyped-def]
    rng = np.random.default_rng(0)
    y = rng.standard_normal(20_000) + np.cumsum(rng.standard_normal(20_000)) * 1e-3
    curve = allan(np.arange(20_000) / 100.0, y, kind=kind)
    _, deviation, _, pairs = peer(y, rate=100.0, data_type="freq", taus=curve.tau)
    np.testing.assert_allclose(curve.deviation, deviation, rtol=1e-10)
    np.testing.assert_array_equal(curve.pairs, pairs)


@pytest.mark.parametrize("alpha", [2, 0, -1, -2])
@pytest.mark.parametrize("m", [64, 1024])
def test_degrees_of_freedom_agree_with_greenhall(alpha: int, m: int) -> None:
    n = 100_000
    peer = allantools.edf_greenhall(alpha=alpha, d=2, m=m, N=n + 1, overlapping=True, modified=False)
    assert degrees_of_freedom(alpha, m, n + 1 - 2 * m, 2) == pytest.approx(peer, rel=0.01)


def test_interval_holds_the_truth_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    held = 0
    for _ in range(300):
        curve = allan(np.arange(2000.0), rng.standard_normal(2000), taus=np.array([20.0]), confidence=0.9)
        held += bool(curve.lo[0] <= 1 / np.sqrt(20) <= curve.hi[0])
    assert 0.85 <= held / 300 <= 0.95


def test_lost_samples_and_jitter_change_little() -> None:
    rng = np.random.default_rng(2)
    t, y = np.arange(100_000) / 100.0, rng.standard_normal(100_000)
    keep = rng.random(len(t)) > 0.02
    keep[40_000:45_000] = False
    stamps = t[keep] + 0.004 * rng.random(int(keep.sum()))
    record = to_grid(stamps, y[keep])
    first, last = np.flatnonzero(keep)[[0, -1]]
    assert record.lost == pytest.approx((~keep[first:last]).sum(), rel=1e-3)  # jitter hides a few
    whole = allan(t, y)
    thinned = allan(stamps, y[keep], taus=whole.tau)
    long_enough = thinned.tau < 100
    np.testing.assert_allclose(thinned.deviation[long_enough], whole.deviation[: long_enough.sum()], rtol=0.12)
    assert any("missing" in note for note in thinned.notes)


def test_bursts_of_late_stamps_lose_nothing() -> None:
    rng = np.random.default_rng(3)
    t = np.arange(20_000) / 100.0
    batch, place = np.divmod(np.arange(len(t)), 20)
    burst = 0.2 * (batch + 1) + 1e-5 * place  # twenty at once, every 0.2 s
    assert to_grid(burst, rng.standard_normal(len(t))).lost == 0


def test_refusals_name_what_is_wrong() -> None:
    t = np.arange(100.0)
    with pytest.raises(NotEnoughDataError, match="equal"):
        allan(t, np.full(100, 3.0))
    with pytest.raises(NotEnoughDataError, match="too short"):
        allan(t, np.sin(t), taus=np.array([60.0]))
    with pytest.raises(NotEnoughDataError, match="at least 9"):
        allan(t[:5], t[:5])


def test_stamps_that_go_back_are_left_out_and_told() -> None:
    rng = np.random.default_rng(4)
    t, y = np.arange(3000) / 100.0, rng.standard_normal(3000)
    whole = allan(t, y)
    clock = np.where(t < 20, t, t - 5.0)  # set back by 5 s: stamped twice are 500
    back = allan(clock, y, taus=whole.tau)
    assert len(back.tau) > 40
    np.testing.assert_allclose(back.deviation[:30], whole.deviation[:30], rtol=0.15)
    assert "row 2001 says 15 s after 19.99 s; 500 of 3000" in back.notes[0]
    late = t.copy()
    late[1000] = 1e6  # this one alone
    assert "first where row 1002 says 10.01 s after 1000000 s; 1 of 3000" in allan(late, y).notes[0]
    twice = np.sort(np.concatenate((t, t[:7])))
    np.testing.assert_allclose(allan(twice, np.interp(twice, t, y)).deviation, whole.deviation)


def synthetic(
    rng: np.random.Generator, n: int, rate: float, *, N: float, K: float = 0, s: float = 0, T: float = 1
) -> Record:
    from scipy.signal import lfilter

    y = N * np.sqrt(rate) * rng.standard_normal(n) + K / np.sqrt(rate) * np.cumsum(rng.standard_normal(n))
    phi = np.exp(-1 / rate / T)
    drive = s * np.sqrt(1 - phi**2) * rng.standard_normal(n)
    drive[0] = s * rng.standard_normal()
    return Record(y + lfilter([1.0], [1.0, -phi], drive), 1 / rate, None, 0.0, 0)


def test_fitted_noise_is_what_was_put_in_within_its_deviation() -> None:
    rng = np.random.default_rng(4)
    fits = [fit_noise(allan_of(synthetic(rng, 200_000, 20.0, N=2e-4, K=3e-6))) for _ in range(16)]
    for name, true in (("N", 2e-4), ("K", 3e-6)):
        terms = [getattr(fit, name) for fit in fits]
        z = np.array([(term.value - true) / term.sd for term in terms if term.value is not None])
        assert len(z) == len(fits)
        assert 0.6 < np.sqrt(np.mean(z**2)) < 1.5
    assert sum(fit.B.value is None for fit in fits) >= 14
    assert sum(fit.markov_sd.value is None for fit in fits) >= 15


def test_gauss_markov_process_is_found() -> None:
    rng = np.random.default_rng(5)
    fits = [fit_noise(allan_of(synthetic(rng, 400_000, 20.0, N=1e-4, s=1e-4, T=100.0))) for _ in range(6)]
    assert all(f.markov_tau.value is not None for f in fits)
    assert np.median([f.markov_tau.value for f in fits]) == pytest.approx(100.0, rel=0.2)
    assert np.median([f.markov_sd.value for f in fits]) == pytest.approx(1e-4, rel=0.1)


def test_white_record_shows_nothing_but_white() -> None:
    rng = np.random.default_rng(6)
    fit = fit_noise(allan_of(synthetic(rng, 200_000, 20.0, N=2e-4)))
    assert fit.K.value is None
    assert "K is not identifiable from this record" in fit.notes

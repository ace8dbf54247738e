"""Arrays: what goes in comes out, once, whole or not at all."""

from __future__ import annotations

import os
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from app.store import arrays

DTYPES = st.sampled_from(["<f8", "<f4", "<i2", "<i8", "|u1", "|b1"])
SHAPES = hnp.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=7)


def files(data: Path) -> list[Path]:
    return sorted(p for p in (data / "arrays").rglob("*") if p.is_file() and p.name != ".lock")


@given(array=DTYPES.flatmap(lambda d: hnp.arrays(np.dtype(d), SHAPES)))
def test_comes_back_bit_by_bit(array: np.ndarray, tmp_path_factory: pytest.TempPathFactory) -> None:
    data = tmp_path_factory.mktemp("data")
    back = arrays.open(data, arrays.put(data, array))
    assert back.dtype == array.dtype and back.shape == array.shape
    assert back.tobytes() == array.tobytes()
    assert not back.flags.writeable


@given(
    array=hnp.arrays(np.float64, st.integers(0, 60)),
    cuts=st.lists(st.integers(0, 60), max_size=5).map(sorted),
)
def test_batches_make_the_same_file_as_one_piece(
    array: np.ndarray, cuts: list[int], tmp_path_factory: pytest.TempPathFactory
) -> None:
    data = tmp_path_factory.mktemp("data")
    with arrays.Writer(data) as writer:
        for batch in np.split(array, [min(c, len(array)) for c in cuts]):
            writer.append(batch)
        key = writer.commit()
    assert key == arrays.put(data, array)
    assert np.load(arrays.path_of(data, key), allow_pickle=False).tobytes() == array.tobytes()
    assert len(files(data)) == 1


def test_type_and_shape_are_part_of_the_identity(tmp_path: Path) -> None:
    zeros = [np.zeros(4), np.zeros(8, np.float32), np.zeros((2, 2)), np.zeros(4, np.int64)]
    assert len({arrays.put(tmp_path, z) for z in zeros}) == len(zeros)


def test_a_batch_of_another_type_is_refused_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="float32"), arrays.Writer(tmp_path) as writer:
        writer.append(np.zeros(3))
        writer.append(np.zeros(3, np.float32))
    assert files(tmp_path) == []


def test_objects_and_text_are_refused(tmp_path: Path) -> None:
    for bad in (np.array([{}], object), np.array(["a"]), np.array(1.0)):
        with pytest.raises(ValueError, match="cannot store"):
            arrays.put(tmp_path, bad)
    assert files(tmp_path) == []


def test_an_interrupted_writer_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt), arrays.Writer(tmp_path) as writer:
        writer.append(np.zeros(3))
        raise KeyboardInterrupt
    assert files(tmp_path) == []


@pytest.mark.parametrize("key", ["", "../../etc/passwd", "A" * 64, "0" * 63])
def test_a_key_cannot_leave_the_folder(key: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="not an array key"):
        arrays.open(tmp_path, key)


def test_pickles_are_never_loaded(tmp_path: Path) -> None:
    path = arrays.path_of(tmp_path, "0" * 64)
    path.parent.mkdir(parents=True)
    np.save(path, np.array([{}], object), allow_pickle=True)
    with pytest.raises(ValueError, match="not the head of a stored array"):
        arrays.open(tmp_path, "0" * 64)


def test_collecting_keeps_what_is_named_young_or_just_used_again(tmp_path: Path) -> None:
    named, unnamed, reused = (arrays.put(tmp_path, np.full(3, float(i))) for i in range(3))
    left_behind = tmp_path / "arrays" / "tmp" / "crashed"
    left_behind.write_bytes(b"half")
    day = time.time() - 2 * arrays.GRACE_S
    for path in files(tmp_path):
        os.utime(path, (day, day))
    young = arrays.put(tmp_path, np.full(3, 9.0))
    assert arrays.put(tmp_path, np.full(3, 2.0)) == reused
    freed = arrays.collect(tmp_path, {named})
    assert freed > 0
    assert {p.stem for p in files(tmp_path)} == {named, reused, young}
    assert unnamed not in {p.stem for p in files(tmp_path)}
    assert np.array_equal(arrays.open(tmp_path, named), np.full(3, 0.0))

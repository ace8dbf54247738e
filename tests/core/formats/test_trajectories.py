"""TUM and KITTI: what is written is what others read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

from core.errors import FormatError, NotEnoughDataError, ParameterError
from core.formats import read_run, write_trajectory
from core.trajectory import Trajectory

T = np.linspace(0.0, 10.0, 101)
PATH = Trajectory(T, np.cos(T), np.sin(2 * T), 3 * T - 4.0)


def test_evo_reads_our_tum(tmp_path: Path) -> None:
    write_trajectory(PATH, tmp_path / "a.tum", "tum")
    found = file_interface.read_tum_trajectory_file(str(tmp_path / "a.tum"))
    assert np.array_equal(found.timestamps, T)
    assert np.array_equal(found.positions_xyz, np.column_stack((PATH.x, PATH.y, 0 * T)))
    yaw = np.array([np.arctan2(p[1, 0], p[0, 0]) for p in found.poses_se3])
    np.testing.assert_allclose(np.cos(yaw - PATH.theta), 1.0, rtol=1e-12)


def test_evo_reads_our_kitti(tmp_path: Path) -> None:
    write_trajectory(PATH, tmp_path / "a.kitti", "kitti")
    found = file_interface.read_kitti_poses_file(str(tmp_path / "a.kitti"))
    assert np.array_equal(found.positions_xyz, np.column_stack((PATH.x, PATH.y, 0 * T)))
    rotation = np.array([p[:2, :2] for p in found.poses_se3])
    np.testing.assert_allclose(rotation[:, 1, 0], np.sin(PATH.theta), rtol=0, atol=1e-15)
    np.testing.assert_allclose(rotation[:, 0, 1], -np.sin(PATH.theta), rtol=0, atol=1e-15)


def test_tum_comes_back_as_truth(tmp_path: Path) -> None:
    write_trajectory(PATH, tmp_path / "a.tum", "tum")
    truth = read_run(tmp_path / "a.tum").truth
    assert truth is not None and truth.x is not None and truth.y is not None and truth.theta is not None
    assert np.array_equal(truth.t, T) and np.array_equal(truth.x, PATH.x) and np.array_equal(truth.y, PATH.y)
    np.testing.assert_allclose(np.cos(truth.theta - PATH.theta), 1.0, rtol=1e-12)


def test_epoch_stamps_start_at_the_first(tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text("1305031098.5 1 2 0 0 0 0 1\n1305031099.0  1 2 0 0 0 0 1\n")
    truth = read_run(tmp_path / "a.tum").truth
    assert truth is not None and truth.t.tolist() == [0.0, 0.5]


def test_paths_without_a_heading(tmp_path: Path) -> None:
    x = np.array([0.0, np.nan, 2.0])
    path = Trajectory(np.arange(3.0), x, x, np.full(3, np.nan))
    write_trajectory(path, tmp_path / "a.tum", "tum")
    lines = (tmp_path / "a.tum").read_text().splitlines()
    assert "heading is unknown" in lines[1] and len(lines) == 4
    with pytest.raises(NotEnoughDataError, match="no heading"):
        write_trajectory(path, tmp_path / "a.kitti", "kitti")
    with pytest.raises(ParameterError, match="tum"):
        write_trajectory(path, tmp_path / "a.bag", "bag")


@pytest.mark.parametrize(
    ("text", "row", "found"),
    [
        ("1 2 3\n", 1, "'1 2 3'"),
        ("# a comment\n\n0 1 2 0 0 0 0 1\n1 1 2 0 0 0 0 x\n", 2, "'1 1 2 0 0 0 0 x'"),
        ("0 1 2 0 0 0 0 1 9\n", 1, "'0 1 2 0 0 0 0 1 9'"),
        ("1 1 2 0 0 0 0 1\n1 1 2 0 0 0 0 1\n", 2, "1.0"),
        ("# nothing\n", None, "no row"),
    ],
)
def test_a_broken_tum_file_names_its_row(text: str, row: int | None, found: str, tmp_path: Path) -> None:
    (tmp_path / "a.tum").write_text(text)
    with pytest.raises(FormatError) as caught:
        read_run(tmp_path / "a.tum")
    assert caught.value.where.get("row") == row and caught.value.where["found"] == found

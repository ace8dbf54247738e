"""Normal equations of a chain of poses that share a few parameters: block-tridiagonal with a border (an arrow).

The poses are eliminated by one banded Cholesky factorisation; what is left is the information on the parameters alone,
its inverse their covariance with the poses unknown. Linear in the number of poses.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import cho_solve_banded, cholesky_banded

Array = npt.NDArray[np.float64]


@dataclass
class Arrow:
    """diagonal (K, 3, 3), beside (K - 1, 3, 3) of each pose with the next, border (K, 3, n), corner (n, n); right sides
    pose (K, 3) and shared (n,) (minus the gradient); cost: half the weighted squares."""

    diagonal: Array
    beside: Array
    border: Array
    corner: Array
    pose: Array
    shared: Array
    cost: float = 0.0

    @staticmethod
    def empty(poses: int, shared: int) -> Arrow:
        """All zero."""
        k, n = poses, shared
        return Arrow(
            np.zeros((k, 3, 3)), np.zeros((k - 1, 3, 3)), np.zeros((k, 3, n)), np.zeros((n, n)),
            np.zeros((k, 3)), np.zeros(n),
        )  # fmt: skip

    def add(self, e: Array, W: Array, A: Array, J: Array, B: Array | None = None) -> None:
        """Rows e (M, d) with information W (M, d, d), Jacobians A (M, d, 3) of the first M poses, B (M, d, 3) of each
        one's next (then M = K - 1), J (M, d, n) of the shared."""
        m, WJ, We = len(e), W @ J, np.einsum("mij,mj->mi", W, e)
        At = np.swapaxes(A, 1, 2)
        self.diagonal[:m] += At @ W @ A
        self.border[:m] += At @ WJ
        self.pose[:m] -= np.einsum("mij,mi->mj", A, We)
        flat = J.reshape(-1, J.shape[2])
        self.corner += flat.T @ WJ.reshape(flat.shape)
        self.shared -= We.ravel() @ flat
        self.cost += 0.5 * float(np.sum(e * We))
        if B is not None:
            self.diagonal[1:] += np.swapaxes(B, 1, 2) @ (W @ B)
            self.beside += np.swapaxes(A, 1, 2) @ (W @ B)
            self.border[1:] += np.swapaxes(B, 1, 2) @ WJ
            self.pose[1:] -= np.einsum("mij,mi->mj", B, We)


@dataclass(frozen=True)
class Eliminated:
    """information (n, n) and right side (n,) of the shared alone; steps (K, 3, n + 1) to get the poses back; the cost
    that the poses' freedom takes off; log determinant of the poses' matrix."""

    information: Array
    right: Array
    steps: Array
    gain: float
    logdet: float

    def poses(self, shared: Array) -> Array:
        """(K, 3) steps of the poses that go with steps of the shared (n,)."""
        return self.steps[..., -1] - self.steps[..., :-1] @ shared


def eliminate(arrow: Arrow) -> Eliminated:
    """The poses out."""
    k, n = len(arrow.diagonal), len(arrow.shared)
    upper = np.zeros((6, 3 * k))  # upper[5 + i - j, j] holds row i, column j
    for i in range(3):
        for j in range(3):
            if i <= j:
                upper[5 + i - j, j::3] = arrow.diagonal[:, i, j]
            upper[2 + i - j, 3 + j :: 3] = arrow.beside[:, i, j]
    upper[5] *= 1.0 + 1e-12
    factor = cholesky_banded(upper)
    right = np.concatenate((arrow.border, arrow.pose[..., None]), axis=2).reshape(3 * k, n + 1)
    solved = cho_solve_banded((factor, False), right)
    border = right[:, :n]
    return Eliminated(
        information=arrow.corner - border.T @ solved[:, :n],
        right=arrow.shared - border.T @ solved[:, n],
        steps=solved.reshape(k, 3, n + 1),
        gain=0.5 * float(right[:, n] @ solved[:, n]),
        logdet=2.0 * float(np.sum(np.log(factor[5]))),
    )

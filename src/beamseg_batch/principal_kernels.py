"""Kernel that finds along which direction points spread most."""

from __future__ import annotations

import numpy as np

from beamseg_batch.accelerate import kernel
from beamseg_batch.geometry import FloatArray

__all__ = ["principal_axis"]


@kernel
def _rotate(matrix: FloatArray, vectors: FloatArray, p: int, q: int) -> None:
    """Zero one off-diagonal element of a symmetric 3x3 matrix by a plane rotation."""
    if matrix[p, q] == 0.0:
        return
    theta = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
    tangent = 1.0 / (abs(theta) + np.sqrt(theta * theta + 1.0))
    if theta < 0.0:
        tangent = -tangent
    cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
    sine = tangent * cosine
    for k in range(3):
        matrix[k, p], matrix[k, q] = (
            cosine * matrix[k, p] - sine * matrix[k, q],
            sine * matrix[k, p] + cosine * matrix[k, q],
        )
    for k in range(3):
        matrix[p, k], matrix[q, k] = (
            cosine * matrix[p, k] - sine * matrix[q, k],
            sine * matrix[p, k] + cosine * matrix[q, k],
        )
        vectors[k, p], vectors[k, q] = (
            cosine * vectors[k, p] - sine * vectors[k, q],
            sine * vectors[k, p] + cosine * vectors[k, q],
        )


@kernel
def principal_axis(scatter: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Find the eigenvector of a symmetric 3x3 matrix to its largest eigenvalue.

    Parameters
    ----------
    scatter : (3, 3) float64
        Changed.

    Returns
    -------
    direction : (3,) float64, unit vector
    eigenvalues : (3,) float64
        Largest first.

    Notes
    -----
    Cyclic Jacobi rotations (Golub and Van Loan, section 8.5), which for 3x3 need at most
    six sweeps and give the same bits on every machine, which a LAPACK does not.
    """
    vectors = np.eye(3)
    for _ in range(12):
        if scatter[0, 1] == 0.0 and scatter[0, 2] == 0.0 and scatter[1, 2] == 0.0:
            break
        _rotate(scatter, vectors, 0, 1)
        _rotate(scatter, vectors, 0, 2)
        _rotate(scatter, vectors, 1, 2)
    first, second, third = 0, 1, 2
    if scatter[second, second] > scatter[first, first]:
        first, second = second, first
    if scatter[third, third] > scatter[second, second]:
        second, third = third, second
    if scatter[second, second] > scatter[first, first]:
        first, second = second, first
    direction, eigenvalues = np.empty(3), np.empty(3)
    length = np.sqrt(vectors[0, first] ** 2 + vectors[1, first] ** 2 + vectors[2, first] ** 2)
    for axis in range(3):
        direction[axis] = vectors[axis, first] / length
    eigenvalues[0], eigenvalues[1] = scatter[first, first], scatter[second, second]
    eigenvalues[2] = scatter[third, third]
    return direction, eigenvalues

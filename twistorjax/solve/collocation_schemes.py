"""Collocation methods, as their coefficients."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np


class Scheme(NamedTuple):
    """Coefficients of a collocation method.

    Args:
        nodes: of the stages, as parts of the step.
        matrix: integrals to each node of the polynomials that are one at a node.
        weights: the same to the end of the step.
        eigenvalues: eigenvalues of the matrix, one of each conjugate pair.
        to_eigenvectors: takes stages to the directions of these eigenvalues.
        from_eigenvectors: takes the directions back to stages, as its real part.
        powers: takes values at the nodes to the coefficients of their polynomial.
        through: the same for all values that are known, that at the start among them
            where the last step has left it.
        real: which of the reaches is real.
    """

    nodes: np.ndarray
    matrix: np.ndarray
    weights: np.ndarray
    eigenvalues: np.ndarray
    to_eigenvectors: np.ndarray
    from_eigenvectors: np.ndarray
    powers: np.ndarray
    through: np.ndarray
    real: int

    @property
    def stages(self) -> int:
        """How many there are."""
        return len(self.nodes)

    @property
    def ends(self) -> bool:
        """Whether the last stage is the end of the step."""
        return bool(self.nodes[-1] == 1)


@lru_cache
def scheme(kind: str, stages: int) -> Scheme:
    """The collocation method at Gauss's points, or at Radau's that end the step.

    Source:
        Hairer and Wanner, Solving Ordinary Differential Equations II, sections IV.5 and
        IV.8.
    """
    legendre = np.zeros(stages + 1)
    legendre[stages:] = 1.0
    if kind == "radau":
        legendre[stages - 1] = -1.0
    nodes = (np.sort(np.polynomial.legendre.legroots(legendre)) + 1) / 2
    if kind == "radau":
        nodes[-1] = 1.0
    powers = np.linalg.inv(np.vander(nodes, increasing=True))
    degrees = np.arange(1, stages + 1)
    matrix = (nodes[:, None] ** degrees / degrees) @ powers
    eigenvalues, directions = (part.astype(complex) for part in np.linalg.eig(matrix))
    to_eigenvectors = np.linalg.inv(directions)
    kept = np.imag(eigenvalues) > -1e-12
    twice = np.where(np.abs(np.imag(eigenvalues)) > 1e-12, 2.0, 1.0)
    known = np.append(0.0, nodes) if kind == "radau" else nodes
    return Scheme(
        nodes=nodes,
        matrix=matrix,
        weights=(1 / degrees) @ powers,
        eigenvalues=eigenvalues[kept],
        to_eigenvectors=to_eigenvectors[kept],
        from_eigenvectors=(directions * twice)[:, kept],
        powers=powers,
        through=np.linalg.inv(np.vander(known, increasing=True)),
        real=int(np.argmin(np.abs(np.imag(eigenvalues[kept])))),
    )

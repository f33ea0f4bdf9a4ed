"""Coefficients of collocation methods."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np


class Scheme(NamedTuple):
    """Coefficients of a collocation method, for a step of length 1.

    A polynomial of lower degree than the number of stages is given by its values at the
    nodes. The matrix A integrates it from the start of the step to each node. In the
    basis of the eigenvectors of A, the stages of an implicit step decouple.

    Args:
        nodes: Times of the stages.
        matrix: The matrix A.
        weights: Weights that integrate the polynomial to the end of the step.
        eigenvalues: Eigenvalues of A, without the second of each conjugate pair.
        to_eigenvectors: Transformation from the stages to the basis of eigenvectors.
        from_eigenvectors: Transformation from this basis to the stages. The real part of
            its result is used. It counts each conjugate pair twice.
        to_coefficients: Transformation from values at the nodes to coefficients of the
            polynomial, lowest power first.
        history_to_coefficients: The same transformation for the values from which the
            next step is extrapolated. They are those at the nodes and, if the last stage
            is the end of a step, also the value at the start.
        real_index: Index of the real eigenvalue, if there is one.
    """

    nodes: np.ndarray
    matrix: np.ndarray
    weights: np.ndarray
    eigenvalues: np.ndarray
    to_eigenvectors: np.ndarray
    from_eigenvectors: np.ndarray
    to_coefficients: np.ndarray
    history_to_coefficients: np.ndarray
    real_index: int

    @property
    def stages(self) -> int:
        """Number of stages."""
        return len(self.nodes)

    @property
    def stiffly_accurate(self) -> bool:
        """Whether the last stage is the end of the step."""
        return bool(self.nodes[-1] == 1)

    @property
    def real_eigenvalue(self) -> float:
        """The real eigenvalue of the matrix A."""
        return self.eigenvalues[self.real_index].real

    def embedded_weights(self) -> np.ndarray:
        """Compute the weights of the stages in an error estimate.

        The estimate is the difference between the method and an embedded quadrature,
        which uses the stages and the start of the step. The weight of the start is the
        real eigenvalue.

        Source:
            Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.8.
        """
        moments = 1 / np.arange(1, self.stages + 1)
        moments[0] -= self.real_eigenvalue
        return moments @ self.to_coefficients - self.weights


@lru_cache
def collocation_scheme(family: str, stages: int) -> Scheme:
    """Compute the coefficients of a collocation method.

    Args:
        family: "gauss" for the nodes of Gauss; "radau" for those of Radau, the last of
            which is the end of the step.
        stages: Number of stages.

    Returns:
        The coefficients.

    Source:
        Hairer and Wanner, Solving Ordinary Differential Equations II, sections IV.5 and
        IV.8.
    """
    legendre = np.zeros(stages + 1)
    legendre[stages:] = 1.0
    if family == "radau":
        legendre[stages - 1] = -1.0
    nodes = (np.sort(np.polynomial.legendre.legroots(legendre)) + 1) / 2
    if family == "radau":
        nodes[-1] = 1.0
    to_coefficients = np.linalg.inv(np.vander(nodes, increasing=True))
    degrees = np.arange(1, stages + 1)
    matrix = (nodes[:, None] ** degrees / degrees) @ to_coefficients
    eigenvalues, eigenvectors = (part.astype(complex) for part in np.linalg.eig(matrix))
    to_eigenvectors = np.linalg.inv(eigenvectors)
    kept = np.imag(eigenvalues) > -1e-12
    multiplicity = np.where(np.abs(np.imag(eigenvalues)) > 1e-12, 2.0, 1.0)
    history_nodes = np.append(0.0, nodes) if family == "radau" else nodes
    return Scheme(
        nodes=nodes,
        matrix=matrix,
        weights=(1 / degrees) @ to_coefficients,
        eigenvalues=eigenvalues[kept],
        to_eigenvectors=to_eigenvectors[kept],
        from_eigenvectors=(eigenvectors * multiplicity)[:, kept],
        to_coefficients=to_coefficients,
        history_to_coefficients=np.linalg.inv(np.vander(history_nodes, increasing=True)),
        real_index=int(np.argmin(np.abs(np.imag(eigenvalues[kept])))),
    )

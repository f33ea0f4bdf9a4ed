"""Coefficients of collocation methods."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np


class Scheme(NamedTuple):
    """Coefficients of a collocation method, for a step of length 1.

    A polynomial of lower degree than the number of stages is given by its values at the
    nodes. The matrix A integrates it from the start of the step to each node. In the
    basis of the eigenvectors of A, the stages of an implicit step decouple. The
    components in this basis are that of the real eigenvalue, if there is one, then the
    real and the imaginary part of that of the complex eigenvalue.
    """

    nodes: np.ndarray  # Times of the stages
    matrix: np.ndarray
    weights: np.ndarray  # Weights that integrate the polynomial to the end of the step
    # The real eigenvalue of A, if the number of stages is odd
    real_eigenvalue: float | None
    complex_eigenvalue: complex  # The eigenvalue with a positive imaginary part
    to_components: np.ndarray  # Transformation from the stages to the components
    # Transformation from values at the nodes to coefficients of the polynomial, lowest
    # power first
    to_coefficients: np.ndarray
    # The same transformation for the values from which the next step is extrapolated.
    # They are those at the nodes and, if the last stage is the end of a step, also the
    # value at the start.
    history_to_coefficients: np.ndarray

    @property
    def stages(self) -> int:
        return len(self.nodes)

    @property
    def stiffly_accurate(self) -> bool:
        """Whether the last stage is the end of the step."""
        return bool(self.nodes[-1] == 1)

    @property
    def from_components(self) -> np.ndarray:
        """Transformation from the components to the stages."""
        return np.linalg.inv(self.to_components)

    @property
    def differentiate_twice(self) -> np.ndarray:
        """Transformation from the stages to components of the second time derivative.

        The function is zero at the start of the step, together with its rate.
        """
        return self.to_components @ np.linalg.matrix_power(np.linalg.inv(self.matrix), 2)

    def embedded_weights(self) -> np.ndarray:
        """Compute the weights of the stages in an error estimate.

        The estimate is the difference between the method and an embedded quadrature,
        which uses the stages and the start of the step. The weight of the start is the
        real eigenvalue.

        Source:
            Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.8.
        """
        assert self.real_eigenvalue is not None
        moments = 1 / np.arange(1, self.stages + 1)
        moments[0] -= self.real_eigenvalue
        return moments @ self.to_coefficients - self.weights


@lru_cache
def collocation_scheme(family: str, stages: int) -> Scheme:
    """Compute the coefficients of a collocation method of the family "gauss" or "radau".

    The last of the nodes of Radau is the end of the step.

    Source:
        Hairer and Wanner, Solving Ordinary Differential Equations II, sections IV.5 and
        IV.8.
    """
    legendre = np.zeros(stages + 1)
    legendre[stages:] = 1.0
    if family == "radau":
        legendre[stages - 1] = -1.0
    roots = np.real(np.polynomial.legendre.legroots(legendre))  # complex in NumPy 2.5
    nodes = (np.sort(roots) + 1) / 2
    if family == "radau":
        nodes[-1] = 1.0
    to_coefficients = np.linalg.inv(np.vander(nodes, increasing=True))
    degrees = np.arange(1, stages + 1)
    matrix = (nodes[:, None] ** degrees / degrees) @ to_coefficients
    eigenvalues, eigenvectors = np.linalg.eig(matrix)
    to_eigenvectors = np.linalg.inv(eigenvectors)
    pair = int(np.argmax(np.imag(eigenvalues)))
    components = [to_eigenvectors[pair].real, to_eigenvectors[pair].imag]
    real_eigenvalue = None
    if stages % 2:
        real = int(np.argmin(np.abs(np.imag(eigenvalues))))
        real_eigenvalue = float(eigenvalues[real].real)
        components = [to_eigenvectors[real].real, *components]
    history_nodes = np.append(0.0, nodes) if family == "radau" else nodes
    return Scheme(
        nodes=nodes,
        matrix=matrix,
        weights=(1 / degrees) @ to_coefficients,
        real_eigenvalue=real_eigenvalue,
        complex_eigenvalue=complex(eigenvalues[pair]),
        to_components=np.stack(components),
        to_coefficients=to_coefficients,
        history_to_coefficients=np.linalg.inv(np.vander(history_nodes, increasing=True)),
    )

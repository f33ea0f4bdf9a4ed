"""Mechanisms that several tests of statics use."""

import numpy as np

import twistorjax as tj
from twistorjax.energies.strains import Coordinates


WALL, BLOCK = tj.Body("wall"), tj.Body("block")


def block_on_spring(stiffness, coordinates: Coordinates = "twistor"):
    """Return a block on a hinge at its origin."""
    spring = tj.Quadratic(stiffness, coordinates)
    hinge = tj.Hinge("spring", "wall", "block", spring, (0.0, 0.0, 0.0))
    return tj.Mechanism([WALL, BLOCK], [hinge], fixed=["wall"])


def cantilever(elements, axial=1e6, coordinates: Coordinates = "twist", factor=1.0):
    """Return a cantilever of unit length and unit bending stiffness, clamped at left.

    Args:
        elements: Number of leaves in a row.
        axial: Ratio of axial to bending stiffness; 1/m2.
        coordinates: Coordinates of the energy of a leaf.
        factor: Factor of all stiffnesses.
    """
    size = 1 / elements
    stiffness = np.diag([1 / size, axial / size, 12 / size**3])
    leaf = tj.Quadratic(factor * stiffness, coordinates)
    bodies = [tj.Body(str(k), (0.0, k * size, 0.0)) for k in range(elements + 1)]
    hinges = [
        tj.Hinge(str(k), str(k), str(k + 1), leaf, (0.0, (k + 0.5) * size, 0.0))
        for k in range(elements)
    ]
    return tj.Mechanism(bodies, hinges, fixed=["0"])

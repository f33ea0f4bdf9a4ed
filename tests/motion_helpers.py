"""Mechanisms that several tests of motion use."""

import numpy as np

import twistorjax as tj


STIFFNESS = (1.0, 50.0, 80.0)  # of the oscillator; N m/rad, N/m, N/m


def oscillator(damping=None, mass=2.0):
    """Return a block on a spring whose three motions are independent of each other."""
    spring = tj.Quadratic(np.diag(STIFFNESS))
    hinge = tj.Hinge("spring", "wall", "block", spring, (0, 0, 0), damping=damping)
    block = tj.Body("block", mass=mass, inertia=0.1)
    return tj.Mechanism([tj.Body("wall"), block], [hinge], fixed=["wall"])

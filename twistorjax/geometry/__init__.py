"""Planar displacements: poses, twists, twistors, lines, and wrenches.

Start reading in `se2`, which holds poses and twists. `twistors` holds the Clifford
parameters of a displacement, in which most energies are written; `lines` holds forces as
line vectors.
"""

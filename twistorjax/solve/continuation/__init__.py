"""Paths of equilibria: arc length, critical points, and branches.

Internal. Start reading in `arc_length`, which follows a path of a `system`. `setup`
assembles the system, and `program` compiles the path. `location` finds points on the
path, `critical_points` and `branch_points` those where the stiffness is singular.
`points` computes the quantities at given points, `solution` is the result, and
`diagnosis` recommends a path when an equilibrium fails.
"""

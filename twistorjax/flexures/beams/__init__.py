"""Geometrically exact beams of any thickness profile and curvature.

Internal. Start reading in `beam`, which defines a beam. `under_load` integrates it under
a given load, and `at_pose` finds the load of a given pose, which makes it an energy.
`stress` and `stress_models` compute stresses, `cross_section` the stiffness of sections,
and `plates` the factor of wide beams.
"""

"""Geometrically exact beams of any thickness profile and curvature.

Internal. Start reading in `beam`, which defines a beam. `under_load` integrates it under
a given load, and `at_pose` finds the load of a given pose, which makes it an energy.
`stress` and `stress_models` compute stresses, `cross_section` the stiffness of sections,
`out_of_plane` the stiffness of a bent beam out of its plane, and `plates` the factor of
wide beams.
"""

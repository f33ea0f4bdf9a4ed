"""The equations of equilibrium, which all analyses share.

Internal. Start reading in `system`, which has the residual and the tangent. `dofs`
divides the coordinates into free and prescribed ones, `load_state` has the loads from
which load increments begin, `tangent` the stiffness about an equilibrium, and
`consistency` checks that loads, supports, and constraints have a solution.
"""

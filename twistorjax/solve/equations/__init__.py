"""The equations of equilibrium, which all analyses share.

Internal. Start reading in `problem`, which checks the arguments of an analysis, and in
`system`, which has the residual and the tangent. `dofs` divides the coordinates into free
and prescribed ones, `tangent` has the forms of the tangent stiffness, and `load_state`
the loads from which load increments begin. `state` and `consistency` check a state about
which equations are linearized. `modes`, `mobility`, and `stresses` are computed there.
"""

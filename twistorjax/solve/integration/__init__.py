"""The equations of motion and their integration in time.

Internal. Start reading in `system`, which has the equations of motion. `initial_value`
checks the arguments and makes the initial state consistent. `collocation` has the solvers
Radau and Gauss, with the coefficients of `schemes` and the dense output of `polynomials`.
`diffrax_interface` connects them and the solvers of diffrax, and `adjoint` differentiates
a motion in reverse mode. `solution` is the result, and `errors` has its messages.
"""

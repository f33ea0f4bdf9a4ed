"""The search for an equilibrium.

Internal. Start reading in `newton`, which solves the equations in load increments.
`derivatives` differentiates the equilibrium by the implicit function theorem, with one
linear solve and not through the steps. `solver` does both for the arguments of an
analysis, `solution` has the result, and `errors` has its messages.
"""

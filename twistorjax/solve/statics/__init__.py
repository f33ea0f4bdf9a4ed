"""The search for an equilibrium.

Internal. Start reading in `newton`, which solves the equations in load increments.
`derivatives` differentiates the equilibrium by the implicit function theorem, with one
linear solve and not through the steps. `solution` has the result and `errors` its
messages. `range_search` finds the load at which a stress is reached.
"""

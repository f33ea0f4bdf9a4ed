"""The numbers of a design: parameters, grids, and random variables.

Internal. Start reading in `parameters`. `designs` has the grids and tables of a sweep,
`distributions` and `sampling` draw random designs, and `design_space` has the variables
of an optimization with their bounds. `vector_layout` arranges the numbers of a design as
a vector. Nothing here knows mechanics.
"""

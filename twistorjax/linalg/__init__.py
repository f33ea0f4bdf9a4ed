"""Matrices without mechanics: factorizations, eliminations, and eigenvalues.

Internal. Start reading in `factors`, which solves linear systems, also with constraints.
`elimination` unrolls small systems, `block_factors` splits large ones into blocks that a
tree connects, `eigenvalues` computes natural modes with derivatives, and `sums` adds
chosen entries.
"""

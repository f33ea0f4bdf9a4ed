"""Matrices without mechanics: factorizations, eliminations, and eigenvalues.

Internal. Start reading in `factors`, which solves linear systems of a stiffness.
`elimination` solves small ones without LAPACK, `constraints` those with constraints, and
`block_factors` large ones that are block tridiagonal. `eigenvalues` computes natural
modes with derivatives, `products` multiplies small matrices, and `sums` adds chosen
entries.
"""

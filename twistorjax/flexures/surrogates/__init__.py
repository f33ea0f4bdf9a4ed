"""Polynomial energies that approximate a beam or a sub-mechanism.

Internal. Start reading in `surrogate`. `samples` computes the displacements and wrenches
of a beam to which a polynomial is fitted, and `mechanisms` those of a sub-mechanism.
"""

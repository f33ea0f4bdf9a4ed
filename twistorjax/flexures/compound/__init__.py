"""Flexures that consist of several hinges: chains, pivots, and guides.

Internal. Start reading in `condensed`, which makes one energy of a sub-mechanism.
`pivots` and `guides` build common sub-mechanisms from `leaves`, and `chain` divides a
beam into segments.
"""

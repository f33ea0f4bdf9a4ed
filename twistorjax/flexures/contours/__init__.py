"""Notches and leaves with other contours than parallel lines.

Internal. Start reading in `profiles`, which has the thickness along each contour.
`energies` makes hinges of them, by the stiffness in `integrals`, within the `limits` of
the dimensions.
"""

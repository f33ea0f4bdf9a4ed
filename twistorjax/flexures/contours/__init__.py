"""Notches and leaves with other contours than parallel lines.

Internal. Start reading in `contour`: a contour is a class with the thickness along the
axis, its integrals, and the limits of its dimensions. `leaves` and `notches` have the
contours, and the public functions that return their energies and their profiles.
"""

"""Outlines of hinges that are not polygons."""

import equinox as eqx


class AbstractOutline(eqx.Module):
    """An outline of a hinge that is drawn by its own parts, as a `SubMechanism` is."""

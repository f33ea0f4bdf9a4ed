"""Answers as labelled tables, with their units."""

from typing import TYPE_CHECKING

import numpy as np


if TYPE_CHECKING:
    import xarray

    from .motion import Motion


def motion_table(motion: "Motion") -> "xarray.Dataset":
    """A motion as a dataset of its bodies' motions, reactions and energies.

    Args:
        motion: one, not a batch of them.

    Returns:
        `angle`, `x`, `y` of each body, their rates, what holds or drives it, what each
        constraint exerts, and the energies, over time; each with its `units`.

    Raises:
        ImportError: xarray is not installed.
        ValueError: the motion is a batch of them.

    Example:
        >>> from twistorjax.cases import four_bar
        >>> table = motion_table(four_bar.drive(four_bar.four_bar()))
        >>> float(table.x.sel(body="3").sel(time=0.09, method="nearest"))
        -0.01486...
    """
    try:
        import xarray
    except ImportError as error:
        raise ImportError(
            'Tables need xarray: install it with `pip install "twistorjax[data]"`.'
        ) from error

    if np.ndim(motion.times) != 1:
        raise ValueError(
            f"This is a batch of motions, of shape {np.shape(motion.times)[:-1]}: make a "
            "table of one, `jax.tree.map(lambda array: array[0], motion)`."
        )
    columns = {}

    def put(dimensions, values, *names_and_units):
        for k, (name, unit) in enumerate(names_and_units):
            column = np.asarray(values) if len(names_and_units) == 1 else values[..., k]
            columns[name] = (dimensions, np.asarray(column), {"units": unit})

    rows = ("time", "body")
    put(rows, motion.poses, ("angle", "rad"), ("x", "m"), ("y", "m"))
    velocities = (
        ("angular_velocity", "rad/s"),
        ("velocity_x", "m/s"),
        ("velocity_y", "m/s"),
    )
    put(rows, motion.velocities, *velocities)
    put(rows, motion.reactions, ("moment", "N m"), ("force_x", "N"), ("force_y", "N"))
    if motion.joints:
        columns["push"] = (("time", "entry"), np.asarray(motion.pushes))
    for name in ("elastic", "kinetic", "dissipated", "by_loads", "by_drives"):
        put(("time",), getattr(motion.energies, name), (f"energy_{name}", "J"))
    coordinates = {
        "time": ("time", np.asarray(motion.times), {"units": "s"}),
        "body": list(motion.names),
    }
    if motion.joints:
        coordinates["entry"] = list(motion.joints)
    steps = {"steps": int(motion.steps), "rejected": int(motion.rejected)}
    return xarray.Dataset(columns, coordinates, attrs=steps)

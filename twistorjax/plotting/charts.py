"""Pictures of a sweep: answers over the parameters of its designs."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .canvas import INK, readable, subplots


if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


def chart(table: "xarray.Dataset", answers: Sequence[str]) -> "Figure":
    """Draws answers of a sweep: lines over one parameter, colours over two.

    Designs without an answer are left white.

    Args:
        table: of a sweep, over `design` with one parameter, or over a grid of one or two.
        answers: names of numbers, a panel for each.

    Raises:
        ValueError: a name is not that of a number of each design; there are more than
            two parameters.
    """
    for name in answers:
        dims = table[name].dims if name in table else ()
        if not 1 <= len(dims) <= 2 or any(str(dim) not in _axes(table) for dim in dims):
            numbers = [
                str(key)
                for key, values in table.data_vars.items()
                if 1 <= values.ndim <= 2 and {*map(str, values.dims)} <= _axes(table)
            ]
            raise ValueError(
                f"{name!r} cannot be drawn: draw {', '.join(numbers) or 'something else'}"
                ", over one or two parameters."
            )
    figure, panels = subplots(
        1, len(answers), size=(4.2 * len(answers), 3.4), squeeze=False
    )
    for name, axes in zip(answers, panels.flat, strict=True):
        values = table[name]
        told, factor = _scaled(name, values)
        if values.ndim == 1:
            places = _places(table, str(values.dims[0]))
            x, along = _scaled(str(places.name), places)
            axes.plot(along * places, factor * values, color=INK)
            axes.set_xlabel(x)
            axes.set_ylabel(told)
            axes.grid(alpha=0.3)
            continue
        below, left = (table[str(dim)] for dim in reversed(values.dims))
        x, along = _scaled(str(below.name), below)
        y, up = _scaled(str(left.name), left)
        colors = axes.pcolormesh(
            along * below, up * left, factor * values, cmap="cividis", shading="nearest"
        )
        axes.set_xlabel(x)
        axes.set_ylabel(y)
        axes.figure.colorbar(colors, ax=axes, label=told)
    return figure


def _axes(table: "xarray.Dataset") -> set[str]:
    """The axes along which designs differ."""
    if "design" in table.sizes:
        return {"design"}
    return {str(name) for name in table["succeeded"].dims}


def _places(table: "xarray.Dataset", axis: str) -> "xarray.DataArray":
    """What is told along an axis of designs."""
    if axis != "design":
        return table[axis]
    rows = [c for c in table.coords.values() if c.dims == ("design",)]
    if len(rows) != 1:
        raise ValueError(
            f"The designs differ in {len(rows)} parameters: a line is drawn over one."
        )
    return rows[0]


def _scaled(name: str, values: "xarray.DataArray") -> tuple[str, float]:
    """What an axis is called, and by how much its numbers are multiplied."""
    unit = values.attrs.get("units", "")
    if unit in ("", "1"):
        return name, 1.0
    size = np.nanmax(np.abs(values)) if np.any(np.isfinite(values)) else 1.0
    factor, unit = readable(unit, float(size))
    return f"{name} ({unit})", factor

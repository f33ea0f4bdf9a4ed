"""Charts of a sweep: outputs over the parameters of its designs."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from .figure_style import DARK_BLUE, prefixed_unit, subplots


if TYPE_CHECKING:
    import xarray
    from matplotlib.figure import Figure


def draw_sweep(results: "xarray.Dataset", outputs: Sequence[str]) -> "Figure":
    """Draw outputs of a sweep as lines over one parameter, or as contours over two.

    The parameters are the axes of a grid, or the one parameter of `design`. Designs that
    failed are left blank.

    Args:
        results: Result of `sweep` or of `open_sweep`.
        outputs: Names of outputs, each of which is one number for each design.

    Returns:
        The figure, which has axes for each output.

    Raises:
        ImportError: Matplotlib is not installed.
        ValueError: An output is unknown, or has not one number for each design; or the
            designs differ in more than two parameters.

    Example:
        >>> import twistorjax as tj
        >>> grid = tj.Grid({"x": np.linspace(0, 1, 5), "y": np.linspace(0, 2, 6)})
        >>> results = tj.sweep(lambda design: {"xy": design["x"] * design["y"]}, grid)
        >>> figure = tj.plotting.draw_sweep(results, ["xy"])
    """
    for name in outputs:
        dims = results[name].dims if name in results else ()
        if not 1 <= len(dims) <= 2 or any(str(dim) not in _axes(results) for dim in dims):
            numbers = [
                str(key)
                for key, values in results.data_vars.items()
                if 1 <= values.ndim <= 2 and {*map(str, values.dims)} <= _axes(results)
            ]
            raise ValueError(
                f"The output {name!r} cannot be drawn: it must be one number for each "
                "design, over one or two parameters. Outputs that can be drawn: "
                f"{', '.join(numbers) or 'none'}."
            )
    figure, panels = subplots(
        1, len(outputs), size=(4.2 * len(outputs), 3.4), squeeze=False
    )
    for name, axes in zip(outputs, panels.flat, strict=True):
        values = results[name]
        label, factor = _label_and_factor(name, values)
        if values.ndim == 1:
            parameter = _parameter(results, str(values.dims[0]))
            x_label, x_factor = _label_and_factor(str(parameter.name), parameter)
            axes.plot(x_factor * parameter, factor * values, color=DARK_BLUE)
            axes.set_xlabel(x_label)
            axes.set_ylabel(label)
            axes.grid(alpha=0.3)
            continue
        x, y = (results[str(dim)] for dim in reversed(values.dims))
        x_label, x_factor = _label_and_factor(str(x.name), x)
        y_label, y_factor = _label_and_factor(str(y.name), y)
        colors = axes.pcolormesh(
            x_factor * x, y_factor * y, factor * values, cmap="cividis", shading="nearest"
        )
        axes.set_xlabel(x_label)
        axes.set_ylabel(y_label)
        bar = axes.figure.colorbar(colors, ax=axes, label=label)
        if min(values.shape) > 1 and np.ptp(values.values[np.isfinite(values)]) > 0:
            lines = axes.contour(
                x_factor * x, y_factor * y, factor * values,
                levels=bar.get_ticks(), colors="white", linewidths=0.8,
            )  # fmt: skip
            axes.clabel(lines, fontsize="small")
    return figure


def _axes(table: "xarray.Dataset") -> set[str]:
    """Return the dimensions along which designs differ."""
    if "design" in table.sizes:
        return {"design"}
    return {str(name) for name in table["succeeded"].dims}


def _parameter(table: "xarray.Dataset", dimension: str) -> "xarray.DataArray":
    """Return the values of the parameter along a dimension of designs."""
    if dimension != "design":
        return table[dimension]
    parameters = [c for c in table.coords.values() if c.dims == ("design",)]
    if len(parameters) != 1:
        raise ValueError(
            f"The designs differ in {len(parameters)} parameters, but a line is drawn "
            "over one. Use a grid of one or two parameters."
        )
    return parameters[0]


def _label_and_factor(name: str, values: "xarray.DataArray") -> tuple[str, float]:
    """Return the label of an axis, and the factor from SI units to its units."""
    unit = values.attrs.get("units", "")
    if unit in ("", "1"):
        return name, 1.0
    largest = np.nanmax(np.abs(values)) if np.any(np.isfinite(values)) else 1.0
    factor, unit = prefixed_unit(unit, float(largest))
    return f"{name} ({unit})", factor

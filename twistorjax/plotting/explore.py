"""A mechanism whose parameters are changed by sliders, in a notebook or on a page."""

import base64
import json
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from typing_extensions import TypeAliasType

from .._compile.compilation import fast_compile
from .._utils.html import page
from .._utils.types import NumberLike
from .._utils.validation import (
    compilation_error,
    quote,
    require_finite,
    require_float64,
    require_package,
    require_shape,
)
from ..designs.parameters import Parameter
from ..mechanism.mechanism import Mechanism
from ..results.codes import result_message, result_names
from ..solve.equilibrium import equilibrium
from ..solve.statics.solution import Equilibrium
from .drawing import COLORS
from .figure_style import length_unit, prefixed_unit
from .shapes import shapes, with_flexure_outlines


_POSITIONS = 40  # of a curve. The same program solves them and the design that is drawn.
_MOST_STATES = 20_000  # of a page
_STEPS = 32_000  # of the coordinates in a page, which are whole numbers of 16 bits
_SCRIPT = Path(__file__).with_name("explore.js")
_BODY = """<div id="explorer"></div>
<script type="module">
{script}
render({{ model: tableOf({data}), el: document.getElementById("explorer") }});
</script>"""

# Function of a mechanism and its equilibrium
Curve = TypeAliasType("Curve", Callable[[Mechanism, Equilibrium], NumberLike])


class State(NamedTuple):
    """What is shown of one design."""

    # Kind and corners (m) of each shape; none without an equilibrium, or if not drawn
    drawn: list[tuple[str, np.ndarray]]
    outputs: list[float | None]  # of the curves; None if there is no equilibrium
    message: str  # the reason why there is no equilibrium


class Explorer:
    """A mechanism with sliders, which `explore` creates. A notebook displays it."""

    def __init__(
        self,
        build: Callable[[Any], Any],
        parameters: Mapping[str, Any],
        curves: Mapping[str, Curve],
        magnify: NumberLike,
    ):
        for argument, given in (("parameters", parameters), ("curves", curves)):
            if not isinstance(given, Mapping):
                raise ValueError(
                    f"`{argument}` is {quote(given)}, but must be a mapping from names."
                )
        self._magnify = float(require_finite("`magnify`", magnify))
        variables = {
            name: parameter
            for name, parameter in parameters.items()
            if isinstance(parameter, Parameter)
        }
        if not variables:
            raise ValueError(
                "`parameters` has no `Parameter`, so there is nothing to change. Give "
                'some as tj.Parameter(0.5e-3, "m", lower=0.3e-3, upper=0.8e-3).'
            )
        for name, parameter in variables.items():
            if parameter.value.shape or None in (parameter.lower, parameter.upper):
                raise ValueError(
                    f"The parameter {name!r} is {parameter!r}, but must be one number "
                    "with both bounds, between which its slider moves."
                )

        def solve(values: Any) -> Any:
            built = build({**parameters, **dict(zip(variables, values, strict=True))})
            mechanism, case = built if isinstance(built, tuple) else (built, {})
            if not isinstance(mechanism, Mechanism) or not isinstance(case, Mapping):
                raise ValueError(
                    f"`build` returned {quote(built)}, but must return a mechanism, or a "
                    "mechanism and a mapping with arguments of `equilibrium`."
                )
            solution = equilibrium(mechanism, **{**case, "throw": False})
            outputs = [
                require_shape(
                    f"`curves[{label!r}]`",
                    curve(mechanism, solution),
                    (),
                    "be one number",
                )
                for label, curve in curves.items()
            ]
            return mechanism, solution.poses, outputs, solution.result

        self._solve_all = fast_compile(jax.vmap(solve), store=False, jit=jax.jit)
        self._bounds = np.array([(p.lower, p.upper) for p in variables.values()])
        start = np.array([float(parameter.value) for parameter in variables.values()])
        # The window shows the mechanism at both bounds of each parameter.
        ends = [
            np.where(np.arange(len(start)) == column, bound, start)
            for column, bounds in enumerate(self._bounds)
            for bound in bounds
        ]
        try:
            first, *others = self._states(np.array([start, *ends]))
        except jax.errors.JAXTypeError as error:
            raise compilation_error("build", "of the design", error) from error
        if not first.drawn:
            raise ValueError(
                f"The values of `parameters` cannot be drawn: {first.message}"
            )
        size = float(np.max(np.ptp(_corners(first.drawn), axis=0)))
        self._per_meter, unit = length_unit(size)
        corners = self._per_meter * np.concatenate(
            [_corners(state.drawn) for state in (first, *others) if state.drawn]
        )
        sliders = []
        for name, parameter in variables.items():
            bounds = np.array([parameter.lower, parameter.upper])
            factor, slider_unit = prefixed_unit(
                str(parameter.unit), float(np.max(np.abs(bounds)))
            )
            lower, upper = (factor * bounds).tolist()
            sliders.append(
                {
                    "name": name,
                    "unit": slider_unit,
                    "factor": factor,
                    "lower": lower,
                    "upper": upper,
                    "value": factor * float(parameter.value),
                }
            )
        self._page = {
            "sliders": sliders,
            "curves": list(curves),
            "unit": unit,
            "box": [*corners.min(axis=0).tolist(), *corners.max(axis=0).tolist()],
            "shapes": [[kind, len(corners)] for kind, corners in first.drawn],
            "colors": COLORS,
            "magnify": self._magnify,
        }

    @cached_property
    def widget(self) -> Any:
        """The widget, an `anywidget.AnyWidget`.

        Raises:
            ImportError: Anywidget is not installed.
        """
        anywidget = require_package("anywidget", "Sliders in a notebook", "explore")
        import traitlets

        class Widget(anywidget.AnyWidget):
            _esm = _SCRIPT.read_text(encoding="utf-8")
            page = traitlets.Dict(self._page).tag(sync=True)
            request = traitlets.Dict().tag(sync=True)
            state = traitlets.Dict().tag(sync=True)

        def answer(change: Any) -> None:
            widget.state = self._answer(change["new"])

        widget = Widget()
        widget.observe(answer, "request")
        return widget

    def save(self, path: str | Path, levels: int = 21) -> None:
        """Write a page with precomputed states, which works without Python.

        Args:
            path: Path of the file, which ends with .html.
            levels: Number of positions of each slider, one of which is its start. All
                combinations are computed.

        Raises:
            ValueError: The path has another ending, or there are more than 20,000 states.
            OSError: The file cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() != ".html":
            raise ValueError(f"`path` is {str(path)!r}, but must end with .html.")
        count = levels ** len(self._bounds)
        if levels < 2 or count > _MOST_STATES:
            raise ValueError(
                f"`levels` is {levels}, which gives {count:,} states of "
                f"{len(self._bounds)} parameters, but must be 2 or more and give at most "
                f"{_MOST_STATES:,} states."
            )
        axes = [np.linspace(low, high, levels) for low, high in self._bounds]
        sliders = [dict(slider) for slider in self._page["sliders"]]
        for axis, slider in zip(axes, sliders, strict=True):
            start = slider["value"] / slider["factor"]
            axis[np.argmin(np.abs(axis - start))] = start
            slider["positions"] = (slider["factor"] * axis).tolist()
        grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
        states = self._states(grid.reshape(-1, len(axes)))
        corners = self._per_meter * np.array(
            [_corners(state.drawn) for state in states if state.drawn]
        )
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        scale = np.max(high - low) / _STEPS
        whole = np.round((corners - low) / scale).astype("<i2")
        data = {
            "page": {
                **self._page,
                "sliders": sliders,
                "box": [*low.tolist(), *high.tolist()],
            },
            "origin": low.tolist(),
            "scale": float(scale),
            "points": base64.b64encode(whole.tobytes()).decode(),
            "outputs": [state.outputs for state in states],
            "messages": [state.message for state in states],
        }
        text = json.dumps(data, allow_nan=False).replace("</", "<\\/")
        script = _SCRIPT.read_text(encoding="utf-8")
        body = _BODY.format(script=script, data=text)
        path.write_text(page(path.stem, body), encoding="utf-8")

    def _repr_mimebundle_(self, **options: Any) -> Any:
        return self.widget._repr_mimebundle_(**options)

    def _answer(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """Return what is shown for the positions of the sliders."""
        factors = np.array([slider["factor"] for slider in self._page["sliders"]])
        over = request["over"]
        rows = np.tile(np.array(request["values"]) / factors, (_POSITIONS + 1, 1))
        low, high = self._bounds[over]
        rows[1:, over] = np.linspace(low, high, _POSITIONS)
        here, *along = self._states(rows, drawn=1)
        corners = self._per_meter * _corners(here.drawn)
        return {
            "number": request["number"],
            "points": corners.ravel().tolist(),
            "message": here.message,
            "outputs": here.outputs,
            "at": (factors[over] * rows[1:, over]).tolist(),
            "along": [state.outputs for state in along],
        }

    def _states(
        self, rows: Float[np.ndarray, "designs parameters"], drawn: int | None = None
    ) -> list[State]:
        """Compute what is shown of each design. By default all of them are drawn."""
        if len(rows) > _POSITIONS + 1:
            halves = rows[: _POSITIONS + 1], rows[_POSITIONS + 1 :]
            return [state for half in halves for state in self._states(half)]
        padding = np.tile(rows[-1:], (_POSITIONS + 1 - len(rows), 1))
        solved = self._solve_all(np.concatenate([rows, padding]))
        mechanisms, poses, outputs, results = jax.device_get(solved)
        table = np.stack(outputs, axis=1) if outputs else np.zeros((len(poses), 0))
        states = []
        names = result_names(results)
        assert names is not None  # not traced
        for k, name in enumerate(names[: len(rows)]):
            succeeded = name == "successful"
            parts = []
            if succeeded and (drawn is None or k < drawn):
                mechanism = jax.tree.map(lambda leaf, k=k: leaf[k], mechanisms)
                parts = _drawn(mechanism, poses[k], self._magnify)
            numbers = [
                x if succeeded and np.isfinite(x) else None for x in table[k].tolist()
            ]
            reason = "" if succeeded else result_message(name)
            states.append(State(parts, numbers, reason))
        return states


def explore(
    build: Callable[[Any], Any],
    parameters: Mapping[str, Any],
    curves: Mapping[str, Curve] = MappingProxyType({}),
    *,
    magnify: NumberLike = 1.0,
) -> Explorer:
    """Change parameters and loads of a mechanism by sliders.

    The deformed mechanism follows while a slider moves, and so does a curve over one of
    the parameters. All designs are solved by one compiled program.

    Args:
        build: Function of one design, as for `sweep`. It returns a mechanism, or a
            mechanism and arguments of `equilibrium` by their names, such as
            `{"loads": [...]}`. It is traced.
        parameters: One design. Each `Parameter` in it has a slider between its bounds,
            which begins at its value. Other values are constants.
        curves: Functions of the mechanism and its equilibrium, by the labels of their
            axis, for example `{"x (mm)": lambda mechanism, solution: ...}`. They are
            traced.
        magnify: Factor on the displacements that are drawn, such as 100 for the strokes
            of a piezoelectric stack.

    Returns:
        The explorer. JupyterLab, VS Code, and marimo display it (extra `explore`), in
        marimo as `marimo.ui.anywidget(explorer.widget)`. Its method `save("guide.html")`
        writes a page with precomputed states that works without Python.

    Raises:
        ValueError: Double precision is off; no value is a `Parameter`, or one has no
            bounds or is an array; `build` returns something else; or the mechanism has no
            equilibrium at the start.

    Example:
        >>> import twistorjax as tj
        >>> steel = tj.Material(modulus=210e9, poisson=0.3)
        >>> def spring(design):
        ...     leaf = tj.flexures.leaf(
        ...         steel, length=50e-3, thickness=design["thickness"], width=10e-3
        ...     )
        ...     bodies = [tj.Body("wall"), tj.Body("tip", pose=(0.0, 50e-3, 0.0))]
        ...     hinge = tj.Hinge("leaf", "wall", "tip", leaf, at=(0.0, 25e-3, 0.0))
        ...     push = tj.Load("tip", force=(0.0, design["force"]))
        ...     return tj.Mechanism(bodies, [hinge], fixed=["wall"]), {"loads": [push]}
        >>> explorer = tj.explore(
        ...     spring,
        ...     {
        ...         "thickness": tj.Parameter(0.5e-3, "m", lower=0.3e-3, upper=0.8e-3),
        ...         "force": tj.Parameter(1.0, "N", lower=-2.0, upper=2.0),
        ...     },
        ...     {"y (mm)": lambda _, solution: 1e3 * solution.displacement("tip")[2]},
        ... )
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     explorer.save(f"{folder}/spring.html", levels=5)
    """
    require_float64(jnp.zeros(0))
    return Explorer(build, parameters, curves, magnify)


def _drawn(
    mechanism: Mechanism, poses: Float[np.ndarray, "bodies 3"], magnify: float
) -> list[tuple[str, np.ndarray]]:
    """Return kinds and corners (m) of the bodies before, and of all parts now."""
    mechanism = with_flexure_outlines(mechanism)
    reference = np.asarray(mechanism.reference)
    moved = shapes(mechanism, reference + magnify * (poses - reference), magnify)
    return [
        *(
            ("reference", shape.corners)
            for shape in shapes(mechanism, reference)
            if shape.part[0] == "body"
        ),
        *((shape.kind, shape.corners) for shape in moved),
    ]


def _corners(drawn: list[tuple[str, np.ndarray]]) -> Float[np.ndarray, "corners 2"]:
    """Return the corners of all shapes; m."""
    return np.concatenate([corners for _, corners in drawn] or [np.zeros((0, 2))])

"""`twistorjax four-bar-models`: the four-bar linkages with several hinge models."""

from typing import Any

import numpy as np

from .common import (
    JsonOption,
    PlotOption,
    prepare_jax,
    print_result,
    SolveError,
)


_TITLES = {
    "identical": "four identical leaves (section 5.2)",
    "leaves-and-notches": "two leaves and two notches (section 5.3)",
}


def four_bar_models(as_json: JsonOption = False, plot: PlotOption = None) -> None:
    """Compare models of the hinges of the four-bar linkages: pins, quadratics, and beams.

    Link 2 rotates by 2 to 18 degrees. The torque on it and the motion of link 3 are
    compared with those of exact beams. The first call compiles for about a minute.

    Example: twistorjax four-bar-models --plot models.png
    """
    prepare_jax()
    from ..examples import four_bar_models as example

    comparisons = {}
    for hinges in ("identical", "leaves-and-notches"):
        comparison = example.compare(example.four_bar_models(hinges))
        _require_success(comparison)
        comparisons[hinges] = comparison
    titled = {_TITLES[name]: part for name, part in comparisons.items()}
    record = {name: _record(comparison) for name, comparison in comparisons.items()}
    text, draw = _table(comparisons), lambda: example.plot(titled)
    print_result(text, record, as_json, plot=plot, draw=draw)


def _require_success(comparison: Any) -> None:
    """Raise a `SolveError` if a model could not be solved at all rotations."""
    failed = np.argwhere(comparison.results != "successful")
    if len(failed):
        model, row = failed[0]
        raise SolveError(
            f"The model {comparison.models[model]!r} failed at a rotation of "
            f"{comparison.rotations[row]:.4g} rad: {comparison.results[model, row]}."
        )


def _table(comparisons: dict[str, Any]) -> str:
    """List the last state and the largest differences of all models of the linkages."""
    lines = []
    for hinges, comparison in comparisons.items():
        last = f"at {np.degrees(comparison.rotations[-1]):.3g} degrees of link 2"
        if not lines:
            lines = [
                f"{'':26} {last:>38}   largest difference from beam",
                f"{'':26} {'rotation':>8}{'x':>8}{'y':>7}{'torque':>8}{'energy':>7} "
                f"{'rotation':>9}{'motion':>7}{'torque':>7}{'energy':>7}",
                f"{'':26} {'deg':>8}{'mm':>8}{'mm':>7}{'N mm':>8}{'mJ':>7} "
                f"{'deg':>9}{'mm':>7}{'%':>7}{'%':>7}",
            ]
        lines.append(_TITLES[hinges])
        largest = np.max(np.abs(comparison.differences()), axis=1)
        largest *= np.array([180 / np.pi, 1e3, 100.0, 100.0])
        for k, name in enumerate(comparison.models):
            angle, x, y = comparison.displacements[k, -1]
            torque, energy = comparison.torques[k, -1], comparison.energies[k, -1]
            state = (
                f"{np.degrees(angle):8.4f}{1e3 * x:8.3f}{1e3 * y:7.3f}"
                f"{1e3 * torque:8.2f}{1e3 * energy:7.2f}"
            )
            rotation, *others = largest[k]
            errors = f"{rotation:9.4f}" + "".join(f"{value:7.3f}" for value in others)
            lines.append(
                f"{name:26} {state} {errors if largest[k].any() else ''}".rstrip()
            )
    return "\n".join(lines)


def _record(comparison: Any) -> dict[str, Any]:
    """Return the values of one linkage for JSON."""
    names = ("rotation_rad", "displacement_m", "torque", "energy")
    largest = np.max(np.abs(comparison.differences()), axis=1).tolist()
    models = {}
    for k, name in enumerate(comparison.models):
        angles, x, y = comparison.displacements[k].T.tolist()
        models[name] = {
            "rotation_rad": angles,
            "x_m": x,
            "y_m": y,
            "torque_Nm": comparison.torques[k].tolist(),
            "energy_J": comparison.energies[k].tolist(),
            "largest_difference": dict(zip(names, largest[k], strict=True)),
        }
    return {"crank_rotations_rad": comparison.rotations.tolist(), "models": models}

"""Parallelogram flexure under large loads, compared with 3-D finite elements.

Two parallel leaves carry a platform. The load cases are those of an open comparison of
models with solid finite elements (repository haijunsu-osu/parallelogram_model_comparison,
2026). Forces are in units of E I / L^2 and moments in units of E I / L, where E I is the
bending stiffness of one leaf, and L its length.
"""

from pathlib import Path
from typing import NamedTuple, TYPE_CHECKING

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from .._utils.csv_files import CsvFile
from .._utils.host import as_float, padded_size
from .._utils.progress import announced
from .._utils.types import NumberLike
from ..flexures import Beam, chain
from ..mechanism.body import Body
from ..mechanism.loads import Load
from ..mechanism.material import Material
from ..mechanism.mechanism import Mechanism
from ..plotting.figure_style import DARK_BLUE, ORANGE, subplots
from ..results.codes import is_success, result_names, RESULTS
from ..solve.equilibrium import equilibrium


if TYPE_CHECKING:
    from matplotlib.figure import Figure


LENGTH, THICKNESS, WIDTH, SPACING = 0.25, 5e-3, 0.05, 0.15  # m
MODULUS, POISSON = 210e9, 0.3  # Pa, -
UNIT = MODULUS * WIDTH * THICKNESS**3 / (12 * LENGTH**2)  # E I / L^2; N
# The leaves bend as plates. The factor gives the transverse displacement of the finite
# elements at a transverse load of 1.
BENDING_FACTOR = 1.04

_LOADS = ("transverse_EI_L2", "axial_EI_L2", "moment_EI_L")
_DISPLACEMENTS = ("ux_L", "uy_L", "phi_rad")
# Range of the leaves, which are three segments, or up to ten for larger loads; E I / L^2
_SMALLEST_FORCE, _LARGEST_FORCE = 45.0, 500.0
_SMALLEST_BATCH = 128  # smaller numbers of load cases share a program


class LoadCases(NamedTuple):
    """Loads on the center of the platform, in line with the ends of the leaves.

    Args:
        loads: Transverse force, axial force, and moment of each case; E I / L^2,
            E I / L^2, E I / L.
        expected: Axial and transverse displacement over L, and rotation (rad), with which
            the results are compared; None if there are none.
    """

    loads: Float[np.ndarray, "cases 3"]
    expected: Float[np.ndarray, "cases 3"] | None


def parallelogram(
    bending_factor: NumberLike = BENDING_FACTOR, force: NumberLike = _SMALLEST_FORCE
) -> Mechanism:
    """Create the parallelogram, whose leaves are chains of surrogates.

    Args:
        bending_factor: Factor of the bending stiffness of the leaves.
        force: Largest force on a leaf; E I / L^2.

    Returns:
        The mechanism. Axis x is along the leaves; the body "platform" has its origin at
        the middle between the ends of the leaves.
    """
    material = Material(MODULUS, POISSON)
    leaf = Beam(
        material,
        length=LENGTH,
        thickness=THICKNESS,
        width=WIDTH,
        bending_factor=bending_factor,
    )
    half = SPACING / 2
    leaves = [
        chain(name, leaf, "base", "platform", (0.0, LENGTH / 2, y), force=force * UNIT)
        for name, y in (("upper", half), ("lower", -half))
    ]
    corners = np.array([[0.0, -1.3], [0.3, -1.3], [0.3, 1.3], [0.0, 1.3]]) * half
    base = Body("base", outline=-corners)
    platform = Body("platform", (0.0, LENGTH, 0.0), outline=corners)
    bodies = [body for leaf in leaves for body in leaf.bodies]
    hinges = [hinge for leaf in leaves for hinge in leaf.hinges]
    return Mechanism([base, platform, *bodies], hinges, fixed=["base"])


def default_cases() -> LoadCases:
    """Return transverse loads up to 20 E I / L^2, with three axial loads."""
    transverse = [1.0, 2.0, 5.0, 10.0, 15.0, 20.0]
    rows = [(force, axial, 0.0) for axial in (-5.0, 0.0, 5.0) for force in transverse]
    return LoadCases(np.array(rows), None)


def read_cases(path: str | Path) -> LoadCases:
    """Read load cases, and the results with which they are compared, if there are any.

    Args:
        path: Text file of separated values with the columns transverse_EI_L2,
            axial_EI_L2, and moment_EI_L; optionally also ux_L, uy_L, and phi_rad.

    Returns:
        The load cases.

    Raises:
        ValueError: A column is missing, there are no cases, or an entry is not a number.
        OSError: The file cannot be read.
    """
    table = CsvFile(path)
    missing = [name for name in _LOADS if name not in table.names]
    if missing or not len(table):
        raise ValueError(
            f"{path} has no {f'column {missing[0]}' if missing else 'load cases'}. The "
            f"first line must name the columns {', '.join(_LOADS)}, and each further "
            "line has the loads of one case."
        )
    present = [name for name in _DISPLACEMENTS if name in table.names]
    if present and len(present) < len(_DISPLACEMENTS):
        raise ValueError(
            f"{path} has the column {present[0]}, but a comparison needs all of "
            f"{', '.join(_DISPLACEMENTS)}."
        )
    loads = np.stack([table.numbers(name) for name in _LOADS], axis=1)
    if not present:
        return LoadCases(loads, None)
    expected = [table.numbers(name) for name in _DISPLACEMENTS]
    return LoadCases(loads, np.stack(expected, axis=1))


class Study(eqx.Module):
    """Displacements of the platform in all load cases.

    Args:
        cases: The load cases.
        displacements: Axial and transverse displacement over L, and rotation (rad); NaN
            for a case that failed.
        result: `RESULTS.successful` or the reason of the failure, for each case.
        bending_factor: Factor of the bending stiffness.
    """

    cases: LoadCases
    displacements: Float[np.ndarray, "cases 3"]
    result: RESULTS
    bending_factor: float

    @property
    def names(self) -> np.ndarray:
        """Name of the result of each case, "successful" or the reason of the failure."""
        return np.asarray(result_names(self.result))

    @property
    def succeeded(self) -> Bool[np.ndarray, " cases"]:
        """Whether each case could be computed."""
        return np.asarray(is_success(self.result))

    @property
    def relative_errors(self) -> Float[np.ndarray, "cases 3"]:
        """Differences from the expected results, over the expected results."""
        expected = self.cases.expected
        if expected is None:
            raise ValueError(
                "The load cases have no expected results. Add the columns "
                f"{', '.join(_DISPLACEMENTS)} to the file."
            )
        with np.errstate(divide="ignore", invalid="ignore"):
            return self.displacements / expected - 1

    def medians(self) -> dict[str, tuple[int, int, Float[np.ndarray, "3"]]]:
        """Return the medians of the magnitudes of the relative errors.

        Returns:
            For each range of transverse loads with an expected result: the number of
            cases, the number of those that were computed, and the medians of the errors
            of axial displacement, transverse displacement, and rotation. Cases without a
            transverse load are left out, because some of their displacements are zero.
        """
        errors, found = np.abs(self.relative_errors), {}
        transverse = np.abs(self.cases.loads[:, 0])
        for lower, upper in ((0.0, 5.0), (5.0, 10.0), (10.0, 20.0), (20.0, np.inf)):
            chosen = (transverse > lower) & (transverse <= upper)
            computed = chosen & self.succeeded
            if np.any(chosen):
                name = f"{lower:g} to {upper:g}" if np.isfinite(upper) else "above 20"
                median = np.full(3, np.nan)
                if np.any(computed):
                    median = np.median(errors[computed], axis=0)
                found[name] = int(chosen.sum()), int(computed.sum()), median
        return found

    def __str__(self) -> str:
        names, solved = self.names, self.succeeded
        lines = [
            f"{np.sum(solved)} of {len(names)} load cases computed, bending factor "
            f"{self.bending_factor:g}"
        ]
        for name in sorted({*map(str, names[~solved])}):
            lines.append(f"{np.sum(names == name)} load cases: {name}")
        if self.cases.expected is None:
            lines.append("transverse  axial  moment       ux/L       uy/L        phi")
            lines.append("    EI/L^2 EI/L^2    EI/L          -          -        rad")
            for load, row in zip(self.cases.loads, self.displacements, strict=True):
                forces = f"{load[0]:10.4g} {load[1]:6.4g} {load[2]:7.4g}"
                lines.append(forces + "".join(f" {value:10.6f}" for value in row))
            return "\n".join(lines)
        lines.append("medians of the errors, relative to the given results; %")
        lines.append("transverse load   cases  computed     ux     uy    phi")
        for name, (count, computed, median) in self.medians().items():
            values = "".join(f" {100 * value:6.2f}" for value in median)
            lines.append(f"{name:15} {count:7d} {computed:9d}{values}")
        return "\n".join(lines)


@announced("equilibria of the load cases")
def study(cases: LoadCases, bending_factor: float = BENDING_FACTOR) -> Study:
    """Compute the displacements of the platform in all load cases.

    Args:
        cases: The load cases.
        bending_factor: Factor of the bending stiffness of the leaves.

    Returns:
        The displacements, and which of the cases could be computed.

    Example:
        >>> cases = LoadCases(np.array([[1.0, 0.0, 0.0]]), None)
        >>> study(cases).displacements.round(4)
        array([[-0.001 ,  0.0401,  0.0001]])
    """
    transverse, axial, moment = np.abs(cases.loads).T
    # The platform turns little, so its moment is carried by axial forces of the leaves.
    couple = (transverse / 2 + moment) * LENGTH / SPACING
    bound = float(np.max(axial + transverse / 2 + couple))
    force = min(max(_SMALLEST_FORCE, bound), _LARGEST_FORCE)
    mechanism = parallelogram(bending_factor, force)
    rows = len(cases.loads)
    padding = padded_size(rows, _SMALLEST_BATCH) - rows
    loads = np.pad(cases.loads, ((0, padding), (0, 0)))
    displacements, result = _solve(mechanism, as_float(loads))
    scale = np.array([1 / LENGTH, 1 / LENGTH, 1.0])
    found = np.asarray(displacements)[:rows, [1, 2, 0]] * scale
    result = jax.tree.map(lambda values: values[:rows], result)
    solved = np.asarray(is_success(result))
    return Study(
        cases=cases,
        displacements=np.where(solved[:, None], found, np.nan),
        result=result,
        bending_factor=bending_factor,
    )


@eqx.filter_jit
def _solve(
    mechanism: Mechanism, loads: Float[Array, "cases 3"]
) -> tuple[Float[Array, "cases 3"], RESULTS]:
    """Compute the displacement of the platform (rad, m, m) in each load case."""

    def solve(case: Float[Array, "3"]):
        transverse, axial, moment = case * UNIT
        wrench = jnp.stack([moment * LENGTH, axial, transverse])
        solution = equilibrium(mechanism, loads=[Load("platform", wrench)], throw=False)
        return solution.displacement("platform"), solution.result

    return jax.vmap(solve)(loads)


def plot(study: Study) -> "Figure":
    """Draw the displacements of a study over the transverse load."""
    figure, panels = subplots(1, 3, size=(11.0, 3.6))
    labels = ("axial displacement / L", "transverse displacement / L", "rotation (rad)")
    for column, (axes, label) in enumerate(zip(panels, labels, strict=True)):
        for pair in np.unique(study.cases.loads[:, 1:], axis=0):
            chosen = np.all(study.cases.loads[:, 1:] == pair, axis=1)
            order = np.argsort(study.cases.loads[chosen, 0])
            transverse = study.cases.loads[chosen, 0][order]
            values = study.displacements[chosen, column][order]
            axes.plot(transverse, values, color=DARK_BLUE, linewidth=1)
            if study.cases.expected is not None:
                expected = study.cases.expected[chosen, column][order]
                axes.plot(transverse, expected, ".", color=ORANGE, markersize=4)
        axes.set_xlabel("transverse load (E I / L²)")
        axes.set_ylabel(label)
        axes.grid(alpha=0.3)
    panels[0].plot([], [], color=DARK_BLUE, label="chains of surrogates")
    if study.cases.expected is not None:
        panels[0].plot([], [], ".", color=ORANGE, label="given results")
    panels[0].legend()
    return figure

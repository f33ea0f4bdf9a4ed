"""Polynomial surrogates of exact beams and of sub-mechanisms."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from ..._compile.compilation import fast_compile
from ..._utils.host import all_concrete, concrete
from ..._utils.progress import announced
from ..._utils.pytrees import stop_gradient
from ..._utils.types import NumberLike, Scalar
from ..._utils.validation import require_float64, require_interval, require_positive
from ...energies.mixed import MixedEnergy
from ...energies.monomials import monomials, Powers, Symmetry
from ...energies.one_freedom import Freedom
from ...energies.validity import WithValidityRange
from ...mechanism.sub_mechanism import SubMechanism
from ..beams.beam import arc_rotation, Beam, functions_along, Uniform
from ..beams.stress_models import BeamStress
from .fit import fit_coefficients, relative_errors
from .mechanisms import (
    fit_mechanism,
    mechanism_powers,
    mechanism_stress,
    mechanism_symmetries,
    sample_mechanism,
)
from .samples import sample_beam, SAMPLES, Samples


_ORDERS = (4, 6, 8, 10)


@announced("surrogate")
def surrogate(
    flexure: Beam | SubMechanism,
    *,
    rotation: NumberLike | None = None,
    displacement: NumberLike | None = None,
    force: NumberLike | None = None,
    stress: NumberLike | None = None,
    error: float = 1e-3,
    order: int | None = None,
) -> WithValidityRange:
    """Approximate the energy of a beam or a sub-mechanism by a polynomial.

    The energy is valid in a range of displacements and forces. That of a beam is a
    `MixedEnergy`, and that of a sub-mechanism a `OneFreedomEnergy`, which need as few
    terms for very slender leaves as for thick ones. In the reference configuration, the
    energy has the stiffness of the flexure. Its derivatives with respect to dimensions
    have about the same relative error as its wrench. To compute surrogates of many
    flexures, use `jax.jit` and `jax.lax.map`, and give `order`.

    Args:
        flexure: A beam of any thickness profile and curvature, or a sub-mechanism that is
            compliant in one direction.
        rotation: Largest rotation, in both directions; rad. A sub-mechanism is then a
            pivot, which is compliant in rotation.
        displacement: Instead of the rotation, largest displacement along axis 2 of a
            sub-mechanism that is compliant in this direction, such as a parallelogram; m.
        force: Largest magnitude of the force, in any direction; N. The default for a
            beam is 5 E I / L^2, with the length L, and the smallest range is 0.02
            E I / L^2, also if a smaller one is given. Above about 10 E I / L^2, a beam in
            compression buckles between its ends, which a polynomial cannot represent; see
            `chain`. If the displacement is given, it is the largest axial force, and
            moments are up to this force times `sqrt(k_rotation / k_axial)`, with the
            stiffness of the flexure. The default for a sub-mechanism is half of the
            smallest range of a surrogate in it.
        stress: Allowable bending stress of a beam, if the rotation is not given; Pa. The
            rotation is then that of a beam with the smallest thickness that is bent to an
            arc at this stress.
        error: Largest relative error of a component of the wrench: the rms error divided
            by the rms value, on samples that are not used in the fit. If the flexure is
            traced, the error cannot be checked, and is only returned.
        order: Order of the polynomial in the displacements: 4, 6, 8 or 10. The default is
            the lowest order with an accepted error, or 6 if the flexure is traced.

    Returns:
        The energy with its validity range. Its field `error` has the relative errors of
        the moment, the axial force and the transverse force. They are computed on
        separate samples, which are uniformly distributed over displacements and forces.
        If the stress in the hinges of a sub-mechanism is known, so is that in the energy,
        within 0.1 % of the stress in the whole sub-mechanism.

    Raises:
        ValueError: Double precision is disabled, the error is not reached, a beam buckles
            or a hinge of a sub-mechanism leaves its range within the range, or an
            argument is out of its range.

    Source:
        The polynomial energies of section 4.7 of the dissertation, as complementary
        energies of the stiff directions, and fitted to a beam instead of measurements.

    Example:
        >>> import twistorjax as tj
        >>> polymer = tj.Material(modulus=3.45e9, poisson=0.3)
        >>> beam = Beam(polymer, length=10e-3, thickness=1e-3, width=5e-3)
        >>> energy = surrogate(beam, rotation=0.8)
        >>> load = jnp.array([0.05, 0.0, 2.0])  # N m, N, N
        >>> exact = tj.flexures.beam_under_load(beam, load)
        >>> energy.wrench(exact.pose)[2].round(2), exact.wrench[2].round(2)
        (Array(1.88, dtype=float64), Array(1.88, dtype=float64))
    """
    if not isinstance(flexure, Beam | SubMechanism):
        raise ValueError(
            f"`flexure` is a {type(flexure).__name__}, but must be a `flexures.Beam`, "
            "which has the material and the dimensions, or a `SubMechanism`."
        )
    if not error > 0:
        raise ValueError(f"`error` is {error!r}, but must be positive.")
    if order is not None and order not in _ORDERS:
        raise ValueError(f"`order` is {order!r}, but must be one of {_ORDERS}.")
    if force is not None:
        force = require_positive("`force`", force)
    if displacement is not None:
        displacement = require_positive("`displacement`", displacement)
    if stress is not None:
        stress = require_positive("`stress`", stress)
        if isinstance(flexure, Beam) and rotation is None:
            rotation = arc_rotation(flexure, stress)
    if rotation is not None:
        requirement = "must be positive and at most 2 pi, in radians"
        rotation = require_interval("`rotation`", rotation, 0.0, 2 * np.pi, requirement)
    if isinstance(flexure, Beam):
        if rotation is None or displacement is not None:
            raise ValueError(
                "The range of a beam is given by `rotation` or `stress`, and not by "
                "`displacement`."
            )
        return _beam_surrogate(flexure, rotation, force, error, order)
    return _mechanism_surrogate(flexure, rotation, displacement, force, error, order)


def _beam_surrogate(
    beam: Beam,
    rotation: Scalar,
    force: Scalar | None,
    error: float,
    order: int | None,
) -> WithValidityRange:
    """Compute the surrogate of a beam; see `surrogate`."""
    require_float64(beam.length)
    symmetry = _symmetry(beam)
    bending = concrete(jax.lax.stop_gradient(beam.rotational_stiffness))
    if bending is not None and not 0 < bending < np.inf:
        raise ValueError(
            f"E I / L of the beam is {bending:g} N m/rad. Its modulus, its dimensions, "
            "or its bending factor are too large or too small."
        )
    samples = sample_beam(beam, rotation, force)

    def fit(order: int) -> WithValidityRange:
        energy = _fit(_powers(order, symmetry), beam.length, rotation, samples)
        return replace(energy, stress_model=BeamStress.of(beam))

    # Outside of programs, they are known also if JAX differentiates.
    known = all_concrete(
        stop_gradient(
            [
                rotation,
                samples.force,
                beam.rotational_stiffness / beam.length,
                samples.rotation_error,
                samples.least_failed_force,
                beam.profile(jnp.zeros(())),
            ]
        )
    )
    if known is None:
        return fit(order or 6)
    angle, largest, unit, rotation_error, least_failed, _ = known
    limits = f"a rotation of {angle:.4g} rad and a force of {largest:.4g} N"
    parts = max(2, math.ceil(math.sqrt(largest / unit / 5)), math.ceil(angle / 1.2))
    advice = (
        f"Divide the beam into {parts}, by `twistorjax.flexures.chain(..., "
        f"segments={parts})`, or use a smaller `rotation` or `force`"
    )
    if not np.max(rotation_error) < 1e-6:
        raise ValueError(
            f"The beam cannot be computed everywhere up to {limits}: from "
            f"{least_failed:.3g} N on, no equilibrium is found at "
            "some rotations. A beam in compression buckles between its ends at about "
            f"10 E I / L^2. {advice}."
        )
    return _lowest_order(fit, order, error, limits, advice)


def _mechanism_surrogate(
    part: SubMechanism,
    rotation: Scalar | None,
    displacement: Scalar | None,
    force: Scalar | None,
    error: float,
    order: int | None,
) -> WithValidityRange:
    """Compute the surrogate of a sub-mechanism; see `surrogate`."""
    require_float64(part.mechanism.reference)
    if (rotation is None) == (displacement is None):
        raise ValueError(
            "Give either `rotation`, if the sub-mechanism is compliant in rotation, or "
            "`displacement`, if it is compliant along axis 2, but "
            f"{'neither is' if rotation is None else 'both are'} given."
        )
    force = _half_of_smallest_range(part) if force is None else force
    freedom: Freedom = "rotation" if displacement is None else "transverse"
    size = rotation if displacement is None else displacement
    assert size is not None
    samples = sample_mechanism(part, size, force, freedom=freedom)
    known = all_concrete(
        stop_gradient(
            [size, force, samples.succeeded, samples.outside, samples.stiffness]
        )
    )
    if known is None:
        symmetries = mechanism_symmetries(part, samples)
        powers = mechanism_powers(symmetries, order or 6, freedom)
        energy = fit_mechanism(powers, freedom, size, samples)
        return replace(energy, stress_model=mechanism_stress(part, freedom, samples))
    unit = "rad" if displacement is None else "m"
    limits = f"{known[0]:.4g} {unit} and {known[1]:.4g} N"
    name = "rotation" if displacement is None else "displacement"
    advice = f"Use a smaller `{name}` or `force`"
    outside, failed = np.mean(known[3]), np.mean(~known[2] & ~known[3])
    if outside or failed:
        raise ValueError(
            f"The sub-mechanism cannot be computed everywhere up to {limits}: for "
            f"{100 * outside:.3g} % of the loads a hinge is outside its validity range, "
            f"and for {100 * failed:.3g} % no stable equilibrium is found. "
            f"{_wrong_freedom(known[4], freedom)}{advice}, or "
            "hinges with a larger validity range."
        )

    def fit(order: int) -> WithValidityRange:
        powers = mechanism_powers(symmetries, order, freedom)
        return fit_mechanism(powers, freedom, size, samples)

    symmetries = mechanism_symmetries(part, samples)
    energy = _lowest_order(fit, order, error, limits, advice)
    return replace(energy, stress_model=mechanism_stress(part, freedom, samples))


def _wrong_freedom(stiffness: np.ndarray, freedom: Freedom) -> str:
    """Describe the compliant direction, if it is not the given one."""
    axial, transverse = stiffness[1, 1], stiffness[2, 2]
    if axial < 0.1 * transverse:
        return (
            "It is compliant along axis 1: rotate the frame `at` of the sub-mechanism by "
            "pi / 2, and give `displacement`. "
        )
    if freedom == "rotation" and transverse < 0.1 * axial:
        return "It is compliant along axis 2: give `displacement`. "
    if freedom == "transverse" and transverse > 0.1 * axial:
        return "It is stiff along axis 2: give `rotation`. "
    return ""


def _half_of_smallest_range(part: SubMechanism) -> Scalar:
    """Return half of the smallest range of forces of a hinge of a sub-mechanism; N."""
    ranges = []
    for row in range(len(part.mechanism.hinge_names)):
        energy = part.mechanism.hinge_assembly.energy_of(row)
        if isinstance(energy, WithValidityRange):
            ranges.append(energy.force)
    if not ranges:
        raise ValueError(
            "`force` is not given, but no hinge of the sub-mechanism has a validity "
            "range from which it could follow. Give the largest force (N)."
        )
    return jnp.min(jnp.stack(ranges)) / 2


def _lowest_order(
    fit: Callable[[int], WithValidityRange],
    order: int | None,
    error: float,
    limits: str,
    advice: str,
) -> WithValidityRange:
    """Return the energy of the lowest order with an accepted error."""
    errors = {}
    for tried in _ORDERS if order is None else (order,):
        energy = fit(tried)
        errors[tried] = float(np.max(jax.lax.stop_gradient(energy.error)))
        if errors[tried] <= error:
            return energy
    listed = ", ".join(
        f"{worst:.2g} with order {tried}" for tried, worst in errors.items()
    )
    raise ValueError(
        f"The `error` of {error:g} is not reached up to {limits}; it is {listed}. "
        f"{advice}, or accept a larger `error`."
    )


def _symmetry(beam: Beam) -> tuple[Symmetry, ...]:
    """Return the symmetries that a beam is known to have."""
    ends_equal = all(
        isinstance(function, Uniform) or _is_even(function, beam.length)
        for function in functions_along(beam)
    )
    if beam.curvature is None:
        return ("mirror", "ends") if ends_equal else ("mirror",)
    return ("arch",) if ends_equal else ()


def _is_even(function: Callable[[Scalar], Scalar], length: Scalar) -> bool:
    """Decide whether a function of the position is even; false if it is traced."""
    function, length = stop_gradient((function, length))
    positions = jnp.asarray(np.linspace(-0.5, 0.5, 101)) * length
    values = concrete(jax.vmap(function)(positions))
    return values is not None and np.allclose(values, values[::-1], rtol=1e-9, atol=0)


def _powers(order: int, symmetry: tuple[Symmetry, ...]) -> Powers:
    """List the powers of the terms of a beam with some symmetries.

    The constant and the linear terms are left out, because the reference configuration
    has no energy, no displacement, and no load.
    """
    powers = monomials(order, "mixed", symmetry=symmetry)
    return tuple(row for row in powers if sum(row) > 1)


@partial(fast_compile, optimize=False)  # runs for 4 ms
def _fit(
    powers: Powers, length: Scalar, rotation: Scalar, samples: Samples
) -> WithValidityRange:
    """Fit an energy, and estimate its error on the samples that are not fitted."""
    references = length, samples.force
    for_fit = samples.poses[:SAMPLES], samples.wrenches[:SAMPLES]
    coefficients = fit_coefficients(powers, (1,), references, samples.stiffness, for_fit)
    energy = MixedEnergy(coefficients, powers, length=length, force=samples.force)
    error = relative_errors(energy, samples.poses[SAMPLES:], samples.wrenches[SAMPLES:])
    return WithValidityRange(energy, rotation, samples.force, error)

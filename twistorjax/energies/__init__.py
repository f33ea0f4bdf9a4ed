"""Elastic energies of a hinge as functions of the displacement of its two frames.

Start reading in `base`. A new energy is a subclass of `AbstractEnergy` with one method,
`stored_energy(displacement)`, and may be defined in any file. The energy is written with
`jax.numpy` and is twice differentiable. Its gradient should be zero in the reference
configuration; then `is_unloaded` says so. The other methods of `AbstractEnergy` are
optional.

`quadratic`, `polynomial` (also rational energies), `mixed`, `one_freedom`, `beam_column`
(flexures), `axial_spring`, and `point_charges` contain the energies of this library.
`damping` contains viscous damping, and `validity` the range in which an energy is valid.
The package `fitting` determines energies from measured wrenches. `stress_model` and
`sections` describe the inside of a flexure: its stress, and its cross-sections. The other
files contain the coordinates, polynomials, and potentials that they share.
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)

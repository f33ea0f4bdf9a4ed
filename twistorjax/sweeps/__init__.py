"""Studies of many designs: sweeps, tolerance analysis, and optimization.

Start reading in `sweep`. `outputs` has what a study returns for one design, `executor`
the compiled program that evaluates chunks of designs on one or several devices, and
`dataset` the result in memory. `stores` writes the result to a zarr folder on disk, from
which an interrupted sweep is resumed. A design that fails returns NaN and a result code.
`tolerances` computes how tolerances of the parameters propagate to an output. The package
`optimization` searches for the best design.
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)

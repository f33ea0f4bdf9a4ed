"""Identification of the parameters of a mechanism from measurements.

Start reading in `identify`. `experiments` contains the tests, which define what is done
to the mechanism and which sensors are read, and `estimation` the search for the
parameters that fit the readings best. `report` holds the estimates and their
uncertainties, and `diagnostics` says in words what is wrong with them.
`experiment_design` ranks further experiments, and `posterior` draws samples of the
posterior distribution.
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)

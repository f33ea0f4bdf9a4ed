"""Identification of the parameters of a mechanism from measurements.

Start reading in `identify`. A test defines what is done to the mechanism and which
sensors are read: `static_test`, `motion_test`, `vibration_test` and `hinge_test` contain
one kind of test each. The main path is: `parameters` maps the parameters of a design
function to normalized parameters, `objective` computes the residuals and their
derivatives, `search` runs an optimizer, and `report` holds the estimates and their
uncertainties. `experiment_design` ranks further experiments, and `posterior` draws
samples of the posterior distribution.
"""

import lazy_loader


# The names are imported from their modules at their first use, because some of these
# modules import packages that take long to load. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

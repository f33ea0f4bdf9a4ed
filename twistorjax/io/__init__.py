"""Files of models: energies and mechanisms as JSON, outlines as SVG and DXF, and scripts.

Start reading in `models`. `records` converts energies and mechanisms to the content of
the JSON files and back; it has the list of the classes that can be saved. `outlines`
writes SVG and DXF files, `drawings` reads the outlines of bodies from DXF files, and
`exudyn` returns scripts for cross-checks. `ExactBeam`, and energies that a user defines,
cannot be saved.

Solutions have no file format of their own: `to_xarray()` converts them to datasets, which
xarray can save. A sweep saves its results with `store=`; see `sweeps.store`.
"""

from .._utils.lazy_names import attach


# The names are imported at their first use. `__init__.pyi` lists them.
__getattr__, __dir__, __all__ = attach(__name__, __file__)

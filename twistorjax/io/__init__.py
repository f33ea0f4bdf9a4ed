"""Files of models: energies and mechanisms as JSON, outlines as SVG and DXF, and scripts.

Start reading in `mechanisms` and `energies`. `records` holds the layout of the JSON
files, which is used to check every entry. `outlines` writes SVG and DXF files, and
`exudyn` returns scripts for cross-checks. `ExactBeam`, and energies that a user defines,
cannot be saved.

Solutions have no file format of their own: `to_xarray()` converts them to datasets, which
xarray can save. A sweep saves its results with `store=`; see `sweeps.store`.
"""

from .energies import load_energy as load_energy, save_energy as save_energy
from .exudyn import exudyn_script as exudyn_script
from .mechanisms import (
    load_mechanism as load_mechanism,
    save_mechanism as save_mechanism,
)
from .outlines import save_outline as save_outline

"""Files: energies and mechanisms as JSON, outlines as SVG and DXF, EXUDYN scripts.

Start reading in `mechanisms` and `energies`. `schemas` holds the layout of the JSON
files, which is used to check every entry. `outlines` writes SVG and DXF files, and
`exudyn` writes scripts for cross-checks.
"""

from .energies import load_energy as load_energy, save_energy as save_energy
from .exudyn import exudyn_script as exudyn_script
from .mechanisms import (
    load_mechanism as load_mechanism,
    save_mechanism as save_mechanism,
)
from .outlines import save_outline as save_outline

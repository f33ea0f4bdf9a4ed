from .drawings import load_outlines as load_outlines
from .exudyn import exudyn_script as exudyn_script
from .models import (
    load_energy as load_energy,
    load_mechanism as load_mechanism,
    save_energy as save_energy,
    save_mechanism as save_mechanism,
)
from .outlines import save_outline as save_outline

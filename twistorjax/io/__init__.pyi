from .energies import load_energy as load_energy, save_energy as save_energy
from .exudyn import exudyn_script as exudyn_script
from .mechanisms import load_mechanism as load_mechanism, save_mechanism as save_mechanism
from .outlines import save_outline as save_outline

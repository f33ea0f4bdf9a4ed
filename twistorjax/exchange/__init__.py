"""Mechanisms in files: models to be read again, outlines to be cut, scripts of others."""

from .exudyn import exudyn_script as exudyn_script
from .models import load_mechanism as load_mechanism, save_mechanism as save_mechanism
from .outlines import save_outline as save_outline

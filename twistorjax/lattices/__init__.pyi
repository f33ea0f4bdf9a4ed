from .squares import rotating_squares as rotating_squares
from .unit_cell import (
    Lattice as Lattice,
    Port as Port,
    repeat as repeat,
    UnitCell as UnitCell,
)

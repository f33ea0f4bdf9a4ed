from .bistable_chain import bistable_chain as bistable_chain
from .squares import rotating_squares as rotating_squares
from .triangles import kagome as kagome
from .unit_cell import (
    Lattice as Lattice,
    Port as Port,
    repeat as repeat,
    UnitCell as UnitCell,
)

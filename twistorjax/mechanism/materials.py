"""Typical values of materials of flexures, by name.

They are for a first design; measure or look up those of your plate. The strengths of
silicon depend on how its surface was made, so none are given.
"""

# Modulus (Pa), Poisson's ratio, density (kg/m3), expansion (1/K), strength, ultimate
# strength, and endurance limit (Pa)
_NAMES = (
    "modulus",
    "poisson",
    "density",
    "expansion",
    "strength",
    "ultimate_strength",
    "endurance_limit",
)
_VALUES: dict[str, tuple[float, ...]] = {
    # C75S, hardened and tempered strip (EN 10132-4); the endurance limit is 0.4 times the
    # ultimate strength.
    "spring steel": (210e9, 0.30, 7850.0, 11.5e-6, 1300e6, 1500e6, 600e6),
    # Plate; the endurance limit is that of 5e8 cycles (MatWeb, Aluminum Association).
    "aluminum 7075-T6": (71.7e9, 0.33, 2810.0, 23.6e-6, 503e6, 572e6, 159e6),
    # Grade 5, annealed bar; the endurance limit is that of 1e7 cycles of a smooth
    # specimen (MatWeb, ASM).
    "titanium Ti-6Al-4V": (114e9, 0.33, 4430.0, 8.6e-6, 830e6, 900e6, 510e6),
    # In the plane of a (100) wafer, along <110> (Hopcroft, Nix and Kenny, What is the
    # Young's modulus of silicon, Journal of Microelectromechanical Systems 19, 2010).
    "silicon": (169e9, 0.064, 2329.0, 2.6e-6),
    # Not filled, at 23 C (Victrex 450G, data sheet)
    "PEEK": (4.0e9, 0.38, 1300.0, 45e-6, 98e6),
}

MATERIALS: dict[str, dict[str, float]] = {
    name: dict(zip(_NAMES, values, strict=False)) for name, values in _VALUES.items()
}

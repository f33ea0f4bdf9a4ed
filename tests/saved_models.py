"""The mechanisms in the files of `reference/layouts`, one for each layout of the files.

Each file was written by the last version of twistorjax with its layout. Mechanisms of
later layouts contain what earlier files could not.
"""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

import twistorjax as tj
from twistorjax.energies import (
    AxialSpring,
    BeamColumn,
    CornerContact,
    MixedEnergy,
    OneFreedomEnergy,
    PointCharges,
    Polynomial,
    Rational,
    Stop,
    SumOfSquares,
    WithValidityRange,
)
from twistorjax.energies.stress_model import Strengths
from twistorjax.flexures.beams.stress_models import (
    BeamColumnStress,
    BeamStress,
    MechanismStress,
    SectionStress,
)


TRIANGLE = np.array([[0.0, 0.0], [0.3, 0.0], [0.0, 0.1]])


def saved_mechanism(layout):
    """Create the mechanism in the file of a layout, 2 to 6."""
    pose = (0.1, 0.2, 1 / 3)
    expansion = None if layout == 2 else 12e-6
    inertia = np.array([[0.3, -0.1], [-0.1, 0.4]]) if layout > 5 else None
    table = tj.Body("table", pose, 2.0, 0.5, TRIANGLE, expansion, inertia)
    energies = {}
    for added in range(2, layout + 1):
        energies.update(_ENERGIES[added]())
    settings = _settings(layout)
    hinges = [
        tj.Hinge(name, "base", "table", energy, at=(0.1, 0, 0), **settings.get(name, {}))
        for name, energy in energies.items()
    ]
    fixed = {"base": ["angle", "x", "y"], "table": ["y"]}
    return tj.Mechanism([tj.Body("base"), table], hinges, fixed=fixed)


def _settings(layout):
    """Return further arguments of the hinges, by name."""
    matrix = np.diag([1.0, 2.0, 1 / 3])
    damping = tj.energies.ViscousDamping(matrix, "twist", resisted=True)
    settings = {
        "quadratic": {"outline": TRIANGLE, "damping": damping},
        "polynomial": {"damping": 1e-3},
    }
    if layout > 2:
        expansion = tj.Expansion(12e-6, length=0.3)
        settings["sum"] = {"misfit": (0.01, 0.02, 0.03), "expansion": expansion}
    if layout > 3:
        settings["condensed"] = {"outline": _series()}
    if layout > 5:
        curved = tj.Expansion(
            12e-6,
            ends=[(-0.1, 0.0), (0.1, 0.02)],
            arc_length=0.21,
            centroid=(0.0, -0.005),
        )
        settings["mechanism stress"] = {"expansion": curved}
    return settings


def _series():
    """Return a sub-mechanism of two leaves in series."""
    leaf = tj.Quadratic(np.diag([1.0, 300.0, 20.0]))
    hinges = [
        tj.Hinge("first", "frame", "middle", leaf, at=(0.0, -0.1, 0.0)),
        tj.Hinge("second", "middle", "stage", leaf, at=(0.0, 0.1, 0.0)),
    ]
    bodies = [
        tj.Body("frame"),
        tj.Body("middle", (0.0, 0.0, 0.05), outline=TRIANGLE),
        tj.Body("stage", (0.0, 0.2, 0.0)),
    ]
    return tj.SubMechanism(tj.Mechanism(bodies, hinges, fixed=["frame"]), "stage")


def _of_layout_2():
    quadratic = tj.Quadratic(np.diag([2.0, 300.0, 40.0]), "twist")
    polynomial = Polynomial([0.5, 1 / 7], [(0, 2, 0, 0), (0, 0, 0, 4)])
    squares = SumOfSquares(
        [[0.1, 0.7], [0.3, 0.2]], [(0, 1, 0, 0), (0, 0, 0, 1)], scale=0.1
    )
    mixed = MixedEnergy(
        [6.0, 0.6, -5e-4], [(0, 2, 0), (0, 2, 1), (0, 0, 2)], length=0.5, force=2.0
    )
    return {
        "quadratic": quadratic,
        "polynomial": polynomial,
        "rational": Rational(polynomial, squares),
        "range": WithValidityRange(
            mixed, rotation=0.3, force=2.0, error=[1e-3, 2e-3, 3e-3]
        ),
        "charges": PointCharges(
            [1.0, -1.0], [[0.0, 0.1], [0.3, 0.0]], [2.0], [[0.5, 0.5]], constant=0.01
        ),
        "sum": 2.5 * polynomial + quadratic,
        "equal": tj.Quadratic(np.diag([2.0, 300.0, 40.0]), "twist"),
    }


def _of_layout_3():
    return {"leaf": tj.Quadratic(np.diag([2.0, 3e5, 400.0]), flexure=True)}


def _of_layout_4():
    powers = [(2, 0, 0), (2, 1, 0), (0, 2, 0), (0, 0, 2)]
    pivot = OneFreedomEnergy(
        [1.0, 0.1, -0.01, -0.01], powers, freedom="rotation", length=0.4, force=3.0
    )
    return {
        "pivot": WithValidityRange(
            pivot, rotation=0.3, force=2.0, error=[0.0, 0.0, 0.0], displacement=0.1
        ),
        "condensed": tj.flexures.Condensed(_series()),
        "spring": AxialSpring(100.0, length=0.5),
    }


STRENGTHS = Strengths(jnp.asarray(500e6), endurance=jnp.asarray(200e6))
COLUMN = BeamColumnStress(
    length=jnp.asarray(0.1),
    thickness=jnp.asarray(1e-3),
    width=jnp.asarray(0.02),
    modulus=jnp.asarray(210e9),
    strengths=STRENGTHS,
)
BEAM = BeamStress(
    thickness=jnp.asarray(np.linspace(1e-3, 2e-3, 201)),
    curvature=jnp.asarray(np.linspace(0.0, 0.1, 201)),
    length=COLUMN.length,
    width=COLUMN.width,
    modulus=COLUMN.modulus,
    bending_factor=jnp.asarray(1.1),
    shear_ratio=jnp.asarray(0.32),
    strengths=STRENGTHS,
    law="linear",
)


NOTCH = SectionStress(
    arm=jnp.asarray(0.0),
    thickness=COLUMN.thickness,
    width=COLUMN.width,
    ratio=jnp.asarray(0.05),
    strengths=STRENGTHS,
)


def _of_layout_5():
    stiffness = np.diag([2.0, 3e5, 400.0])
    return {
        "notch": tj.Quadratic(stiffness, flexure=True, stress_model=NOTCH),
        "column": BeamColumn(0.1, 0.35, 4.2e6, 1.3e6, stress_model=COLUMN),
        "beam": _beam(BEAM),
    }


def _beam(model):
    return WithValidityRange(
        tj.Quadratic(np.diag([2.0, 3e5, 400.0])),
        rotation=0.3,
        force=2.0,
        error=[0.0, 0.0, 0.0],
        stress_model=model,
    )


def _of_layout_6():
    segment = replace(
        BEAM,
        shear_modulus=jnp.asarray(81e9),
        continues=jnp.array([1.0, 0.0]),
        breaks=jnp.array([-0.04, -0.03, 0.03, 0.04]),
    )
    reinforced = replace(
        NOTCH,
        arm=jnp.asarray(0.05),
        ratio=jnp.asarray(0.0),
        moduli=(jnp.asarray(210e9), jnp.asarray(81e9)),
        reinforced=jnp.array([0.07, 3e-3]),
    )
    thick = replace(
        COLUMN,
        thickness=jnp.asarray(1e-2),
        shear_ratio=jnp.asarray(0.32),
        shear_modulus=jnp.asarray(81e9),
    )
    pivot = MechanismStress(
        parts=(COLUMN, thick),
        coefficients=jnp.asarray(np.arange(24.0).reshape(2, 6, 2) / 7),
        length=jnp.asarray(0.4),
        force=jnp.asarray(3.0),
        strengths=STRENGTHS,
        powers=((0, 0, 0), (2, 1, 0)),
        freedom="rotation",
    )
    quartic = MixedEnergy(
        [6.0, -5e-4],
        [(0, 2, 0), (0, 0, 2)],
        length=0.5,
        force=2.0,
        flexure=True,
        stress_model=COLUMN,
    )
    quadratic = tj.Quadratic(np.diag([2.0, 3e5, 400.0]), stress_model=pivot)
    edge = ((1.0, 0.1), (-1.0, 0.3))
    return {
        "mechanism stress": quadratic,
        "quartic": quartic,
        "segment": _beam(segment),
        "reinforced": tj.Quadratic(
            np.diag([2.0, 3e5, 400.0]), flexure=True, stress_model=reinforced
        ),
        "stop": Stop("-y", gap=0.1, stiffness=1e6, smoothing=1e-6),
        "corner": CornerContact((0.1, 0.2), edge, stiffness=1e6, smoothing=1e-6),
    }


_ENERGIES = {
    2: _of_layout_2,
    3: _of_layout_3,
    4: _of_layout_4,
    5: _of_layout_5,
    6: _of_layout_6,
}

# A file of a user, with dimensions instead of energies
GUIDE_BY_DIMENSIONS = {
    "bodies": [
        {"name": "base"},
        {"name": "table", "pose": [0, 0, 0.06], "mass": 0.1, "inertia": 1e-5},
    ],
    "hinges": [
        {
            "name": name,
            "first": "base",
            "second": "table",
            "at": [np.pi / 2, x, 0.03],
            "energy": {
                "kind": "leaf",
                "material": "spring steel",
                "length": 0.05,
                "thickness": 0.5e-3,
                "width": 0.01,
            },
        }
        for name, x in (("left", -0.04), ("right", 0.04))
    ],
    "fixed": ["base"],
}

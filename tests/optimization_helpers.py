"""A study that several tests of optimizations use."""

import twistorjax as tj


MODULUS, WIDTH, TRAVEL, STRENGTH = 210e9, 10e-3, 1e-3, 250e6


def leaf_spring(design):
    """A cantilever whose tip moves by `TRAVEL`, by beam theory."""
    length, thickness = design["length"], design["thickness"]
    modulus = design.get("modulus", MODULUS)
    area_moment = WIDTH * thickness**3 / 12
    stiffness = 3 * modulus * area_moment / length**3
    stress = stiffness * TRAVEL * length * thickness / 2 / area_moment
    return {"stiffness": stiffness, "stress": stress, "mass": length * thickness * WIDTH}


def leaf_parameters(**constants):
    return {
        "length": tj.Parameter(40e-3, "m", lower=20e-3, upper=60e-3),
        "thickness": tj.Parameter(0.5e-3, "m", lower=0.2e-3, upper=1e-3),
        **constants,
    }


LEAF = {"maximize": "stiffness", "limits": {"stress": tj.Limit(upper=STRENGTH)}}

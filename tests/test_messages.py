"""The messages that the manual explains are those of the library."""

import pathlib
import re
import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import twistorjax as tj


PAGE = pathlib.Path(__file__).parents[1] / "notebooks" / "manual" / "mistakes.md"
QUOTES = re.findall(r"^> (\w+): (.*)$", PAGE.read_text(), re.M)
UP = np.pi / 2
PUSH = tj.Load("table", force=(5.0, 0.0))
STIFFNESS = tj.Quadratic(jnp.diag(jnp.array([10.0, 1e6, 1e5])))


def steel():
    return tj.Material(modulus=210e9, poisson=0.3)


def leaf(function=tj.flexures.leaf, length=50e-3):
    return function(steel(), length=length, thickness=0.5e-3, width=10e-3)


def plates():
    corners = np.array([[-50e-3, -5e-3], [50e-3, -5e-3], [50e-3, 5e-3], [-50e-3, 5e-3]])
    heights = {"base": 0.0, "table": 60e-3}
    return [tj.Body(name, (0.0, 0.0, y), outline=corners) for name, y in heights.items()]


def guide(energy=None, left=(UP, -40e-3, 30e-3), bodies=None, fixed=("base",)):
    """Return the table on two leaves of the manual, with one thing that is wrong."""
    hinges = [
        tj.Hinge(name, "base", "table", energy or leaf(), at=pose)
        for name, pose in (("left", left), ("right", (UP, 40e-3, 30e-3)))
    ]
    return tj.Mechanism(bodies or plates(), hinges, fixed=fixed)


def solved(*args, loads=(PUSH,), drives=(), constraints=()):
    return tj.equilibrium(
        guide(*args), loads=loads, drives=drives, constraints=constraints
    )


def without_a_hinge_along_x():
    slides = tj.Quadratic(jnp.diag(jnp.array([1.0, 1e5, 0.0])))
    hinge = tj.Hinge("h", "base", "table", slides, at=(UP, 0.0, 30e-3))
    mechanism = tj.Mechanism(plates(), [hinge], fixed=["base"])
    tj.equilibrium(mechanism, loads=[PUSH])


def in_single_precision():
    with jax.enable_x64(False):
        tj.equilibrium(guide(leaf()))


def with_a_part_in_single_precision():
    with jax.enable_x64(False):
        energy = leaf()
    guide(energy)


def pins(*names):
    return [tj.Pin(name, "base", "table", at=(0.0, 30e-3)) for name in names]


CALLS = [
    in_single_precision,
    with_a_part_in_single_precision,
    lambda: leaf(length=50.0),
    lambda: tj.Material(modulus=210e3, poisson=0.3),
    lambda: tj.Hinge("h", "base", "table", leaf(), at=(90, 0.0, 0.0)),
    lambda: tj.Body("table", pose=(0.0, 0.06)),
    lambda: guide(left=(-40e-3, 30e-3, UP)),
    lambda: guide(left=(-UP, -40e-3, 30e-3)),
    lambda: guide(leaf(length=40e-3)),
    lambda: solved(loads=[tj.Load("tabel", force=(5.0, 0.0))]),
    lambda: tj.port_compliance(guide(), "left"),
    lambda: tj.equilibium,  # pyright: ignore[reportAttributeAccessIssue]
    lambda: solved(loads=PUSH),
    lambda: guide(fixed="base"),
    lambda: tj.equilibrium(guide(fixed=())),
    without_a_hinge_along_x,
    lambda: tj.plate(
        "t", [(0.0, 0.0), (0.01, 0.0), (0.0, 0.01)], width=0.01, material=steel()
    ),
    lambda: tj.vibrations(guide()),
    lambda: solved(drives=[tj.Drive("base", x=1e-3)]),
    lambda: solved(constraints=pins("p", "q")),
    lambda: solved(loads=[tj.Load("table", force=(0.0, -4000.0))]),
    lambda: solved(loads=(), drives=[tj.Drive("table", x=45e-3)]),
    lambda: solved(
        leaf(tj.flexures.linear_leaf), loads=[tj.Load("table", force=(5.0, -100.0))]
    ),
    lambda: tj.Load("table", force=(np.nan, 0.0)),
    lambda: tj.out_of_plane(guide(STIFFNESS)),
    lambda: tj.stresses(guide(STIFFNESS), solved(STIFFNESS)),
    lambda: jax.jit(float)(1.0),
    lambda: jax.jit(lambda x: bool(x > 0))(1.0),
    lambda: jax.jit(np.asarray)(1.0),
]


@pytest.mark.untyped
@pytest.mark.parametrize(("quote", "call"), list(zip(QUOTES, CALLS, strict=True)))
def test_a_message_is_that_of_the_manual(quote, call):
    kind, text = quote
    parts = [re.escape(part.strip()) for part in text.replace("\\", "").split("...")]
    raised = []
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter("always")
        try:
            call()
        except Exception as error:
            raised.append(error)
    messages = [
        (type(message).__name__, " ".join(str(message).split()))
        for message in (*raised, *(warning.message for warning in warned))
    ]
    pattern = ".*".join(parts)
    assert any(
        name == kind and re.fullmatch(pattern, message) for name, message in messages
    ), messages

"""Accuracy of the hinge models of a leaf at large displacements, and their cost."""

import time
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np

import twistorjax as tj

from .measure import at_most, compiled, Row, seconds


UNIT = tj.Material(modulus=1.0, poisson=0.3)
DISPLACEMENTS = 100_000
Energies = dict[str, tj.AbstractEnergy]


def beam(thickness: float, shear_factor: float | None = None) -> tj.flexures.Beam:
    """Create a beam of unit length and unit bending stiffness."""
    width = 12 / thickness**3
    return tj.flexures.Beam(
        UNIT, length=1.0, thickness=thickness, width=width, shear_factor=shear_factor
    )


def energies(thickness: float, rotation: float, shear_factor: float | None) -> Energies:
    """Create the hinge models of the same leaf.

    Args:
        thickness: Thickness of the leaf, whose length is 1.
        rotation: Rotation up to which the surrogate is valid; rad.
        shear_factor: Shear correction factor, or None for a leaf without shear.
    """
    size = {"length": 1.0, "thickness": thickness, "width": 12 / thickness**3}
    theory = "euler-bernoulli" if shear_factor is None else "timoshenko"
    exact = beam(thickness, shear_factor)
    return {
        "linear_leaf": tj.flexures.linear_leaf(
            UNIT, theory=theory, coordinates="twist", **size
        ),
        "leaf": tj.flexures.leaf(UNIT, theory=theory, **size),
        "quartic_leaf": tj.flexures.quartic_leaf(UNIT, theory=theory, **size),
        "surrogate": tj.flexures.surrogate(exact, rotation=rotation),
    }


def guided_table(
    energy: tj.AbstractEnergy, hinge_poses: list[tuple[float, float, float]]
) -> tj.Mechanism:
    """Build a table on equal leaves with given poses (rad, m, m)."""
    hinges = [
        tj.Hinge(f"{k}", "ground", "table", energy, at=pose)
        for k, pose in enumerate(hinge_poses)
    ]
    return tj.Mechanism([tj.Body("ground"), tj.Body("table")], hinges, fixed=["ground"])


def run() -> Iterator[Row]:
    """Yield the rows of the table."""
    yield from _errors_of_wrenches()
    yield from _errors_in_mechanisms()
    yield from _costs()


def _errors_of_wrenches() -> Iterator[Row]:
    """Compare the wrenches with those of the exact beam under random loads.

    The ratio of thickness to length is 0.1. The loads are not samples of the fit. Poses
    outside of the validity range of `leaf` are left out for all models, except up to 90°,
    where most are outside.
    """
    exact_beam = beam(0.1, 5 / 6)
    solve = jax.jit(
        jax.vmap(lambda load: tj.flexures.beam_under_load(exact_beam, load, sections=2))
    )
    for degrees, limit in ((20, 0.1), (46, 0.5), (90, 3.0)):
        rotation = np.radians(degrees)
        largest = np.array([rotation + 2, 3.5, 3.5])
        loads = np.random.default_rng(0).uniform(-largest, largest, size=(4000, 3))
        solutions = solve(loads)
        models = energies(0.1, rotation, 5 / 6)
        of_leaf = jax.vmap(models["leaf"].wrench)(solutions.pose)
        counted = np.abs(solutions.pose[:, 0]) < rotation
        in_range = counted & np.all(np.isfinite(of_leaf), axis=1)
        where = f"rotations up to {degrees}°"
        share = 100 * np.sum(in_range) / np.sum(counted)
        yield Row(f"{where}: poses in the range of `leaf`", float(share), "%")
        if degrees == 90:
            del models["leaf"]
        else:
            counted, where = in_range, f"{where} in the range of `leaf`"
        poses, wrenches = solutions.pose[counted], solutions.wrench[counted]
        size = jnp.sqrt(jnp.mean(wrenches**2, axis=0))
        for name, energy in models.items():
            difference = jax.vmap(energy.wrench)(poses) - wrenches
            errors = 100 * jnp.sqrt(jnp.mean(difference**2, axis=0)) / size
            what = f"`{name}`, {where}: RMS error of the wrench, largest component"
            error = float(jnp.max(errors))
            if name == "surrogate":
                yield at_most(what, error, "%", limit)
            else:
                yield Row(what, error, "%")


def _errors_in_mechanisms() -> Iterator[Row]:
    """Compare three mechanisms with reference values of exact, very slender leaves."""
    up, half = np.pi / 2, np.pi / 4
    parallel = [(0.0, -0.5, -0.3), (0.0, -0.5, 0.3)]
    crossed = [(up + half, 0.0, 0.0), (up - half, 0.0, 0.0)]
    cases = (
        ("cantilever, PL²/EI = 1", 1e-3, [(0.0, -0.5, 0.0)],
         ([tj.Load("table", (0.0, 0.0, 1.0))], []),
         {"rotation": 0.461351949712, "axial displacement": -0.0564332362834,
          "transverse displacement": 0.3017207738}),
        ("parallel guide displaced by L/10", np.sqrt(12 / 30000), parallel,
         ([], [tj.Drive("table", y=0.1)]),
         {"force": 2.41982934, "change of height": -0.006014386,
          "rotation": 0.00032183}),
        ("cross-spring pivot at 40°", 3e-4, crossed,
         ([], [tj.Drive("table", angle=np.radians(40))]),
         {"moment": 2.150111 * np.radians(40), "shift of its center along x": -0.0188152,
          "shift of its center along y": 0.05169433}),
    )  # fmt: skip
    for case, thickness, hinge_poses, (loads, drives), expected in cases:
        for name, energy in energies(thickness, 0.8, None).items():
            mechanism = guided_table(energy, hinge_poses)
            solution = tj.equilibrium(mechanism, loads=loads, drives=drives)
            rotation, x, y = solution.displacement("table")
            moment, _, force = solution.reaction("table")
            results = {
                "rotation": rotation, "moment": moment, "force": force,
                "axial displacement": x, "change of height": x,
                "shift of its center along x": x,
                "transverse displacement": y, "shift of its center along y": y,
            }  # fmt: skip
            for quantity, exact in expected.items():
                error = 100 * (float(results[quantity]) / exact - 1)
                limit = 0.1 if case.startswith("cantilever") else 1.0
                what = f"{case}: {quantity}, error of `{name}`"
                if name == "surrogate":
                    yield at_most(what, abs(error), "%", limit)
                else:
                    yield Row(what, error, "%")


def _costs() -> Iterator[Row]:
    """Measure the times to create a surrogate and to evaluate energies."""
    start = time.perf_counter()
    # The surrogates above have compiled the same program.
    surrogate = jax.block_until_ready(
        tj.flexures.surrogate(beam(0.09, 5 / 6), rotation=0.8)
    )
    elapsed = time.perf_counter() - start
    yield Row("creation of a surrogate of a leaf: without compilation", elapsed, "s")
    pose = jnp.array([0.1, 0.0, 0.0])
    for name, energy in energies(0.01, 0.8, None).items():
        guide = guided_table(energy, [(np.pi / 2, -0.8, 0.0), (np.pi / 2, 0.8, 0.0)])
        force = jnp.array([0.5, -1.0])

        @jax.jit
        def displacement(force: jax.Array, guide=guide) -> jax.Array:
            loads = [tj.Load("table", force=force)]
            return tj.equilibrium(guide, loads=loads, throw=False).displacements

        _, compile_time = compiled(displacement, force)
        what = f"equilibrium of a guide, each leaf a `{name}`"
        yield Row(f"{what}: compilation", compile_time, "s")
        batch = jnp.linspace(0.1, 1.0, 1000)[:, None] * force
        batched, _ = compiled(jax.vmap(displacement), batch)
        yield Row(f"{what}: in a batch of 1000", 1e3 * seconds(batched, batch), "us")
    elapsed = seconds(tj.flexures.beam_at_pose, beam(0.09, 5 / 6), pose)
    yield at_most("beam at a pose: next calls", 1e3 * elapsed, "ms", 10.0)
    powers = tj.energies.monomials(8)
    coefficients = jax.random.normal(jax.random.key(0), (len(powers),))
    polynomial = tj.energies.Polynomial(coefficients, powers)
    poses = jax.random.uniform(jax.random.key(1), (DISPLACEMENTS, 3), minval=-1.0)
    poses = poses * jnp.array([0.5, 1e-3, 0.1])
    count = f"{DISPLACEMENTS:,} displacements"
    for name, energy in (
        (f"polynomial of order 8, {len(powers)} terms", polynomial),
        (f"surrogate of a leaf, {len(surrogate.energy.powers)} terms", surrogate.energy),
    ):
        for what, function in (
            ("energies", energy),
            ("wrenches", energy.wrench),
            ("second derivatives", jax.hessian(energy)),
        ):
            program, compile_time = compiled(jax.vmap(function), poses)
            elapsed = seconds(program, poses)
            yield Row(f"{name}: {what} at {count}", 1e3 * elapsed, "ms")
            what = f"{name}: compilation of the {what}"
            yield at_most(what, compile_time, "s", 2.0)

"""Use every public namespace and every extra of an installed package, without pytest.

`.ci/package` runs this file in an environment that has nothing else.
"""

import importlib
import importlib.metadata
import pathlib
import tempfile

import numpy as np

import twistorjax as tj


NAMESPACES = {
    "energies", "examples", "flexures", "geometry", "identification", "io", "lattices",
    "plotting", "solve", "sweeps",
}  # fmt: skip


def check_namespaces() -> None:
    """Every name that a namespace lists can be imported."""
    assert importlib.metadata.version("twistorjax") == tj.__version__
    public = {name for name in dir(tj) if not name.startswith("_")}
    assert public >= NAMESPACES, NAMESPACES - public
    for module in [tj, *(getattr(tj, name) for name in sorted(NAMESPACES))]:
        names = [name for name in dir(module) if not name.startswith("_")]
        assert names, module
        for name in names:
            getattr(module, name)


def check_extras(folder: pathlib.Path) -> None:
    """The function that each extra is for does what it is for."""
    steel = tj.Material.named("spring steel")
    leaf = tj.flexures.leaf(steel, length=50e-3, thickness=0.5e-3, width=10e-3)
    corners = [(-5e-3, 50e-3), (5e-3, 50e-3), (5e-3, 55e-3), (-5e-3, 55e-3)]
    bodies = [
        tj.Body("base"),
        tj.plate("table", corners, width=10e-3, material=steel),
    ]
    hinge = tj.Hinge("leaf", "base", "table", leaf, at=(np.pi / 2, 0.0, 25e-3))
    guide = tj.Mechanism(bodies, [hinge], fixed=["base"])
    push = tj.Load("table", force=(1.0, 0.0))
    found = tj.equilibrium(guide, loads=[push])

    figure = tj.draw(guide, found).get_figure(root=True)  # show
    assert figure is not None
    figure.savefig(folder / "guide.svg")

    def study(design):
        load = tj.Load("table", force=(design["force"], 0.0))
        solution = tj.equilibrium(guide, loads=[load], throw=False)
        return {"x": solution.displacement("table")[1], "result": solution.result}

    forces = {"force": np.linspace(0.5, 1.0, 3)}
    table = tj.sweep(study, forces, store=folder / "sweep.zarr")  # data
    np.testing.assert_allclose(table.x[-1], found.displacement("table")[1])

    tj.io.save_outline(guide, folder / "guide.dxf")  # export
    tj.state_space(guide, {"push": push}, {"x": ("table", "x")}).to_control()  # control

    def design(values):
        return tj.Mechanism(bodies, [hinge_of(values)], fixed=["base"])

    def hinge_of(values):
        return tj.Hinge("leaf", "base", "table", values["factor"] * leaf, at=hinge.at)

    camera = tj.identification.BodySensor("table", "x", standard_deviation=1e-6)
    test = tj.identification.StaticTest([[push]], [camera])
    data = [test.measurement([[float(found.displacement("table")[1])]])]
    fitted = tj.identify(design, {"factor": tj.Parameter(1.1, lower=0)}, data)
    np.testing.assert_allclose(fitted.estimates["factor"], 1.0, rtol=1e-6)
    tj.identification.posterior(fitted, draws=10, tune=10, chains=1)  # posterior

    def build(design):
        return guide, {"loads": [tj.Load("table", force=(design["force"], 0.0))]}

    force = tj.Parameter(0.5, "N", lower=0.0, upper=1.0)
    explorer = tj.explore(build, {"force": force})
    assert explorer.widget is not None  # explore
    explorer.save(folder / "guide.html")


if __name__ == "__main__":
    tj.configure()
    check_namespaces()
    with tempfile.TemporaryDirectory() as name:
        check_extras(pathlib.Path(name))
    print(f"twistorjax {tj.__version__}: every namespace and extra works")

"""How a solve ended."""

import diffrax as dfx
import numpy as np

from .._checks import known


class RESULTS(dfx.RESULTS):  # pyright: ignore[reportGeneralTypeIssues]
    """Why a solve stopped. The text is empty where it succeeded.

    For equilibria one of `successful`, `not_finite`, `loose`, `no_equilibrium` and
    `steps_used_up`; `RESULTS[item]` is its text. Extends the results of diffrax, so that
    one enumeration serves statics and motion.
    """

    successful = ""
    not_finite = (
        "A value of the mechanism, its loads or its drives is not finite: a NaN came in, "
        "or a dimension of a hinge lies outside the range of its formula."
    )
    loose = (
        "Some body can move without storing energy, or even gives some away, so nothing "
        "picks out where it rests. Hold it with `held`, drive it, add a hinge, or "
        "stiffen one: the mechanism's `stiffness` there is singular or has a negative "
        "eigenvalue."
    )
    no_equilibrium = (
        "No equilibrium was found that continues the one at rest up to the full loads "
        "and drives. `fraction` tells how much of them was reached: there the mechanism "
        "may buckle or snap, or a hinge be displaced beyond what its energy allows. Take "
        "smaller loads, drive the motion instead of loading it, or, where a symmetric "
        "mechanism may give way to either side, choose one by a small load."
    )
    steps_used_up = (
        "The largest number of Newton steps was reached. `fraction` tells how much of "
        "the loads and drives was; raise `max_steps`, or start nearer with `start`."
    )


def outcomes(result: RESULTS) -> np.ndarray | None:
    """The names of results, in the shape of their batch, or nothing while traced."""
    index = known(result._value)
    return None if index is None else np.array(_NAMES[index], object)


_NAMES = np.empty(len(RESULTS), object)
for _name, _item in RESULTS._name_to_item.items():
    _NAMES[int(_item._value)] = _name

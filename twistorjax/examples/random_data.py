"""Overfitting: a polynomial energy fitted to random wrenches (section 7.1).

Seventeen displacements and wrenches are drawn at random, so they belong to no hinge. A
polynomial of fourth order has 69 coefficients, more than the 51 components of these
wrenches, and interpolates all of them. It does not predict a wrench that was held out.
"""

import warnings
from typing import TYPE_CHECKING

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from .._utils.progress import announced
from ..energies.fitting.polynomial import EnergyFit, fit_energy
from ..energies.fitting.trials import Errors, errors_of_predictions, Trials
from ..plotting.figure_style import subplots
from ..plotting.fits import draw_numbers


if TYPE_CHECKING:
    from matplotlib.figure import Figure


COMPONENTS = ("moment (N m)", "force 1 (N)", "force 2 (N)")

# angle, x, y, moment, force 1, force 2; the dissertation gives no units
DISSERTATION_TRIALS = (
    (-0.15841351933608, 4.65393993495608, 1.31532797568824,
     -0.387550817802548, -0.468242167495191, -0.818195529282093),
    (0.134224962528456, 4.59789474366141, -0.971024909512858,
     0.585012968629599, -0.0995824122801423, -0.592722633853555),
    (-0.365962790882038, 3.09571483151214, 0.00293481946310351,
     -0.0918297823518515, -0.562361600808799, 0.359540227800608),
    (0.0898227845880897, 5.08027681416748, -1.67039664947761,
     0.36625213176012, -0.836410117335618, -0.262529728934169),
    (0.276309712837192, 3.97571433233557, 0.450203381898234,
     -0.405556166544557, -0.639865345321596, 0.828751817345619),
    (0.391505149635233, 4.04438001772267, 1.26917306079055,
     -0.468403439968824, -0.291880712844431, 0.79636768810451),
    (-0.21457589383298, 5.55890767151369, 0.490039390775545,
     0.314018862321973, 0.807782937772572, -0.536801490932703),
    (0.261554658915685, 4.91730850212791, -1.74169796298079,
     -0.550397723913193, -0.45922025013715, 0.164554143324494),
    (0.119191155418617, 3.03784811216893, -0.0978808129739588,
     0.459293184801936, -0.123157634399831, 0.242367722094059),
    (-0.124335081866658, 4.14026950334127, 0.915242587376395,
     -0.760671157389879, 0.216395146213472, 0.227438991889358),
    (0.108875167682034, 4.27937460611275, 1.01228431488859,
     -0.567188223823905, -0.557543057017028, -0.0524800531566143),
    (0.292856790203669, 4.1447886674411, -1.42691580749053,
     0.353103034198284, -0.219045487232506, 0.959191964939237),
    (0.306285659147105, 5.30263075930048, -0.338629876815755,
     0.724171003326774, 0.588098921813071, 0.0803899168968201),
    (0.291355398841835, 4.9834655457164, 1.68222040030742,
     0.944438759237528, 0.546758531592786, 0.648084966465831),
    (-0.159636900671966, 5.27043466947057, -2.15566782570248,
     -0.00917082838714123, -0.289206589572132, 0.692044030874968),
    (-0.145726152364891, 3.56574392466211, 1.03510433001032,
     0.708613231778145, 0.637097264640033, 0.750740120187402),
    (0.328542298774053, 5.1398998509706, 0.648679971127145,
     -0.6696766782552, 0.739624232985079, 0.809394024312496),
)  # fmt: skip


class Study(eqx.Module):
    """A polynomial fitted to random trials, and its leave-one-out predictions.

    Args:
        trials: The trials.
        fit: Fit to all trials.
        fitted: Wrench of this fit at the pose of each trial; N m, N, N.
        predictions: Wrench at the pose of each trial, predicted by a fit to all other
            trials; N m, N, N.
        held_out: Errors of the predictions.
    """

    trials: Trials
    fit: EnergyFit
    fitted: Float[np.ndarray, "trials 3"]
    predictions: Float[np.ndarray, "trials 3"]
    held_out: Errors

    def __repr__(self) -> str:
        fit = self.fit
        training, held_out = fit.training, self.held_out
        rows = (
            ("rms of the trials", held_out.rms_wrench / held_out.relative),
            ("largest training error", training.largest_wrench),
            ("largest held-out error", held_out.largest_wrench),
            ("rms held-out error", held_out.rms_wrench),
        )
        lines = [
            f"{len(self.trials)} random trials, polynomial of order {fit.energy.order}: "
            f"{fit.terms} coefficients, {fit.value_count} measured values, rank "
            f"{fit.rank}, condition number {fit.condition:.1e}",
            f"{'':<24}" + "".join(f"{component:>14}" for component in COMPONENTS),
        ]
        for name, errors in rows:
            lines.append(f"{name:<24}" + "".join(f"{error:>14.2g}" for error in errors))
        lines.append("Each trial is held out once and predicted by a fit to the others.")
        if fit.warning:
            lines.append(f"warning: {fit.warning}")
        return "\n".join(lines)


def trials(seed: int | None = None) -> Trials:
    """Return seventeen random trials.

    Args:
        seed: Seed of the random numbers. By default, the trials are those of the
            dissertation.

    Returns:
        The trials; poses in rad, m, m, and wrenches in N m, N, N.

    Source:
        Section 7.1.2 of the dissertation, and its listing `randomtest`.

    Example:
        >>> trials().poses[0]
        Array([-0.15841352,  4.65393994,  1.31532798], dtype=float64)
    """
    if seed is None:
        numbers = np.array(DISSERTATION_TRIALS)
        return Trials(poses=numbers[:, :3], wrenches=numbers[:, 3:])
    random = np.random.default_rng(seed).random((len(DISSERTATION_TRIALS), 6))
    angles, directions = (random[:, :2].T - 0.5) * np.pi / 4
    distances = 3 + 3 * random[:, 2]
    x, y = distances * np.cos(directions), distances * np.sin(directions)
    poses = np.stack([angles, x, y], axis=1)
    return Trials(poses=poses, wrenches=1 - 2 * random[:, 3:])


@announced("fits to random wrenches")
def study(data: Trials | None = None, order: int = 4) -> Study:
    """Fit a polynomial to random trials, and predict each trial from the others.

    Args:
        data: The trials. By default, those of the dissertation.
        order: Order of the polynomial.

    Returns:
        The fit to all trials, and the leave-one-out predictions.

    Source:
        Section 7.1 of the dissertation. It states the largest training errors: 2.64e-5
        (moment), 1.53e-5 (force 1), and 4.2e-6 (force 2).

    Example:
        >>> result = study()
        >>> bool(np.all(result.fit.training.largest_wrench < 2.6e-5))
        True
        >>> bool(np.all(result.held_out.relative > 1))  # predicting zero is better
        True
    """
    data = trials() if data is None else data
    scale = data.largest_translation

    def interpolate(some: Trials) -> EnergyFit:
        return fit_energy(
            some, order, redundant=True, reference="free", ridge=0.0, scale=scale
        )

    rows = np.arange(len(data))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the result reports the warning
        fit = interpolate(data)
        energies = [interpolate(data[rows != row]).energy for row in rows]
    wrench = jax.jit(lambda energy, pose: energy.wrench(pose))
    fitted = np.stack([wrench(fit.energy, pose) for pose in data.poses])
    predictions = np.stack(
        [wrench(energy, pose) for energy, pose in zip(energies, data.poses, strict=True)]
    )
    return Study(
        trials=data,
        fit=fit,
        fitted=fitted,
        predictions=predictions,
        held_out=errors_of_predictions(data, predictions, np.zeros(len(data))),
    )


def plot(study: Study) -> "Figure":
    """Draw the wrenches of the trials, of the fit, and of the predictions.

    Args:
        study: A study made by `study`.

    Returns:
        A figure with one panel for each component of the wrench.

    Source:
        Figures 7.1 to 7.3 of the dissertation.
    """
    figure, axes = subplots(3, size=(8, 8), sharex=True)
    measured = np.asarray(study.trials.wrenches)
    for component, (panel, name) in enumerate(zip(axes, COMPONENTS, strict=True)):
        draw_numbers(
            panel,
            measured[:, component],
            {
                "fitted": study.fitted[:, component],
                "predicted by a fit to the others": study.predictions[:, component],
            },
        )
        panel.set_ylabel(name)
    axes[0].legend(ncols=3, fontsize="small", loc="lower center", bbox_to_anchor=(0.5, 1))
    axes[-1].set_xlabel("trial")
    return figure

"""Checks of the units and the signs of trials.

A wrench is the derivative of an energy. If some quantities have a wrong unit or a wrong
sign, no energy fits the trials well, except for a linear hinge whose stiffness has no
coupling terms. Units that are wrong in a consistent way, such as mm and N mm, change the
size of the hinge only.
"""

from collections.abc import Callable
from itertools import product

import numpy as np

from .trials import Trials


_LARGEST_TRANSLATION = 1.0  # of a flexure; m
_REVERSED = 0.75  # share of the trials in which the wrench does negative work
_MUCH_SMALLER = 0.2  # ratio of the errors with other and with the given units

# Factors that convert the rotation; the translation and the moment; the wrench.
_ANGLES = (1.0, ""), (np.pi / 180, "the angles are in degrees")
_LENGTHS = (
    (1.0, 1.0, ""),
    (1e-3, 1.0, "the translations are in millimeters"),
    (1.0, 1e-3, "the moments are in N mm"),
)
_SIGNS = (
    ((1, 1, 1), ""),
    ((-1, -1, -1), "the sign of the wrenches is reversed"),
    ((-1, 1, 1), "the sign of the moments is reversed"),
    ((1, -1, 1), "the sign of the forces along axis 1 is reversed"),
    ((1, 1, -1), "the sign of the forces along axis 2 is reversed"),
)


def implausible_values(trials: Trials) -> list[str]:
    """Describe values of trials that are implausible for a hinge, in a sentence each."""
    poses = np.asarray(trials.poses)
    rotation, translation = np.abs(poses[:, 0]).max(), trials.largest_translation
    texts = []
    if rotation > 2 * np.pi:
        texts.append(
            f"the largest rotation of the trials is {rotation:.4g} rad, more than one "
            "turn: are the angles in degrees?"
        )
    if translation > _LARGEST_TRANSLATION:
        texts.append(
            f"the largest translation of the trials is {translation:.4g} m: are the "
            "translations in millimeters?"
        )
    return texts


def reversed_wrenches(trials: Trials) -> str | None:
    """Describe wrenches with a reversed sign; `None` if most of them are plausible.

    The wrench of a hinge with a stable reference configuration does positive work along
    the twist, at least near the reference.
    """
    poses, wrenches = np.asarray(trials.poses), np.asarray(trials.wrenches)
    half = poses[:, 0] / 2
    c, s = np.cos(half), np.sin(half)
    chords = c * poses[:, 1] + s * poses[:, 2], c * poses[:, 2] - s * poses[:, 1]
    forces = wrenches[:, 1] * chords[0] + wrenches[:, 2] * chords[1]
    work = poses[:, 0] * wrenches[:, 0] + forces / np.sinc(half / np.pi)
    count = np.sum(work < 0)
    if np.any(np.abs(poses[:, 0]) > 2 * np.pi) or count <= _REVERSED * len(trials):
        return None
    return (
        f"in {count} of {len(trials)} trials the wrench points back to the reference "
        "configuration: is its sign reversed? It is the wrench that the second body "
        "exerts on the hinge."
    )


def better_conversion(
    trials: Trials, error: float, quick_error: Callable[[Trials, int], float]
) -> str | None:
    """Describe other units and signs of the trials for which a fit is much more accurate.

    `quick_error` estimates the expected error of trials by fits of an order. Errors are
    in standard deviations.
    """
    poses, wrenches = np.asarray(trials.poses), np.asarray(trials.wrenches)
    found = []
    for (turn, angle), (size, moment, unit), (signs, sign) in product(
        _ANGLES, _LENGTHS, _SIGNS
    ):
        if reasons := [text for text in (angle, unit, sign) if text]:
            factors = np.array([[moment, 1.0, 1.0]])
            converted = Trials(
                poses * np.array([[turn, size, size]]),
                wrenches * factors * np.array([signs]),
                wrench_deviations=np.asarray(trials.wrench_deviations) * factors,
            )
            found.append((quick_error(converted, 2), len(found), reasons, converted))
    *_, reasons, converted = min(found)
    other = quick_error(converted, 4)
    if not other < _MUCH_SMALLER * error:
        return None
    return (
        f"the error would be {error / other:.2g} times smaller if "
        f"{' and '.join(reasons)}. Convert the trials, or name their units in the header "
        "of the file."
    )

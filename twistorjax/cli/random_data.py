"""`twistorjax random-data`: overfitting study on random wrenches (section 7.1)."""

from .common import JsonOption, PlotOption, prepare_jax, print_result


def random_data(as_json: JsonOption = False, plot: PlotOption = None) -> None:
    """Fit a polynomial energy to the 17 random trials of section 7.1.

    Each trial is also held out once, and predicted by a fit to the other trials. A figure
    shows the given, the fitted, and the predicted wrenches.

    Example: twistorjax random-data --plot random.png
    """
    prepare_jax()
    from ..examples import random_data as example

    study = example.study()
    fit = study.fit
    record = {
        "order": fit.energy.order,
        "trials": len(study.trials),
        "value_count": fit.value_count,
        "terms": fit.terms,
        "rank": fit.rank,
        "condition": fit.condition,
        "largest_error_training": fit.training.largest_wrench.tolist(),
        "largest_error_held_out": study.held_out.largest_wrench.tolist(),
        "relative_error_held_out": study.held_out.relative.tolist(),
        "warning": fit.warning,
    }
    print_result(study, record, as_json, plot=plot, draw=lambda: example.plot(study))

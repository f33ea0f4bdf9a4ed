"""The command line: `twistorjax --help`."""

import sys
from typing import Annotated

import typer

from .commands.common import Failed, Refused
from .commands.export import export
from .commands.fit import fit
from .commands.four_bar import four_bar
from .commands.identify import identify
from .commands.random_data import random_data
from .commands.stage import stage
from .commands.sweep import sweep
from .commands.water import water


app = typer.Typer(
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


_ABOUT = {
    stage: "The gain of the micropositioning stage.",
    four_bar: "The four-bar linkages, driven or let go.",
    fit: "An energy of a hinge, from measurements.",
    identify: "Three stiffnesses, from a motion.",
    random_data: "Random wrenches, and what fits to them foretell.",
    water: "The energy of two water molecules.",
    export: "A mechanism in files for other programs.",
}
for command, about in _ABOUT.items():
    app.command(command.__name__.replace("_", "-"), short_help=about)(command)
app.add_typer(sweep, name="sweep", short_help="Answers over ranges of dimensions.")


@app.callback(invoke_without_command=True)
def overview(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", help="Print the version.")
    ] = False,
) -> None:
    """Differentiable mechanics of planar flexure mechanisms.

    Example: twistorjax stage
    """
    if version:
        from importlib.metadata import version as installed

        print(f"twistorjax {installed('twistorjax')}")
    elif context.invoked_subcommand is None:
        print(context.get_help())


def main() -> None:
    """Runs the command line; exits with 0, with 1 on failure, with 2 on bad input."""
    command = typer.main.get_command(app)
    try:
        code = command.main(standalone_mode=False)
    except Refused as error:
        code = _complain(str(error), 2)
    except Failed as error:
        code = _complain(str(error), 1)
    except Exception as error:
        # typer carries its own copy of click, so its errors are known by what they can do
        message = getattr(error, "format_message", None)
        if message is None:
            raise
        code = _complain(message(), 2)
    sys.exit(code or 0)


def _complain(message: str, code: int) -> int:
    sys.stderr.write(f"twistorjax: {' '.join(message.split())}\n")
    return code


if __name__ == "__main__":
    main()

"""The command line: `twistorjax --help`."""

import sys
from typing import Annotated

import typer

from .commands.common import Failed, Refused
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


app.command()(stage)
app.command("four-bar")(four_bar)
app.command()(fit)
app.command()(identify)
app.command("random-data")(random_data)
app.command()(water)
app.add_typer(sweep, name="sweep")


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

"""Run the command line program: `python -m twistorjax` is the same as `twistorjax`."""

from .cli.app import main


if __name__ == "__main__":
    main()

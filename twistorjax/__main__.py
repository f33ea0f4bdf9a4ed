"""`python -m twistorjax`, the same as the command `twistorjax`."""

from .cli.app import main


if __name__ == "__main__":
    main()

"""The command line program `twistorjax`, with one file for each command.

Start reading in `app`, which collects the commands and reports every error as one line
and an exit code. `common` contains the functions and options that the commands share.
"""

"""The command line `twistorjax`: one file for each command.

Start reading in `app`, which collects the commands and turns every error into one line
and an exit code. `common` holds what the commands share.
"""

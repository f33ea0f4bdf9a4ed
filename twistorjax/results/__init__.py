"""What all solutions share: result codes, errors, and tables.

Internal. Start reading in `codes`, which has the reasons of a failure and raises them.
`tables` converts solutions to xarray datasets.
"""

"""Array types, validation of arguments, pytree functions, and JSON and CSV files.

Internal. Every other package may import these modules. They import no other package.
"""

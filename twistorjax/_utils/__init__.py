"""Array types, checks of arguments, pytree functions, progress lines, JSON and CSV files.

Internal. Every other package may import these modules. They import no other package.
"""

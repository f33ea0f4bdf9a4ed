"""Types, validation, pytree helpers, and JSON and CSV files.

Internal. Every other package may import these modules, and they import none of them.
"""

"""Benchmarks of twistorjax and of other programs, in one run: `python -m benchmarks`.

Start reading in `__main__`. Each of the other modules has a function `run` that measures
one group of rows. The modules `peers*` solve the same problems with SciPy, NumPy, and
EXUDYN.
"""

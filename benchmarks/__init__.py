"""Benchmarks of twistorjax and of other programs, in one run: `python -m benchmarks`.

Start reading in `__main__`. Each of the other modules has a function `run` that measures
one group of rows. The modules `peers*` solve the same problems with SciPy, NumPy, and
EXUDYN.
"""

import twistorjax as tj


# The modules create arrays when they are imported, and options of XLA must be set before.
tj.configure(cache=False)

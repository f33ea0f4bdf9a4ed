"""Tests of a mechanism, their sensors, and their measured data.

Internal. Start reading in `measurement`, which has the base class of all tests.
`statics`, `motion`, `vibrations`, and `hinge` contain one kind of test each. `sensors`
computes readings, and `readers` reads measured data from files.
"""

"""Compilation with stored traces and programs, and the settings of `tj.configure`.

Internal. Start reading in `compilation`, which has the decorator `fast_compile` of all
solvers. `stored_traces` finds the trace of a call in a folder (`trace_folder`) by its key
(`program_key`, `trace_keys`), and `program_call` runs it. `stored_gradients` does the
same for gradients in reverse mode. `traced_function` makes functions of a user part of a
key. `batching` keeps batches fast.
"""

"""The search for the parameters that fit measurements best.

Internal. `identification.search` runs an optimizer from one or several starts.
`objective` computes the residuals and their derivatives. `optimizer` has the protocol of
optimizers, which `levenberg_marquardt` and `wrapped_optimizers` implement.
"""

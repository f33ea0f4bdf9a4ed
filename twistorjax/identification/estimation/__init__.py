"""The search for the parameters that fit measurements best.

Internal. Start reading in `search`, which runs an optimizer from several starts.
`objective` computes the residuals and their derivatives. `optimizer` has the protocol of
optimizers, which `levenberg_marquardt` and `wrapped_optimizers` implement.
"""

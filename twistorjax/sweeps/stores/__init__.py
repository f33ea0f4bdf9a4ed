"""Results of a sweep on disk, from which an interrupted sweep is resumed.

Internal. Start reading in `store`, which writes chunks of results to a zarr folder.
`creation` prepares the folder, `files` checks its files for damage, and `identity`
compares the sweep with the one that began it.
"""

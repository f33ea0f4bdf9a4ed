"""Times of twistorjax and its peers, in one run: `python -m benchmarks`."""

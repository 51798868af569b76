"""Benchmarks of jaxlight: ratios against peers, run time against error, scaling, skips and culling. See README.md."""

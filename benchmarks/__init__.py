"""Benchmarks: one script a question, run time against error."""

"""Whole runs: solving, comparing, checking, and what stands around them."""

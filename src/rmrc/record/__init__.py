"""A run on disk and on paper: arrays and manifest, summary, report, pictures."""

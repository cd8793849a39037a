"""Engines: a problem and a state to an outcome, and what they share on the way."""

"""Config and MjModel to `Problem`: scenes, tasks, limits; every name is resolved here."""

"""The soak: random steps in random scenes, each held to what a step promises."""

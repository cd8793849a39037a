"""From text to documents with positions: reading, stacks, overrides, mistakes."""

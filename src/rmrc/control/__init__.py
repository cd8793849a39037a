"""`Controller`, `Step`, `Status`, the safety ladder, paths and the solve loop."""

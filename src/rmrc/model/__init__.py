"""What is MuJoCo's alone: a scene of whatever format to an `MjModel`, and what it says beside."""

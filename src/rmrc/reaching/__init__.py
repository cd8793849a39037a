"""Position inverse kinematics: poses solved to convergence."""

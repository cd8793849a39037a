// What the terms whose error is the logarithm of a motion share.
#pragma once

namespace rmrc {

/// T ← [A B; 0 D] in a matrix (6, 6), of blocks (3, 3).
void set_blocks(double* T, const double* A, const double* B, const double* D);

/// Write the distance and the angle (2,) that the logarithm e = log(T) of a motion stands for.
void measure_motion(const double* e, double* measures);

}  // namespace rmrc

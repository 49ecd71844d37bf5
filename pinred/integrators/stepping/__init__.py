"""Parts of compiled steppers: calls of kernels, sums of rows, lanes, Newton's method."""

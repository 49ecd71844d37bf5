"""What compiled steppers are made of: calls of kernels, sums of rows, lanes, Newton's method."""

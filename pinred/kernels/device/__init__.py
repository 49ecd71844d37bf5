"""Kernels and step loops on CUDA devices, one thread per member."""

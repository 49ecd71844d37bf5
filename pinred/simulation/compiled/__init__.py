"""The compiled engine: kernels under the integrators of pinred."""

"""The compiled engine: kernels that the integrators of pinred call."""

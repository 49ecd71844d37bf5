"""The compiled route: kernels under the integrators of pinred."""

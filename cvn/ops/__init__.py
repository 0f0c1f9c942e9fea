"""The operations that the layers are made of, and the compiled kernels that a CPU has for them."""

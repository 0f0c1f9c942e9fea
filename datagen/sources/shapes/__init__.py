"""Objects built from a random generator: one module a category, each with `build(rng)`."""

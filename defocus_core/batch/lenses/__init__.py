"""The lens of a job: its fields, quantities with units, sets of radii, lens files that ship."""

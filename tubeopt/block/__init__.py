"""The equilibrium of a tube robot as a block of any nonlinear program."""

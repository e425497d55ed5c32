"""The physics as CasADi expressions: torsion, energy, second variation, shape, heat."""

"""The torsion boundary-value problem as finitely many equations."""

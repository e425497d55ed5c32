"""An equilibrium: solved, followed, verified, saved; and its derivatives."""

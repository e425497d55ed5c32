"""The robot in motion: what the actuators allow, postures, and ways between equilibria without a snap."""

"""A public benchmark of inverse kinematics, planning and design: questions, a model that judges, scores."""

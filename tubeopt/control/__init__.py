"""What the actuators allow, and the robot between two configurations."""

"""Heating in a closed loop: sensors, the law that a microcontroller runs, uncertain rigs, and the firmware."""

"""The heating of tubes in a mold: schedule, rig, thermal model, calibration; in a closed loop by a sensor."""

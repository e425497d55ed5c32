"""The mold in which tubes are shape-set: grooves, plates, files, materials."""

"""Files at the edge: units, YAML, CSV, journals; read with one clear sentence where that fails, written whole."""

"""Files at the edge of the library: robots and studies in YAML, results as JSON and npz. Units only here."""

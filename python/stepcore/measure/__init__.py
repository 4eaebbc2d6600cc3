"""The measurements: each answers one question about the same experiment."""

"""The measurements: each module answers one question about an experiment."""

"""The simulation engine: compiled models, single worlds, batches of worlds, and named views."""

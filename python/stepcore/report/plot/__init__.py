"""Pictures: one module each. matplotlib is imported only where something is drawn."""

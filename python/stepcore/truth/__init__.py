"""What a scene converges to, how well that is known, for how long, and how far a run is from it."""

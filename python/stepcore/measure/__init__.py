"""The questions: each is asked of the same experiment."""

"""The motion that is measured: its starts and controls, a run of it, what is seen on the way."""

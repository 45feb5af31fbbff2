"""Whether a fit finds again what is put in: its own recording, simulated, read and fitted anew."""
